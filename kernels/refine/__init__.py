"""Kernels of the refinement's iterations."""
