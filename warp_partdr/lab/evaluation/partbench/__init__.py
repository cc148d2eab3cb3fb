"""PartBench: synthetic people with true labels, joints and vertices, which anybody can fit with no download.

``synthetic`` makes the people and spoils what a fit gets to see, ``samples`` puts levels together, ``methods`` are
compared, ``report`` shows the result. docs/measured/partbench.md has the rules and the figures.
"""

VERSION = "3.1"  # of people, poses, views and noise: figures of two versions can't be compared
