"""Warp kernels and their launchers: no torch, no files."""
