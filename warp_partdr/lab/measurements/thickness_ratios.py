"""Factors between thicknesses of bodies and of their ellipsoids: ``THICKNESS_RATIOS`` of ``models/growth.py``.

The people are random ones of the packaged Anny. Their EllipBody thicknesses are those of best silhouettes, as the mean
body has them; none of the people are those of the measurement "registration", whose seeds are small.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...body.template import LENGTH_NAMES, THICKNESS_NAMES
from ...models.anny import anny, anny_shape
from ...models.growth import THICKNESS_RATIOS, Growth
from ..options import tracked
from ..silhouettes import measure_by_silhouettes
from ..synthetic.people import PHENOTYPES
from ..tables import FigureTable

_SEED = 1000


def measure_thickness_ratios(*, count: int = 100) -> Iterator[FigureTable]:
    """Measure people.

    Args:
        count: Number of people.
    """
    model = anny()
    low, high = np.array([*PHENOTYPES.values()]).T
    phenotypes = np.random.default_rng(_SEED).uniform(low, high, (count, len(PHENOTYPES)))
    shapes = anny_shape(phenotypes)
    measured = np.log([measure_by_silhouettes(model, shape[None])[1] for shape in tracked([*shapes])])
    body = Growth(model, shapes)
    # The measures hold the ratios of now.
    assumed = np.log([THICKNESS_RATIOS[name][0] for name in THICKNESS_NAMES])
    ratios = measured - body.measured(shapes)[:, len(LENGTH_NAMES) :].numpy() + assumed
    table = FigureTable("Factors", {"thickness": "", "mean": ".3f", "spread of its logarithm": ".3f"})
    for name, mean, spread in zip(THICKNESS_NAMES, np.exp(ratios.mean(0)), ratios.std(0, ddof=1), strict=True):
        table.add(name, float(mean), float(spread))
    yield table
