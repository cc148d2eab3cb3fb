"""Measure and print the time of the mesh stage for people side by side.

    python scripts/measure_mesh.py [PEOPLE ...]

PartBench's people from 200 on, fitted by the fast quality, on CUDA where there is some. Steps alone are what 60 of them
take beyond none: without starts, measuring and the whole mesh.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from statistics import median

import warp as wp

from warp_partdr import FitOptions, fit_body
from warp_partdr.evaluation.partbench.samples import make_sample
from warp_partdr.fit.mesh_options import MeshOptions
from warp_partdr.fit.mesh_stage import refine_meshes
from warp_partdr.fit.result import FitResult
from warp_partdr.interop.devices import choose_device

_DIFFERENT = 16  # people; more are these again
_REPEATS = 5


def fitted(index: int, device: str) -> FitResult:
    """A person's fit."""
    sample = make_sample(index, "realistic")
    fast = FitOptions.at("fast")
    return fit_body(sample.keypoints, sample.parts, others=sample.others, options=fast, device=device)


def seconds(results: list[FitResult], options: MeshOptions) -> float:
    """Median of some calls, after the first one."""
    found: list[float] = []
    for _ in range(1 + _REPEATS):
        started = time.perf_counter()
        refine_meshes(results, options=options)
        found.append(time.perf_counter() - started)
    return median(found[1:])


def main(*counts: int) -> None:
    wp.config.log_level = wp.LOG_WARNING
    device = choose_device("auto")
    several = [fitted(200 + index, device) for index in range(min(max(counts), _DIFFERENT))]
    options = MeshOptions()
    for count in counts:
        results = [several[place % len(several)] for place in range(count)]
        whole, none = (seconds(results, each) for each in (options, replace(options, iterations=0)))
        steps = 1000 * (whole - none)
        print(f"{device}, {count} people: {1000 * whole:.0f} ms, {options.iterations} steps alone {steps:.0f} ms")


if __name__ == "__main__":
    main(*(map(int, sys.argv[1:]) if sys.argv[1:] else (1, 8)))
