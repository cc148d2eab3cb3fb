"""Torch and Warp, and nothing of bodies: arrays, streams, graphs, checks of tensors, devices."""
