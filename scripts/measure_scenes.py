"""Measure and print what several cameras give, and people drawn together, on PartBench's people at realistic noise.

    python scripts/measure_scenes.py [FIRST LAST]

A pair starts in the wrong order: one grows and the other shrinks about the camera, so that each alone looks as before.
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from unittest import mock

import numpy as np
import torch
import warp as wp

from warp_partdr import metrics
from warp_partdr.body.skeletons import MPJPE_JOINTS
from warp_partdr.body.template import NUM_PARTS
from warp_partdr.clothing.anny import anny
from warp_partdr.fit.mesh_options import MeshOptions
from warp_partdr.render.mesh import draw_mesh
from warp_partdr.scenes import fitting
from warp_partdr.scenes.depth_order import grown
from warp_partdr.scenes.options import SceneOptions
from warp_partdr.scenes.scene import Scene
from warp_partdr.scenes.start import Looked, gather_scene, look_at
from warp_partdr.synthetic.people import anny_mesh
from warp_partdr.synthetic.scene_people import LABELS, SceneSample, make_pair, make_views

_APART = 1.08  # ratio of the distances of two people in the wrong order
# PartDR's rule, which alone has a z gradient, pulls about thrice as hard.
_PARTDR = MeshOptions(gradient="partdr", seg=0.033)
_HOW = {
    "edges": SceneOptions(),
    "partdr": SceneOptions(mesh=_PARTDR),
    "partdr without the z gradient": SceneOptions(mesh=replace(_PARTDR, depth_weight=0.0)),
}


def measure_views(first: int, last: int) -> None:
    """World MPJPE and PA-MPJPE with one, two and four cameras."""
    for count in (1, 2, 4):
        errors = []
        for index in range(first, last + 1):
            sample = make_views(index, count)
            found = fitting.fit_scene(sample.scene).landmarks(MPJPE_JOINTS)[0, 0].numpy()
            truth = sample.joints[0, 0]
            errors.append((np.linalg.norm(found - truth, axis=-1).mean(), float(metrics.pa_mpjpe(found, truth))))
        world, aligned = 1000 * np.mean(errors, axis=0)
        worst = 1000 * np.max(errors, axis=0)[0]
        print(f"{count} cameras: world MPJPE {world:.1f} mm (worst {worst:.0f}), PA-MPJPE {aligned:.1f} mm", flush=True)


def measure_pairs(first: int, last: int) -> None:
    """Part F1 by person and part, order in depth, and PA-MPJPE, with and without exchanges."""
    scores: dict[str, list[tuple[np.ndarray, bool, float]]] = {}
    for index in range(first, last + 1):
        sample = make_pair(index)
        sights = sample.scene.sights
        if {sight.person for sight in sights} != {0, 1}:
            continue
        alone = [
            fitting.fit_scene(replace(sample.scene, sights=[replace(each, person=0)]))
            for each in sorted(sights, key=lambda sight: sight.person)
        ]
        bodies = (
            torch.cat([each.vertices for each in alone]),
            torch.cat([each.landmarks(MPJPE_JOINTS) for each in alone]),
        )
        scores.setdefault("each alone", []).append(score(sample, *bodies))
        for name, options in _HOW.items():
            for exchanged in (True, False):
                found = fit_from_wrong_order(sample, options, exchanged=exchanged)
                row = score(sample, found.vertices, found.landmarks(MPJPE_JOINTS))
                scores.setdefault(name if exchanged else f"{name}, no exchanges", []).append(row)
    for name, rows in scores.items():
        hits, sizes = sum(counts for counts, _, _ in rows)
        right, errors = sum(ok for _, ok, _ in rows), np.mean([error for _, _, error in rows])
        print(
            f"{name}: part F1 {np.mean(2 * hits / sizes):.3f}, order right {right} of {len(rows)}, PA {errors:.1f} mm"
        )


def fit_from_wrong_order(sample: SceneSample, options: SceneOptions, *, exchanged: bool) -> fitting.SceneFit:
    """Fit whose start has the one behind in front."""
    depths = sample.scene.views[0].to_camera(torch.from_numpy(sample.joints[:, 0].mean(1)))[:, 2]
    front = int(depths.argmin())

    def wrong(scene: Scene, device: torch.device) -> list[Looked]:
        looks = look_at(scene, device)
        away = [
            1 / look.body.log_scale.exp().item() * look.seen.lens[0].item()
            for look in looks
            if look.seen.lens is not None
        ]
        ratio = away[1 - front] / away[front]
        if ratio < 1:
            return looks
        factor = math.sqrt(_APART * ratio)
        return [grown(look, factor if look.sight.person == front else 1 / factor) for look in looks]

    with mock.patch.object(fitting, "look_at", wrong):
        if exchanged:
            return fitting.fit_scene(sample.scene, options=options)
        with (
            mock.patch.object(fitting, "order_people", lambda *given: (gather_scene(*given), given[-1])),
            mock.patch.object(fitting, "exchange", return_value=None),
        ):
            return fitting.fit_scene(sample.scene, options=options)


def score(sample: SceneSample, vertices: torch.Tensor, joints: torch.Tensor) -> tuple[np.ndarray, bool, float]:
    """Hits and sizes of each person's parts, shape (2, 2 G), whether the order is right, and PA-MPJPE [mm]."""
    view = sample.scene.views[0]
    both = anny_mesh().repeated(2, NUM_PARTS, anny().num_vertices)
    drawn = draw_mesh(view.to_camera(vertices[:, 0]).flatten(0, 1)[None], both, view.camera, sample.parts.shape[1:])
    table = np.full(256, 255, dtype=np.uint8)
    for person in range(2):
        table[person * NUM_PARTS + 1 : (person + 1) * NUM_PARTS + 1] = (
            LABELS.part_groups[1 : NUM_PARTS + 1] + person * LABELS.num_groups
        )
    table[0] = 0
    found, true = table[drawn.labels[0].numpy()], table[sample.parts[0]]
    groups = np.arange(1, 2 * LABELS.num_groups + 1)
    hits = [((found == group) & (true == group)).sum() for group in groups]
    sizes = [(found == group).sum() + (true == group).sum() for group in groups]
    found_z, true_z = (
        view.to_camera(torch.as_tensor(each)[:, 0].float().mean(1))[:, 2] for each in (joints, sample.joints)
    )
    errors = [float(metrics.pa_mpjpe(joints[person, 0].numpy(), sample.joints[person, 0])) for person in range(2)]
    return np.array([hits, sizes]), bool((found_z[1] > found_z[0]) == (true_z[1] > true_z[0])), 1000 * np.mean(errors)


if __name__ == "__main__":
    wp.config.log_level = wp.LOG_WARNING
    first, last = (int(each) for each in (sys.argv[1:] or ("100", "139")))
    measure_views(first, last)
    measure_pairs(first, last)
