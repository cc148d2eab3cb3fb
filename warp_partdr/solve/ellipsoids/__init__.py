"""Fit of EllipBody: the energy before an observation, its minimisation, stages, starts, result and warnings."""
