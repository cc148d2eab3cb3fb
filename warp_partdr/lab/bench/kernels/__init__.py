"""``partdr bench kernels``: every kernel, both renderers and the whole iteration, next to other rasterizers."""
