"""Measure and print how far stature and girths of found bodies are from the true people's.

    python scripts/measure_girths.py [FIRST] [LAST]

PartBench's people FIRST to LAST, 300 to 339 unless told, which nothing was chosen on. "fitted": from labels and
keypoints of level "realistic" by the mesh stage; a single picture doesn't tell how large one is: "known stature" is
told the true one. "registered": to the EllipBody measured from the true body. Mean absolute errors with intervals
(95 %), and the mean error, which is no noise.
"""

from __future__ import annotations

import sys

import numpy as np
import torch
import warp as wp

from warp_partdr import FitOptions, fit_body, pose
from warp_partdr.lab.evaluation.partbench.samples import make_sample
from warp_partdr.lab.synthetic.partbench_people import draw_shape
from warp_partdr.metrics import bootstrap_sum
from warp_partdr.models.anny import anny
from warp_partdr.models.measuring import BODY_MEASURES, measure_body, measure_ellipbody
from warp_partdr.models.registration import register, ungrown
from warp_partdr.solve.mesh.mesh_stage import refine_mesh


def main(first: str = "300", last: str = "339") -> None:
    wp.config.log_level = wp.LOG_WARNING
    model = anny()
    people = range(int(first), int(last) + 1)
    found: dict[str, list[np.ndarray]] = {"fitted": [], "fitted, known stature": [], "registered": []}
    truths: list[np.ndarray] = []
    for index in people:
        shape = draw_shape(index)[0]
        truth = measure_body(model, model.rest(shape))[0].numpy()
        sample = make_sample(index, "realistic")
        fitted, known = (
            refine_mesh(fit_body(sample.keypoints, sample.parts, others=sample.others, options=options), model)
            for options in (FitOptions(), FitOptions(stature=float(truth[0])))
        )
        standing = torch.eye(3).expand(1, model.num_joints, 3, 3)
        ellipbody = pose(*measure_ellipbody(ungrown(model, shape, standing, torch.zeros(1, 3), {})))
        registered = measure_body(model, register(ellipbody, model).rest())[0].numpy()
        truths.append(truth)
        measured = [measure_body(model, each.body.rest())[0].numpy() for each in (fitted, known)]
        for name, measures in zip(found, (*measured, registered), strict=True):
            found[name].append(measures)
    for name, measures in found.items():
        report(name, 1000 * (np.array(measures) - np.array(truths)))


def report(name: str, errors: np.ndarray) -> None:
    """A line for each measure, errors of people (N, 5) [mm]."""
    for measure, column in zip(BODY_MEASURES, errors.T, strict=True):
        low, high = bootstrap_sum(np.abs(column), lambda sums: sums / len(errors))
        mean = f"{np.abs(column).mean():.1f} mm ({low:.1f} to {high:.1f})"
        print(f"{name:22s} {measure:12s} {mean}, mean error {column.mean():+.1f} mm, {len(column)} people")


if __name__ == "__main__":
    main(*sys.argv[1:])
