"""Measure and print what settings of a fit change, one at a time, on PartBench's people.

    python scripts/measure_settings.py LEVEL QUALITY FIRST LAST [NAME=VALUE ...]

QUALITY: fast, balanced or accurate; network, which refines nothing; or mesh, the mesh stage after fast. NAME=VALUE as
`partdr fit --set` takes them. Differences are those to the fit without settings; intervals are of 95 %, over people.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import warp as wp
from measure_camera import interval

from warp_partdr import FitOptions, fit_body
from warp_partdr.files.sections import set_value
from warp_partdr.lab.evaluation.partbench.samples import make_sample
from warp_partdr.lab.evaluation.scoring import score_fit
from warp_partdr.solve.ellipsoids.settings import change_options
from warp_partdr.solve.mesh.mesh_stage import refine_mesh

_PLAIN = "without settings"


def main(level: str, quality: str, first: str, last: str, *settings: str) -> None:
    wp.config.log_level = wp.LOG_WARNING
    plain = FitOptions(stages=()) if quality == "network" else FitOptions.at("fast" if quality == "mesh" else quality)
    options = {_PLAIN: plain}
    for setting in settings:
        values: dict[str, Any] = {}
        set_value(values, setting)
        options[setting] = change_options(plain, values)
    errors: dict[str, list[tuple[float, float]]] = {name: [] for name in options}
    for index in range(int(first), int(last) + 1):
        sample = make_sample(index, level)
        for name, given in options.items():
            result = fit_body(sample.keypoints, sample.parts, others=sample.others, options=given)
            mesh = refine_mesh(result, options=given.mesh) if quality == "mesh" else None
            score = score_fit(sample, name, mesh or result, 0.0)
            errors[name].append((score.pa_mpjpe, score.mpjpe))
    for name, rows in errors.items():
        print(f"{level}, {quality}, {name}:")
        changes = np.array(rows) - np.array(errors[_PLAIN])
        for column, what in enumerate(("PA-MPJPE [mm]", "MPJPE [mm]")):
            print(f"  {what} {np.nanmean(np.array(rows)[:, column]):.1f}, {interval(changes[:, column])}")


if __name__ == "__main__":
    main(*sys.argv[1:])
