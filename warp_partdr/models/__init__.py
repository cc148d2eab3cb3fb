"""Detailed bodies that clothe EllipBody: models, their files, poses and registration (paper, section 3.4)."""
