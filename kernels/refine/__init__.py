"""Kernels of the captured refinement: energy terms, gradient, and a step of Adam for a batch of bodies."""
