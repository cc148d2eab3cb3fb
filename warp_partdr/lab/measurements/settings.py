"""Changes by single settings of a fit, on PartBench's people.

A fit with each setting is compared with the one without settings. The quality "network" refines nothing, and "mesh" is
the mesh stage after the quality "fast". Intervals of 95 % are over people.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np

from ...solve.ellipsoids.fitting import fit_body
from ...solve.ellipsoids.options import FitOptions
from ...solve.mesh.mesh_stage import refine_mesh
from ..evaluation.partbench.samples import make_sample
from ..evaluation.scoring import score_fit
from ..options import Levels, People, Settings, tracked, with_setting
from ..tables import FigureTable, estimate_mean

_PLAIN = "without settings"


def measure_settings(
    *,
    settings: Settings = (),
    people: People = range(200, 300),
    levels: Levels = ("realistic",),
    quality: Literal["network", "fast", "balanced", "accurate", "mesh"] = "fast",
) -> Iterator[FigureTable]:
    """Compare fits with one setting each.

    Args:
        settings: Changes, one a fit.
        people: People to fit.
        levels: Levels to fit them at.
        quality: Quality of the fit that is changed.
    """
    plain = FitOptions(stages=()) if quality == "network" else FitOptions.at("fast" if quality == "mesh" else quality)
    options = {_PLAIN: plain} | {setting: with_setting(plain, setting) for setting in settings}
    for level in levels:
        errors: dict[str, list[tuple[float, float]]] = {name: [] for name in options}
        for index in tracked(people):
            sample = make_sample(index, level)
            for name, given in options.items():
                result = fit_body(sample.keypoints, sample.parts, others=sample.others, options=given)
                mesh = refine_mesh(result, options=given.mesh) if quality == "mesh" else None
                score = score_fit(sample, name, mesh or result, 0.0)
                errors[name].append((score.pa_mpjpe, score.mpjpe))
        table = FigureTable(
            f"{level}, {quality}, {len(people)} people",
            {"fit": "", "PA-MPJPE [mm]": ".1f", "change": "+.1f", "MPJPE [mm]": ".1f", "change of it": "+.1f"},
        )
        for name, rows in errors.items():
            aligned, plain_error = np.array(rows).T
            before = np.array(errors[_PLAIN]).T
            changes = [estimate_mean(each) for each in (aligned - before[0], plain_error - before[1])]
            table.add(name, float(np.nanmean(aligned)), changes[0], float(np.nanmean(plain_error)), changes[1])
        yield table
