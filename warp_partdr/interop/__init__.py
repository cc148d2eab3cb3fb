"""Torch and Warp together: arrays, streams, graphs, checks of tensors, devices. Nothing here knows bodies."""
