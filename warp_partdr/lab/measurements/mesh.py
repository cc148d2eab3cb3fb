"""Time of the mesh stage for people side by side.

The people are PartBench's from 200 on whose camera is known, or a batch would be two, fitted by the fast quality. Steps
alone are without starts, measuring and the whole mesh. Once more, with a clock that waits for the device, says where
the time goes. Times are medians, after a first run.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import count, islice
from statistics import median

import torch

from ...interop.captured_step import CapturedStep
from ...interop.devices import choose_device
from ...interop.torch_threads import one_torch_thread
from ...models import measuring
from ...models.anny import anny
from ...solve.ellipsoids.fitting import fit_body
from ...solve.ellipsoids.options import FitOptions
from ...solve.ellipsoids.result import FitResult
from ...solve.mesh import gather, mesh_stage, steps
from ...solve.mesh.energy import mesh_energy
from ...solve.mesh.gather import gather_starts
from ...solve.mesh.mesh_options import MeshOptions
from ...solve.mesh.mesh_stage import refine_meshes
from ...solve.mesh.observed_body import ObservedBody
from ...solve.mesh.steps import find_steps
from ..clocks import Step, StepClock, synchronize
from ..evaluation.partbench.samples import make_sample
from ..options import Counts, Device
from ..tables import FigureTable

_STEPS = (
    Step(mesh_stage, "gather_starts", "starts"),
    Step(gather, "shape_from_lengths", "starts, shapes"),
    Step(gather, "pose_from_ellipbody", "starts, poses"),
    Step(gather, "gather_aims", "starts, keypoints and depths"),
    Step(gather, "gather_turn_uncertainties", "starts, uncertainty of turns"),
    Step(steps, "find_steps", "steps found or captured"),
    Step(CapturedStep, "replay", "steps"),
    Step(mesh_stage, "ungrown", "whole mesh"),
    Step(mesh_stage, "measure_parameters", "measured"),
    Step(measuring, "call_as_graph", "measured, EllipBody"),
    Step(measuring, "Growth", "measured, growth set up"),
    Step(measuring, "_rotations", "measured, rotations"),
    Step(mesh_stage, "check_finite", "checked"),
)
_DIFFERENT = 16  # people; more are these again
_REPEATS = 5


def measure_mesh(*, counts: Counts = (1, 8), device: Device = "auto") -> Iterator[FigureTable]:
    """Time the mesh stage.

    Args:
        counts: Numbers of people side by side.
        device: Device of the fits.
    """
    where, options = choose_device(device), MeshOptions()
    known = (each for each in map(partial(_fitted, device=where), count(200)) if each.observation.lens is not None)
    several = list(islice(known, min(max(counts), _DIFFERENT)))
    columns = {"people": "d", "mesh stage [ms]": ".0f", "CPU at least [ms]": ".0f"}
    columns |= {f"{options.iterations} steps alone [ms]": ".0f", "likewise [ms]": ".0f"}
    table, clocks = FigureTable(f"Mesh stage on {where}", columns), []
    for people in counts:
        results = [several[index % len(several)] for index in range(people)]
        with one_torch_thread():
            alone = _timed(_all_steps(results, options, where), where)
        whole = _timed(partial(refine_meshes, results, options=options), where)
        table.add(people, whole.wall, whole.busy, alone.wall, alone.busy)
        clock = StepClock(where, _STEPS)
        clock.measure(partial(refine_meshes, results, options=options))
        clocks.append(clock.table(f"{people} people", people))
    yield table
    yield from clocks


def _fitted(index: int, device: str) -> FitResult:
    """Fit of a person."""
    sample = make_sample(index, "realistic")
    fast = FitOptions.at("fast")
    return fit_body(sample.keypoints, sample.parts, others=sample.others, options=fast, device=device)


@dataclass(frozen=True)
class _Milliseconds:
    """Median of some calls, after the first one, and the least of the CPU [ms]."""

    wall: float
    busy: float


def _timed(call: Callable[[], object], device: str) -> _Milliseconds:
    walls, busies = [], []
    for _ in range(1 + _REPEATS):
        started, busy = time.perf_counter(), time.process_time()
        call()
        synchronize(device)
        walls.append(1000 * (time.perf_counter() - started))
        busies.append(1000 * (time.process_time() - busy))
    return _Milliseconds(median(walls[1:]), min(busies[1:]))


def _all_steps(results: list[FitResult], options: MeshOptions, device: str) -> Callable[[], None]:
    """The stage's steps, without anything before or after them."""
    model = anny(device)
    energy = mesh_energy(model, options, results[0].observation.label_set)
    with torch.no_grad():
        people = gather_starts(energy, model, [ObservedBody.of_fit(each) for each in results])
    found = find_steps(energy, people)

    def run() -> None:
        for _ in range(options.iterations):
            found.step(0.5)

    return run
