"""Renderers of part labels with gradients, of meshes and of exact ellipsoids (paper, section 3.2)."""
