"""Kernels that draw a part-labelled mesh, and PartDR's backward pass (paper, eq. 8 to 12)."""
