"""Fit of EllipBody to an observation: the energy, its minimisation, stages, starts, the result and warnings."""
