"""Measure and print how far from the truth two cameras are placed by the people whom they see (``place_cameras``).

    python scripts/measure_camera_places.py FIRST LAST [--mocap FOLDER] [--device cuda] [--jobs N]

PartBench's people FIRST to LAST before two cameras, whose lenses are known: at one moment (the level "views") or, with
the folder of motion capture, in clips of 2 s, of which 32 frames are looked at. Printed are the angle between the
cameras, the direction from the first to the second, their distance, and the time; of clips also what bodies have of
it: joints by the first camera alone, by both as they were placed, and as they stand.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import torch
from measure_camera import interval

from warp_partdr import metrics
from warp_partdr.body.skeletons import MPJPE_HIPS, MPJPE_JOINTS
from warp_partdr.inputs.scene import Scene, View
from warp_partdr.lab.evaluation.evaluate import one_thread
from warp_partdr.lab.synthetic.mocap_files import FRAME_RATE, held_out_windows
from warp_partdr.lab.synthetic.scene_people import SceneSample, make_clip, make_views
from warp_partdr.pipelines.camera_places import place_cameras
from warp_partdr.pipelines.film_cameras import spread
from warp_partdr.solve.scene.fitting import fit_scene
from warp_partdr.solve.scene.looks import look_at
from warp_partdr.solve.scene.options import SceneOptions

NAMES = "angle [degrees]", "direction [degrees]", "distance [%]", "time [s]"
BODIES = "first camera alone", "both, found", "both, known"


def main() -> None:
    """Measure, and print means, medians and the largest."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("people", type=int, nargs=2, metavar=("FIRST", "LAST"))
    parser.add_argument("--mocap", type=Path, help="motion capture: clips instead of one moment")
    parser.add_argument("--device", default="cpu", help="cpu or cuda")
    parser.add_argument("--jobs", type=int, default=1, help="people at a time, in processes of their own")
    options = parser.parse_args()
    first, last = options.people
    work = partial(measure, mocap=options.mocap, device=options.device)
    with ProcessPoolExecutor(options.jobs, get_context("spawn"), one_thread) as pool:
        rows = np.array(list(pool.map(work, range(first, last + 1))))
    for name, values in zip(NAMES, np.abs(rows.T), strict=False):
        print(f"{name}: mean {values.mean():.2f}, median {np.median(values):.2f}, largest {values.max():.2f}")
    for place, name in enumerate(BODIES if options.mocap else ()):
        pair = rows[:, len(NAMES) + 2 * place :][:, :2]
        told = [interval(each) for each in pair.T]
        print(f"{name}: PA-MPJPE {told[0]}, MPJPE {told[1]} mm")


@torch.no_grad()
def measure(index: int, mocap: Path | None, device: str) -> list[float]:
    """``NAMES`` of a person, and PA-MPJPE and MPJPE [mm] of ``BODIES``."""
    if mocap is None:
        sample = make_views(index, 2)
    else:
        clips = held_out_windows(mocap, 2.0)
        sample = make_clip(index, clips[index % len(clips)], FRAME_RATE, num_views=2)
    scene = sample.scene
    unknown = replace(scene, views=[scene.views[0], View(scene.views[1].camera)])
    seen = some_frames(unknown)
    looks = look_at(seen, device)
    began = time.perf_counter()
    found = place_cameras(seen, looks=looks).views
    rows = [*deviations(scene.views, found[1]), time.perf_counter() - began]
    if mocap is not None:
        alone = replace(scene, sights=[sight for sight in scene.sights if sight.view == 0])
        for fitted in (alone, replace(scene, views=found), scene):
            rows += joint_errors(sample, fitted, device)
    return rows


def some_frames(scene: Scene) -> Scene:
    """As many frames as a film's cameras are placed by."""
    chosen = spread(np.arange(scene.num_frames)).tolist()
    return replace(scene, sights=[sight for sight in scene.sights if sight.frame in chosen])


def deviations(views: Sequence[View], found: View) -> tuple[float, float, float]:
    """Angle, direction [degrees], and distance from the first camera [%]."""
    first, true = views
    turn = (found.rotation @ true.rotation.mT).double()
    angle = math.degrees(math.acos(min(max((float(turn.trace()) - 1) / 2, -1.0), 1.0)))
    way, found_way = true.eye - first.eye, found.eye - first.eye
    cosine = float(torch.nn.functional.cosine_similarity(way, found_way, dim=0))
    distance = 100 * (float(found_way.norm() / way.norm()) - 1)
    return angle, math.degrees(math.acos(min(max(cosine, -1.0), 1.0))), distance


def joint_errors(sample: SceneSample, scene: Scene, device: str) -> tuple[float, float]:
    """PA-MPJPE and MPJPE of a fit [mm]."""
    found = fit_scene(scene, options=SceneOptions.film(), device=device).landmarks(MPJPE_JOINTS).cpu().numpy()
    errors = metrics.pa_mpjpe(found, sample.joints), metrics.mpjpe(found, sample.joints, centre_on=MPJPE_HIPS)
    return 1000 * float(errors[0].mean()), 1000 * float(errors[1].mean())


if __name__ == "__main__":
    main()
