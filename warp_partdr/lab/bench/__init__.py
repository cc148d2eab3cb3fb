"""Benchmarks behind ``partdr bench``, one a command: ``kernels``, ``tradeoff`` and ``savings``.

They share how time is taken (``timing``, ``launches``), the machine it belongs to (``machine``), bodies to time
(``scene``), names of renderers (``renderers``), and how figures are shown (``report``, ``drawing``).
"""
