"""Measure and print what a scene of those who overlap gives a photo's people, against mesh stages of each alone.

    python scripts/measure_overlapping.py [FIRST LAST] [--mask]

PartBench's pairs at realistic noise, 100 to 129 if nothing is said, before their camera, fitted as `fit_photo` does;
with --mask, labels are each one's whole mask, as of a photo alone. Intervals are of 95 %, over pairs.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import torch
import warp as wp
from measure_camera import interval

from warp_partdr import FitOptions, metrics
from warp_partdr.body.labels import BACKGROUND, IGNORE
from warp_partdr.body.skeletons import MPJPE_JOINTS
from warp_partdr.inputs.evidence import weigh_evidence
from warp_partdr.inputs.masked_people import MASK_LABELS
from warp_partdr.inputs.part_labels import PartLabels
from warp_partdr.interop.torch_threads import one_torch_thread
from warp_partdr.lab.synthetic.scene_people import SceneSample, make_pair
from warp_partdr.solve.ellipsoids.fitting import fit_evidence
from warp_partdr.solve.ellipsoids.result import FitResult
from warp_partdr.solve.mesh.mesh_stage import MeshFit, refine_meshes
from warp_partdr.solve.scene.overlapping import refine_people

FIGURES = (
    "PA-MPJPE [mm]",
    "MPJPE before the camera [mm]",
    "depth order right [%]",
    "depth between off [mm]",
    "seconds",
)


def fitted(sample: SceneSample, mask: bool) -> list[FitResult]:
    """Fits of each of the people, from which mesh stages go on."""
    options, camera = FitOptions.at("balanced").without_outline(), sample.scene.views[0].camera
    found = []
    for sight in sample.scene.sights:
        parts = sight.parts
        if mask and parts is not None:
            shown = (parts.groups != BACKGROUND) & (parts.groups != IGNORE)
            parts = PartLabels(MASK_LABELS, np.where(shown, 1, parts.groups).astype(np.uint8))
        found.append(fit_evidence(weigh_evidence(sight.keypoints, parts), options, camera=camera))
    return found


def scored(sample: SceneSample, fits: list[MeshFit], seconds: float) -> list[float]:
    """``FIGURES`` of a pair."""
    truth = sample.scene.views[0].to_camera(torch.from_numpy(np.asarray(sample.joints[:, 0])).float()).numpy()
    joints = np.stack([fit.landmarks(MPJPE_JOINTS) for fit in fits])
    shapes = [float(metrics.pa_mpjpe(one, other)) for one, other in zip(joints, truth, strict=True)]
    between, wanted = (each[0, :, 2].mean() - each[1, :, 2].mean() for each in (joints, truth))
    away = np.linalg.norm(joints - truth, axis=-1).mean()
    order = 100.0 * (between * wanted > 0)
    return [1000 * float(np.mean(shapes)), 1000 * float(away), order, 1000 * abs(float(between - wanted)), seconds]


@one_torch_thread()
def main() -> None:
    """Fit, and print figures and differences."""
    wp.config.log_level = wp.LOG_WARNING
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("people", type=int, nargs="*", default=[100, 129], help="first and last")
    parser.add_argument("--mask", action="store_true", help="labels are whole masks")
    options = parser.parse_args()
    first, last = options.people
    rows = []
    for index in range(first, last + 1):
        sample = make_pair(index, "realistic")
        results, row = fitted(sample, options.mask), []
        for refine in (refine_meshes, refine_people):
            started = time.perf_counter()
            fits = refine(results)
            row.append(scored(sample, fits, time.perf_counter() - started))
        rows.append(row)
    alone, together = np.moveaxis(np.array(rows), 1, 0)
    for place, name in enumerate(FIGURES):
        before, after = alone[:, place], together[:, place]
        print(f"{name}: {before.mean():.1f} -> {after.mean():.1f}, {interval(after - before)}")


if __name__ == "__main__":
    main()
