"""Measurements, one a module: ``NAME.py`` holds the function ``measure_NAME``, whose parameters are its options.

The first line of a module's docstring is its line in the list, and the whole docstring is its help. The function's
docstring explains its own parameters; those of ``lab.options`` explain themselves. It yields what ``harness`` shows.
"""
