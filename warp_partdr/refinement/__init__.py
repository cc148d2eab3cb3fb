"""The energy of bodies before an observation, and its minimisation (paper, section 3.4)."""
