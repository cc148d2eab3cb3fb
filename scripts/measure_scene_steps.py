"""Measure and print the time of a scene's steps: people x frames before one camera.

    python scripts/measure_scene_steps.py [cpu|cuda] [PEOPLExFRAMES ...]

One of PartBench's people is everybody in all frames, for a step's time does not ask who is who. To look at sights and
what comes after the steps are not in it. Then the mesh stage's steps of that person, in turn with a scene's of one.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from statistics import median
from typing import Any

import torch
import warp as wp

from warp_partdr.inputs.scene import Scene
from warp_partdr.interop.torch_threads import one_torch_thread
from warp_partdr.lab.synthetic.scene_people import make_views
from warp_partdr.models.anny import anny
from warp_partdr.solve.ellipsoids.fitting import fit_body
from warp_partdr.solve.mesh.mesh_energy import gather_starts, mesh_energy
from warp_partdr.solve.mesh.mesh_options import MeshOptions
from warp_partdr.solve.mesh.steps import Steps, find_steps
from warp_partdr.solve.scene.fitting import scene_energy
from warp_partdr.solve.scene.looks import look_at
from warp_partdr.solve.scene.options import SceneOptions
from warp_partdr.solve.scene.start import gather_scene

MESH, _REPEATS = MeshOptions(iterations=50), 5


def scene_steps(people: int, frames: int, device: torch.device) -> Steps[Any, Any]:
    """Steps of so many people in so many frames."""
    model, options = anny(device), SceneOptions(mesh=MESH)
    one = make_views(3, 1).scene
    sights = [replace(one.sights[0], person=p, frame=t) for p in range(people) for t in range(frames)]
    scene = Scene(one.views, sights)
    looks = look_at(scene, device)
    labels = looks[0].seen.label_set
    energy = scene_energy(mesh_energy(model, options.mesh, labels), options, (tuple(range(people)),), labels.num_groups)
    with torch.no_grad():
        return find_steps(energy, gather_scene(energy, model, scene, looks), options.mesh)


def mesh_steps(device: torch.device) -> Steps[Any, Any]:
    """Steps of the mesh stage of one person."""
    model, scene = anny(device), make_views(3, 1).scene
    sight, camera = scene.sights[0], scene.views[0].camera
    fit = fit_body(sight.keypoints, sight.parts, quality="fast", device=str(device), camera=camera)
    energy = mesh_energy(model, MESH, fit.observation.label_set)
    with torch.no_grad():
        return find_steps(energy, gather_starts(energy, model, [fit]), MESH)


def measure(*ways: Steps[Any, Any]) -> list[float]:
    """Median seconds of all steps of each, in turn, after a first run."""
    found: list[list[float]] = [[] for _ in ways]
    for _ in range(1 + _REPEATS):
        for steps, times in zip(ways, found, strict=True):
            started = time.perf_counter()
            for _ in range(MESH.iterations):
                steps.step(0.5)
            if torch.cuda.is_available():
                torch.cuda.synchronize()
            times.append(time.perf_counter() - started)
    return [median(times[1:]) for times in found]


def main(where: str = "cpu", *sizes: str) -> None:
    wp.config.log_level = wp.LOG_WARNING
    device = torch.device(where, 0) if where == "cuda" else torch.device(where)
    for size in sizes or ("1x1", "2x8"):
        people, frames = map(int, size.split("x"))
        with one_torch_thread():
            (seconds,) = measure(scene_steps(people, frames, device))
        print(f"{where}, {people} people in {frames} frames: {MESH.iterations} steps take {1000 * seconds:.0f} ms")
    with one_torch_thread():
        scene, mesh = measure(scene_steps(1, 1, device), mesh_steps(device))
    times = f"as a scene {1000 * scene:.0f} ms, as a mesh stage {1000 * mesh:.0f}"
    print(f"{where}, one person: {times}: ratio {scene / mesh:.2f}")


if __name__ == "__main__":
    main(*sys.argv[1:])
