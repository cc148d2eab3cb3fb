"""Gain of a scene for people in a photo who overlap, against mesh stages of each person alone.

The people are PartBench's pairs at realistic noise before their camera, fitted as ``fit_photo`` does. With `--mask`,
labels are each person's whole mask, as in a photo alone. Intervals of 95 % are over pairs.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import torch

from ...body.labels import BACKGROUND, IGNORE
from ...body.skeletons import MPJPE_JOINTS
from ...inputs.evidence import MASK_LABELS, weigh_evidence
from ...inputs.part_labels import PartLabels
from ...interop.torch_threads import one_torch_thread
from ...metrics import pa_mpjpe
from ...solve.ellipsoids.fitting import fit_evidence
from ...solve.ellipsoids.options import FitOptions
from ...solve.ellipsoids.result import FitResult
from ...solve.mesh.mesh_stage import MeshFit, refine_meshes
from ...solve.scene.overlapping import refine_people
from ..options import People, tracked
from ..synthetic.scene_people import SceneSample, make_pair
from ..tables import FigureTable, estimate_mean

_FIGURES = (
    "PA-MPJPE [mm]",
    "MPJPE before the camera [mm]",
    "depth order right [%]",
    "depth between off [mm]",
    "seconds",
)


def measure_overlapping(*, people: People = range(100, 130), mask: bool = False) -> Iterator[FigureTable]:
    """Refine pairs of people apart and together.

    Args:
        people: First person of each pair.
        mask: Labels are whole masks.
    """
    rows = []
    with one_torch_thread():
        for index in tracked(people):
            sample = make_pair(index, "realistic")
            results, row = _fitted(sample, mask), []
            for refine in (refine_meshes, refine_people):
                started = time.perf_counter()
                fits = refine(results)
                row.append(_figures_of_pair(sample, fits, time.perf_counter() - started))
            rows.append(row)
    alone, together = np.moveaxis(np.array(rows), 1, 0)
    table = FigureTable(f"{len(people)} pairs", {"figure": "", "alone": ".1f", "scene": ".1f", "change": "+.1f"})
    for column, name in enumerate(_FIGURES):
        before, after = alone[:, column], together[:, column]
        table.add(name, float(before.mean()), float(after.mean()), estimate_mean(after - before))
    yield table


def _fitted(sample: SceneSample, mask: bool) -> list[FitResult]:
    """Fits of each person, from which mesh stages go on."""
    options, camera = FitOptions.at("balanced"), sample.scene.views[0].camera
    found = []
    for observation in sample.scene.observations:
        parts = observation.parts
        if mask and parts is not None:
            shown = (parts.groups != BACKGROUND) & (parts.groups != IGNORE)
            parts = PartLabels(MASK_LABELS, np.where(shown, 1, parts.groups).astype(np.uint8))
        found.append(fit_evidence(weigh_evidence(observation.keypoints, parts), options, camera=camera))
    return found


def _figures_of_pair(sample: SceneSample, fits: list[MeshFit], seconds: float) -> list[float]:
    """``_FIGURES`` of a pair."""
    truth = sample.scene.views[0].to_camera(torch.from_numpy(np.asarray(sample.joints[:, 0])).float()).numpy()
    joints = np.stack([fit.landmarks(MPJPE_JOINTS) for fit in fits])
    shapes = [float(pa_mpjpe(one, other)) for one, other in zip(joints, truth, strict=True)]
    between, wanted = (each[0, :, 2].mean() - each[1, :, 2].mean() for each in (joints, truth))
    away = np.linalg.norm(joints - truth, axis=-1).mean()
    order = 100.0 * (between * wanted > 0)
    return [1000 * float(np.mean(shapes)), 1000 * float(away), order, 1000 * abs(float(between - wanted)), seconds]
