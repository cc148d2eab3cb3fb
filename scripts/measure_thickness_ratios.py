"""Measure and print ``THICKNESS_RATIOS`` of ``warp_partdr/models/growth.py`` on random people of the packaged Anny.

    python scripts/measure_thickness_ratios.py

Their EllipBody thicknesses are those of best silhouettes, as ``measure_mean_body.py`` has them; none of the people are
those of ``benchmarks/registration.py``, whose seeds are small.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import warp as wp

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

from registration import measure_shape

from warp_partdr.body.template import LENGTH_NAMES, THICKNESS_NAMES
from warp_partdr.lab.synthetic.people import PHENOTYPES
from warp_partdr.models.anny import anny, anny_shape
from warp_partdr.models.growth import THICKNESS_RATIOS, Growth
from warp_partdr.models.surfaces import vertex_parts

PEOPLE, SEED = 100, 1000


def main() -> None:
    wp.config.log_level = wp.LOG_WARNING
    model = anny()
    low, high = np.array([*PHENOTYPES.values()]).T
    phenotypes = np.random.default_rng(SEED).uniform(low, high, (PEOPLE, len(PHENOTYPES)))
    shapes = anny_shape(phenotypes)
    measured = np.log([measure_shape(model, shape[None])[1] for shape in shapes])
    body = Growth(model, *vertex_parts(model), shapes)
    # The measures hold the ratios of now.
    assumed = np.log([THICKNESS_RATIOS[name][0] for name in THICKNESS_NAMES])
    ratios = measured - body.measured(shapes)[:, len(LENGTH_NAMES) :].numpy() + assumed
    for name, mean, spread in zip(THICKNESS_NAMES, np.exp(ratios.mean(0)), ratios.std(0, ddof=1), strict=True):
        print(f'    "{name}": ({mean:.3f}, {spread:.3f}),')


if __name__ == "__main__":
    main()
