"""Accuracy of fits with a known camera and without it, on PartBench's people whom a perspective camera sees.

At the level "near" all are 1.5 to 3 m before the camera, at "far" 9 to 40 m, up to 20 degrees beside its axis. Each is
fitted twice. Intervals of 95 % are over people.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...inputs.sample import Sample
from ...solve.ellipsoids.fitting import fit_body
from ...solve.ellipsoids.options import FitOptions
from ..evaluation.partbench.samples import make_sample
from ..evaluation.scoring import score_fit
from ..options import Levels, People, tracked
from ..tables import FigureTable, estimate_mean

_COLUMNS = {
    "quality": "",
    "people": "d",
    "figure": "",
    "without": ".1f",
    "known": ".1f",
    "change": "+.1f",
}


def measure_camera(*, people: People = range(200, 300), levels: Levels = ("realistic",)) -> Iterator[FigureTable | str]:
    """Fit people without their camera and with it.

    Args:
        people: People to fit.
        levels: Levels to fit them at: realistic, near, far.
    """
    for level in levels:
        table, sentences = FigureTable(level, _COLUMNS), []
        for name, options in (("balanced", FitOptions()), ("fast", FitOptions.at("fast"))):
            samples = (make_sample(index, level) for index in tracked(people))
            rows = np.array([_compare(sample, options) for sample in samples if sample.camera is not None])
            for column, figure in enumerate(("PA-MPJPE [mm]", "MPJPE [mm]")):
                without, known = rows[:, column], rows[:, 2 + column]
                means = float(np.nanmean(without)), float(np.nanmean(known))
                table.add(name, len(rows), figure, *means, estimate_mean(known - without))
            off = 100 * np.nanmedian(rows[:, 4])
            sentences.append(f"{name}: the pelvis is {off:.0f} % of its distance off, in the median.")
        yield table
        yield from sentences


def _compare(sample: Sample, options: FitOptions) -> list[float]:
    """PA-MPJPE and MPJPE without the camera and with it [mm], and the pelvis' error as a share of its distance."""
    found: list[float] = []
    off = np.nan
    assert sample.joints is not None
    for each in (None, sample.camera):
        result = fit_body(sample.keypoints, sample.parts, others=sample.others, options=options, camera=each)
        score = score_fit(sample, "", result, 0.0)
        found += [score.pa_mpjpe, score.mpjpe]
        hips = [sample.joint_names.index(f"{side}_hip") for side in ("left", "right")]
        true, fitted = (joints[hips].mean(0) for joints in (sample.joints, result.landmarks(sample.joint_names)))
        off = float(np.linalg.norm(fitted - true) / np.linalg.norm(true))
    return [*found, off]
