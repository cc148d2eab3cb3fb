"""PartBench: synthetic people with true labels, joints and vertices, which anybody can fit with no download.

``poses`` says how people stand, ``people`` makes and draws them, ``noise`` spoils what a fit gets to see, ``samples``
puts levels together, ``methods`` are compared, ``report`` shows the result, and ``command`` is
``partdr evaluate partbench``. docs/evaluation.md has the rules and the figures.
"""

VERSION = 1  # of people, poses, views and noise: figures of two versions can't be compared
