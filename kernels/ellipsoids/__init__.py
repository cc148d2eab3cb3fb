"""Kernels that draw ellipsoids in closed form, and three gradients of what they show."""
