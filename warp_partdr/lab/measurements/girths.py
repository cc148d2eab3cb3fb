"""Errors of the stature and the girths of found bodies.

"Fitted" bodies come from labels and keypoints by the mesh stage. A single picture doesn't tell how large somebody is:
"known stature" is given the true one. "Registered" bodies come from the EllipBody that was measured on the true body.
Shown are mean absolute errors with intervals of 95 % over people, and the mean error, which is no noise.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch

from ...body.posing import pose
from ...models.anny import anny
from ...models.measuring import BODY_MEASURES, measure_body, measure_ellipbody
from ...models.registration import register, ungrown
from ...solve.ellipsoids.fitting import fit_body
from ...solve.ellipsoids.options import FitOptions
from ...solve.mesh.mesh_stage import refine_mesh
from ..evaluation.partbench.samples import make_sample
from ..options import Levels, People, tracked
from ..synthetic.partbench_people import draw_shape
from ..tables import FigureTable, estimate_mean


def measure_girths(*, people: People = range(300, 340), levels: Levels = ("realistic",)) -> Iterator[FigureTable]:
    """Measure fitted and registered bodies.

    Args:
        people: People to fit; nothing was chosen on the default ones.
        levels: Levels to fit them at.
    """
    for level in levels:
        yield _table_at(people, level)


def _table_at(people: range, level: str) -> FigureTable:
    model = anny()
    found: dict[str, list[np.ndarray]] = {"fitted": [], "fitted, known stature": [], "registered": []}
    truths: list[np.ndarray] = []
    for index in tracked(people):
        shape = draw_shape(index)[0]
        truth = measure_body(model, model.rest(shape))[0].numpy()
        sample = make_sample(index, level)
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
    columns = {"body": "", "measure": "", "absolute error [mm]": ".1f", "mean error [mm]": "+.1f"}
    table = FigureTable(f"{level}, {len(people)} people", columns)
    for name, bodies in found.items():
        errors = 1000 * (np.array(bodies) - np.array(truths))
        for measure, column in zip(BODY_MEASURES, errors.T, strict=True):
            table.add(name, measure, estimate_mean(np.abs(column)), float(column.mean()))
    return table
