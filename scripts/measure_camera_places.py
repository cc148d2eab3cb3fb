"""Measure and print how far from the truth two cameras are placed by the people whom they see (``place_cameras``).

    python scripts/measure_camera_places.py FIRST LAST [MOCAP]

PartBench's people FIRST to LAST before two cameras: at one moment (the level "views") and, with the folder of motion
capture, in clips of 2 s, of which 32 frames are looked at. Lenses are known. Printed are the angle between the
cameras, the direction from the first to the second, their distance, and the mean of several runs' seconds.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from warp_partdr.scenes.camera_places import place_cameras
from warp_partdr.scenes.film_cameras import FRAMES
from warp_partdr.scenes.looks import look_at
from warp_partdr.scenes.scene import Scene, View
from warp_partdr.synthetic.mocap_files import FRAME_RATE, held_out_windows
from warp_partdr.synthetic.scene_people import make_clip, make_views


def main(first: int, last: int, mocap: Path | None) -> None:
    """Measure both."""
    people = range(first, last + 1)
    report("one moment", (make_views(index, 2).scene for index in people))
    if mocap is not None:
        clips = held_out_windows(mocap, 2.0)
        samples = (make_clip(index, clips[index % len(clips)], FRAME_RATE, num_views=2) for index in people)
        report("2 s", (some_frames(sample.scene) for sample in samples))


def some_frames(scene: Scene) -> Scene:
    """As many frames of a clip as a film's cameras are placed by."""
    chosen = np.unique(np.linspace(0, scene.num_frames - 1, FRAMES).round().astype(int)).tolist()
    sights = [replace(each, frame=chosen.index(each.frame)) for each in scene.sights if each.frame in chosen]
    return replace(scene, sights=sights)


@torch.no_grad()
def report(what: str, scenes: Iterable[Scene]) -> None:
    """Place the cameras of scenes, and print mean, median and largest deviations."""
    rows, seconds = [], []
    for scene in scenes:
        unknown = replace(scene, views=[scene.views[0], View(scene.views[1].camera)])
        looks = look_at(unknown, "cpu")
        began = time.perf_counter()
        found = place_cameras(unknown, looks=looks).views[1]
        seconds.append(time.perf_counter() - began)
        rows.append(deviations(scene.views[0], scene.views[1], found))
    for name, values in zip(
        ("angle [degrees]", "direction [degrees]", "distance [%]"), np.transpose(rows), strict=True
    ):
        size = np.abs(values)
        told = f"mean {size.mean():.1f}, median {np.median(size):.1f}, largest {size.max():.1f}"
        print(f"{what}, {name}: {told}")
    print(f"{what}: {np.mean(seconds):.2f} s")


def deviations(first: View, true: View, found: View) -> tuple[float, float, float]:
    """Angle, direction [degrees], and distance from the first camera [%]."""
    turn = (found.rotation @ true.rotation.mT).double()
    angle = math.degrees(math.acos(min(max((float(turn.trace()) - 1) / 2, -1.0), 1.0)))
    way, found_way = true.eye - first.eye, found.eye - first.eye
    cosine = float(torch.nn.functional.cosine_similarity(way, found_way, dim=0))
    distance = 100 * (float(found_way.norm() / way.norm()) - 1)
    return angle, math.degrees(math.acos(min(max(cosine, -1.0), 1.0))), distance


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]) if len(sys.argv) > 3 else None)
