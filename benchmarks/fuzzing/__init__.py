"""Entry points of the package and the arguments that ``benchmarks/fuzz.py`` calls them with."""
