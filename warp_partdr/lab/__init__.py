"""Laboratory: what measures and trains the product, which itself imports nothing of it.

* ``synthetic``: people of known truth.
* ``evaluation``: methods side by side on people of known truth, and PartBench.
* ``bench``: speed, and what it costs.
* ``training``: training of the networks.
* ``measurements``: what gives the documentation its figures, run by one ``harness``: ``python -m warp_partdr.lab``.
"""
