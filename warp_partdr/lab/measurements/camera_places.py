"""Errors of two cameras that are placed by the people whom they see (``place_cameras``).

PartBench's people stand before two cameras, whose lenses are known: at one moment (the level "views") or, with motion
capture, in clips of 2 s, of which 32 frames are looked at. Shown are the angle between the cameras, the direction from
the first to the second, their distance, and the time. For clips, there are joints, too: by the first camera alone, by
both as they were placed, and by both as they stand. Intervals of 95 % are over people.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import torch

from ...body.skeletons import MPJPE_HIPS, MPJPE_JOINTS
from ...inputs.scene import Scene, View
from ...metrics import mpjpe, pa_mpjpe
from ...pipelines.camera_poses import place_cameras
from ...pipelines.film_cameras import choose_frames
from ...solve.scene.fitting import fit_scene
from ...solve.scene.observations import observe_scene
from ...solve.scene.options import SceneOptions
from ..evaluation.evaluate import one_thread
from ..options import Device, Jobs, People
from ..synthetic.mocap_files import FRAME_RATE, held_out_windows
from ..synthetic.scene_people import SceneSample, make_clip, make_views
from ..tables import FigureTable, estimate_mean

_ERRORS = "angle [degrees]", "direction [degrees]", "distance [%]", "time [s]"
_BODIES = "first camera alone", "both, found", "both, known"


def measure_camera_places(
    *, people: People = range(100, 140), mocap: Path | None = None, device: Device = "cpu", jobs: Jobs = 1
) -> Iterator[FigureTable]:
    """Place cameras.

    Args:
        people: People before the cameras.
        mocap: Folder of motion capture; clips then stand for one moment.
        device: Device of the fits.
        jobs: People at a time.
    """
    work = partial(_errors_of, mocap=mocap, device=device)
    with ProcessPoolExecutor(jobs, get_context("spawn"), one_thread) as pool:
        rows = np.array(list(pool.map(work, people)))
    cameras = FigureTable("Cameras", {"error": "", "mean": ".2f", "median": ".2f", "largest": ".2f"})
    for name, values in zip(_ERRORS, np.abs(rows.T), strict=False):
        cameras.add(name, float(values.mean()), float(np.median(values)), float(values.max()))
    yield cameras
    if mocap is not None:
        bodies = FigureTable("Bodies", {"cameras": "", "PA-MPJPE [mm]": ".1f", "MPJPE [mm]": ".1f"})
        for index, name in enumerate(_BODIES):
            aligned, plain = rows[:, len(_ERRORS) + 2 * index :][:, :2].T
            bodies.add(name, estimate_mean(aligned), estimate_mean(plain))
        yield bodies


@torch.no_grad()
def _errors_of(index: int, mocap: Path | None, device: str) -> list[float]:
    """``_ERRORS`` of a person, and PA-MPJPE and MPJPE [mm] of ``_BODIES``."""
    if mocap is None:
        sample = make_views(index, 2)
    else:
        clips = held_out_windows(mocap, 2.0)
        sample = make_clip(index, clips[index % len(clips)], FRAME_RATE, num_views=2)
    scene = sample.scene
    unknown = replace(scene, views=[scene.views[0], View(scene.views[1].camera)])
    seen = _some_frames(unknown)
    observed_bodies = observe_scene(seen, device)
    began = time.perf_counter()
    found = place_cameras(seen, observed_bodies=observed_bodies).views
    rows = [*_deviations(scene.views, found[1]), time.perf_counter() - began]
    if mocap is not None:
        alone = replace(
            scene, observations=[observation for observation in scene.observations if observation.view == 0]
        )
        for fitted in (alone, replace(scene, views=found), scene):
            rows += _errors_of_fit(sample, fitted, device)
    return rows


def _some_frames(scene: Scene) -> Scene:
    """Scene with as many of its frames as a film's cameras are placed by."""
    chosen = choose_frames(np.arange(scene.num_frames)).tolist()
    return replace(
        scene, observations=[observation for observation in scene.observations if observation.frame in chosen]
    )


def _deviations(views: Sequence[View], found: View) -> tuple[float, float, float]:
    """Angle, direction [degrees], and distance from the first camera [%]."""
    first, true = views
    turn = (found.rotation @ true.rotation.mT).double()
    angle = math.degrees(math.acos(min(max((float(turn.trace()) - 1) / 2, -1.0), 1.0)))
    way, found_way = true.eye - first.eye, found.eye - first.eye
    cosine = float(torch.nn.functional.cosine_similarity(way, found_way, dim=0))
    distance = 100 * (float(found_way.norm() / way.norm()) - 1)
    return angle, math.degrees(math.acos(min(max(cosine, -1.0), 1.0))), distance


def _errors_of_fit(sample: SceneSample, scene: Scene, device: str) -> tuple[float, float]:
    """PA-MPJPE and MPJPE of a fit [mm]."""
    found = fit_scene(scene, options=SceneOptions.film(), device=device).landmarks(MPJPE_JOINTS).cpu().numpy()
    errors = pa_mpjpe(found, sample.joints), mpjpe(found, sample.joints, centre_on=MPJPE_HIPS)
    return 1000 * float(errors[0].mean()), 1000 * float(errors[1].mean())
