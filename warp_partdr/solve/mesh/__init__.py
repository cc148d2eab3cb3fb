"""Mesh stage: a detailed body goes on from a fitted EllipBody, or from a body of somebody else."""
