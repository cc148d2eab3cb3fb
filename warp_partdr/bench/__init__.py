"""Benchmarks behind ``partdr bench``: how long kernels and whole iterations take, on this machine."""
