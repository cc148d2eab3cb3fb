"""Time of a scene's steps, for people and frames before one camera.

One of PartBench's people is everybody in all frames, because a step takes the same time for all people. The times leave
out the predictions of the network and what comes after the steps. The steps of a mesh stage with that person are
measured, too, in turn with those of a scene with one person.
Times are medians, after a first run.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from statistics import median
from typing import Annotated

import torch
from cyclopts import Parameter

from ...errors import InputError
from ...inputs.scene import Scene
from ...interop.torch_threads import one_torch_thread
from ...models.anny import anny
from ...solve.ellipsoids.fitting import fit_body
from ...solve.mesh.energy import mesh_energy
from ...solve.mesh.gather import gather_starts
from ...solve.mesh.mesh_options import MeshOptions
from ...solve.mesh.observed_body import ObservedBody
from ...solve.mesh.steps import Steps, find_steps
from ...solve.scene.observations import observe_scene
from ...solve.scene.options import SceneOptions
from ...solve.scene.plan import plan_scene
from ...solve.scene.start import gather_scene
from ..clocks import synchronize
from ..options import Device
from ..synthetic.scene_people import make_views
from ..tables import FigureTable

_MESH, _REPEATS = MeshOptions(iterations=50), 5


def _check_sizes(_: type, sizes: Sequence[str]) -> None:
    for size in sizes:
        if not re.fullmatch(r"[1-9]\d*x[1-9]\d*", size):
            raise InputError(f"sizes: {size}; expected PEOPLExFRAMES, such as 8x64")


def measure_scene_steps(
    *,
    sizes: Annotated[tuple[str, ...], Parameter(show_default=" ".join, validator=_check_sizes)] = ("1x1", "2x8"),
    device: Device = "cpu",
) -> Iterator[FigureTable | str]:
    """Time steps of scenes.

    Args:
        sizes: Numbers of people and frames, PEOPLExFRAMES.
        device: Device of the steps.
    """
    where = torch.device(device, 0) if device == "cuda" else torch.device(device)
    columns = {"people": "d", "frames": "d", f"{_MESH.iterations} steps [ms]": ".0f"}
    table = FigureTable(f"Steps of scenes on {device}", columns)
    for size in sizes:
        people, frames = map(int, size.split("x"))
        with one_torch_thread():
            (seconds,) = _seconds_of(device, _scene_steps(people, frames, where))
        table.add(people, frames, 1000 * seconds)
    yield table
    with one_torch_thread():
        scene, mesh = _seconds_of(device, _scene_steps(1, 1, where), _mesh_steps(where))
    times = f"as a scene {1000 * scene:.0f} ms, as a mesh stage {1000 * mesh:.0f} ms"
    yield f"One person: {times}, ratio {scene / mesh:.2f}"


def _scene_steps(people: int, frames: int, device: torch.device) -> Steps:
    """Steps of so many people in so many frames."""
    model, options = anny(device), SceneOptions(mesh=_MESH)
    one = make_views(3, 1).scene
    observations = [replace(one.observations[0], person=p, frame=t) for p in range(people) for t in range(frames)]
    scene = Scene(one.views, observations)
    observed_bodies = observe_scene(scene, device)
    plan = plan_scene(scene, observed_bodies, model, options)
    with torch.no_grad():
        return find_steps(plan.energy, gather_scene(plan, observed_bodies))


def _mesh_steps(device: torch.device) -> Steps:
    """Steps of the mesh stage of one person."""
    model, scene = anny(device), make_views(3, 1).scene
    observation, camera = scene.observations[0], scene.views[0].camera
    fit = fit_body(observation.keypoints, observation.parts, quality="fast", device=str(device), camera=camera)
    energy = mesh_energy(model, _MESH, fit.observation.label_set)
    with torch.no_grad():
        return find_steps(energy, gather_starts(energy, model, [ObservedBody.of_fit(fit)]))


def _seconds_of(device: str, *ways: Steps) -> list[float]:
    """Median seconds of all steps of each, in turn, after a first run."""
    found: list[list[float]] = [[] for _ in ways]
    for _ in range(1 + _REPEATS):
        for steps, times in zip(ways, found, strict=True):
            started = time.perf_counter()
            for _ in range(_MESH.iterations):
                steps.step(0.5)
            synchronize(device)
            times.append(time.perf_counter() - started)
    return [median(times[1:]) for times in found]
