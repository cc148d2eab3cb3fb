"""Measure and print the time of a scene's steps: people x frames before one camera.

    python scripts/measure_scene_steps.py [cpu|cuda] [PEOPLExFRAMES ...]

One of PartBench's people is everybody in all frames, for a step's time does not ask who is who. To look at sights and
what comes after the steps are not in it.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from statistics import median

import torch
import warp as wp

from warp_partdr.clothing.anny import anny
from warp_partdr.fit.mesh_energy import mesh_energy
from warp_partdr.fit.mesh_options import MeshOptions
from warp_partdr.fit.steps import find_steps
from warp_partdr.interop.torch_threads import one_torch_thread
from warp_partdr.scenes.fitting import scene_energy
from warp_partdr.scenes.looks import look_at
from warp_partdr.scenes.options import SceneOptions
from warp_partdr.scenes.scene import Scene
from warp_partdr.scenes.start import gather_scene
from warp_partdr.synthetic.scene_people import make_views

_STEPS, _REPEATS = 50, 5


def measure(people: int, frames: int, device: torch.device) -> float:
    """Median seconds of all steps, after a first run."""
    model, options = anny(device), SceneOptions(mesh=MeshOptions(iterations=_STEPS))
    one = make_views(3, 1).scene
    sights = [replace(one.sights[0], person=p, frame=t) for p in range(people) for t in range(frames)]
    scene = Scene(one.views, sights)
    looks = look_at(scene, device)
    labels = looks[0].seen.label_set
    energy = scene_energy(mesh_energy(model, options.mesh, labels), options, (tuple(range(people)),), labels.num_groups)
    with torch.no_grad():
        starts = gather_scene(energy, model, scene, looks)
    steps, found = find_steps(energy, starts, options.mesh), []
    for _ in range(1 + _REPEATS):
        started = time.perf_counter()
        for _ in range(_STEPS):
            steps.step(0.5)
        if device.type == "cuda":
            torch.cuda.synchronize()
        found.append(time.perf_counter() - started)
    return median(found[1:])


def main(where: str = "cpu", *sizes: str) -> None:
    wp.config.log_level = wp.LOG_WARNING
    device = torch.device(where, 0) if where == "cuda" else torch.device(where)
    for size in sizes or ("1x1", "2x8"):
        people, frames = map(int, size.split("x"))
        with one_torch_thread():
            seconds = measure(people, frames, device)
        print(f"{where}, {people} people in {frames} frames: {_STEPS} steps take {1000 * seconds:.0f} ms")


if __name__ == "__main__":
    main(*sys.argv[1:])
