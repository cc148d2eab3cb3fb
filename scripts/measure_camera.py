"""Measure and print what a known camera is worth to fits, on PartBench's people whom a perspective camera sees.

    python scripts/measure_camera.py [--near | --far] [FIRST LAST]

``--near``: all are 1.5 to 3 m before the camera, ``--far``: 9 to 40 m, up to 20 degrees beside its axis. Each is fitted
twice at the level "realistic", without the camera and with it. Intervals are of 95 %, over people.
"""

from __future__ import annotations

import sys

import numpy as np
import warp as wp

from warp_partdr import FitOptions, fit_body, metrics
from warp_partdr.inputs.sample import Sample
from warp_partdr.lab.evaluation.partbench.samples import FAR, NEAR, make_sample
from warp_partdr.lab.evaluation.scoring import score_fit


def main(first: int = 200, last: int = 299, *, level: str = "realistic") -> None:
    wp.config.log_level = wp.LOG_WARNING
    for name, options in (("default", FitOptions()), ("fast", FitOptions.at("fast"))):
        rows = []
        for index in range(first, last + 1):
            sample = make_sample(index, level)
            if sample.camera is not None:
                rows.append(compare(sample, options))
        table = np.array(rows)
        print(f"{name}: {len(table)} people")
        for column, what in enumerate(("PA-MPJPE [mm]", "MPJPE [mm]")):
            without, known = table[:, column], table[:, 2 + column]
            print(f"  {what}: {np.nanmean(without):.1f} -> {np.nanmean(known):.1f}, {interval(known - without)}")
        print(f"  place of the pelvis: {100 * np.nanmedian(table[:, 4]):.0f} % of the distance off, in the median")


def compare(sample: Sample, options: FitOptions) -> list[float]:
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
        off = np.linalg.norm(fitted - true) / np.linalg.norm(true)
    return [*found, float(off)]


def interval(differences: np.ndarray) -> str:
    """Mean of differences and its 95 % interval."""
    known = differences[np.isfinite(differences)]
    low, high = metrics.bootstrap_sum(known, lambda sums: sums / len(known))
    return f"{known.mean():+.1f} ({low:+.1f} to {high:+.1f})"


if __name__ == "__main__":
    levels = {"--near": NEAR, "--far": FAR}
    asked = [levels[each] for each in sys.argv[1:] if each in levels]
    main(*[int(each) for each in sys.argv[1:] if each not in levels], level=(asked or ["realistic"])[0])
