"""Measure and print the time of the mesh stage for people side by side.

    python scripts/measure_mesh.py [PEOPLE ...]

PartBench's people from 200 on whose camera is known, or a batch would be two, fitted by the fast quality, on CUDA where
there is some. Steps alone are without starts, measuring and the whole mesh. Once more, with a clock that waits for the
device, says where the time goes.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from functools import partial
from itertools import count, islice
from statistics import median

import torch
import warp as wp
from measure_together import Steps

from warp_partdr import FitOptions, fit_body
from warp_partdr.interop.captured_step import CapturedStep
from warp_partdr.interop.devices import choose_device
from warp_partdr.interop.torch_threads import one_torch_thread
from warp_partdr.lab.evaluation.partbench.samples import make_sample
from warp_partdr.models import measuring
from warp_partdr.models.anny import anny
from warp_partdr.solve.ellipsoids.result import FitResult
from warp_partdr.solve.mesh import mesh_energy as mesh_energy_module
from warp_partdr.solve.mesh import mesh_stage
from warp_partdr.solve.mesh.mesh_energy import gather_starts, mesh_energy
from warp_partdr.solve.mesh.mesh_options import MeshOptions
from warp_partdr.solve.mesh.mesh_stage import refine_meshes
from warp_partdr.solve.mesh.steps import find_steps

PARTS = (
    (mesh_stage, "gather_starts", "starts"),
    (mesh_energy_module, "pose_from_ellipbody", "starts, poses"),
    (mesh_energy_module, "gather_keypoints", "starts, keypoints"),
    (mesh_energy_module, "gather_spreads", "starts, spreads"),
    (mesh_stage, "find_steps", "steps found or captured"),
    (CapturedStep, "replay", "steps"),
    (mesh_stage, "ungrown", "whole mesh"),
    (mesh_stage, "measure_parameters", "measured"),
    (measuring, "Growth", "measured, growth set up"),
    (measuring, "_rotations", "measured, rotations"),
    (mesh_stage, "check_finite", "checked"),
)
_DIFFERENT = 16  # people; more are these again
_REPEATS = 5


def fitted(index: int, device: str) -> FitResult:
    """A person's fit."""
    sample = make_sample(index, "realistic")
    fast = FitOptions.at("fast")
    return fit_body(sample.keypoints, sample.parts, others=sample.others, options=fast, device=device)


def measured(call: Callable[[], object], device: str) -> str:
    """Median of some calls' milliseconds, after the first one, and the least of the CPU."""
    found: list[tuple[float, float]] = []
    for _ in range(1 + _REPEATS):
        started, busy = time.perf_counter(), time.process_time()
        call()
        if device == "cuda":
            torch.cuda.synchronize()
        found.append((time.perf_counter() - started, time.process_time() - busy))
    walls, busies = zip(*found[1:], strict=True)
    return f"{1000 * median(walls):.0f} ms ({1000 * min(busies):.0f} of the CPU at least)"


def all_steps(results: list[FitResult], options: MeshOptions, device: str) -> Callable[[], None]:
    """The stage's steps, without anything before or after them."""
    model = anny(device)
    energy = mesh_energy(model, options, results[0].observation.label_set)
    with torch.no_grad():
        people = gather_starts(energy, model, results)
    steps = find_steps(energy, people, options)

    def run() -> None:
        for _ in range(options.iterations):
            steps.step(0.5)

    return run


def main(*counts: int) -> None:
    wp.config.log_level = wp.LOG_WARNING
    device, options = choose_device("auto"), MeshOptions()
    known = (each for each in map(partial(fitted, device=device), count(200)) if each.observation.lens is not None)
    several = list(islice(known, min(max(counts), _DIFFERENT)))
    for people in counts:
        results = [several[place % len(several)] for place in range(people)]
        with one_torch_thread():
            steps = measured(all_steps(results, options, device), device)
        whole = measured(partial(refine_meshes, results, options=options), device)
        print(f"{device}, {people} people: {whole}, {options.iterations} steps alone {steps}")
        parts = Steps(device, PARTS)
        parts.measure(partial(refine_meshes, results, options=options))
        parts.print(people)


if __name__ == "__main__":
    main(*(map(int, sys.argv[1:]) if sys.argv[1:] else (1, 8)))
