"""Mesh stage: refinement of a detailed body that starts at a fitted EllipBody, or at another method's body."""
