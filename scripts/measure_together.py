"""Measure and print how many people a second are fitted side by side, from crops on the device to bodies.

    python scripts/measure_together.py [--half] [--alone] [DEVICE [PEOPLE...]]

``--half`` asks the network in bfloat16, ``--alone`` without the mirror image. PartBench's first 64 people at realistic
noise, again and again; each number of people three times, the last one counts. A fourth time, which waits for the
device after each step, says where the time goes.
"""

from __future__ import annotations

import sys
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any
from unittest.mock import patch

import torch
import warp as wp

from warp_partdr.bulk.people import kept_label_size, stages_of_quality
from warp_partdr.bulk.rows import PeopleRows, columns, describe_bodies, people_table
from warp_partdr.inputs.cut_people import CutPeople, CutPerson
from warp_partdr.inputs.evidence import weigh_evidence
from warp_partdr.inputs.observation import crop_evidence
from warp_partdr.lab.evaluation.partbench.samples import make_sample
from warp_partdr.networks.regression import predict
from warp_partdr.networks.regression.checkpoint import packaged_network
from warp_partdr.solve.ellipsoids import captured, depth_flips, together
from warp_partdr.solve.ellipsoids.batch import Batch
from warp_partdr.solve.ellipsoids.together import fit_together

_DISTINCT = 64
STEPS = (
    (predict, "upright_inputs", "network, its input"),
    (together, "ask_network", "network"),
    (Batch, "of_stacked", "landmarks in their places"),
    (Batch, "drawn_at", "label images resized"),
    (depth_flips, "_propose", "depth flips proposed"),
    (together, "repair_depth_orders", "depth flips chosen"),
    (captured.CapturedRefinement, "__init__", "refinement, set up and captured"),
    (captured.CapturedRefinement, "refine", "refinement, replayed"),
)


def main(*given: str) -> None:
    wp.config.log_level = wp.LOG_WARNING
    device, *counts = [each for each in given if not each.startswith("--")] or ["cpu"]
    how = {"half": "--half" in given, "mirror": "--alone" not in given}
    network = packaged_network(device)
    size = kept_label_size(stages_of_quality("fast"), network, meshes=False)
    some = [cut(index, size) for index in range(_DISTINCT)]
    for quality in ("network", "fast"):
        options = replace(stages_of_quality(quality), **how)  # type: ignore[arg-type]
        for count in map(int, counts or ("64",)):
            people = CutPeople.of([some[row % _DISTINCT] for row in range(count)]).to(device)
            for _ in range(3):
                wait(device)
                began = time.perf_counter()
                fits = fit_together(people, options, network)
                wait(device)
                seconds = time.perf_counter() - began
            print(f"{quality}, {count} people: {count / seconds:.0f} a second", flush=True)
            steps = Steps(device, STEPS)
            steps.measure(lambda: fit_together(people, options, network))  # noqa: B023  at once
            steps.print(count)
            began = time.perf_counter()
            rows = PeopleRows(count, describe_bodies(fits))
            people_table(rows, columns("coco17"), {})
            print(f"  {1e6 * (time.perf_counter() - began) / count:8.1f} us a person: rows of a data set, beside it")


def wait(device: str) -> None:
    if device != "cpu":
        torch.cuda.synchronize()


class Steps:
    """Seconds of the steps of a fit, each without those of steps inside it; where they are, their names, and what."""

    def __init__(self, device: str, steps: Sequence[tuple[Any, str, str]]) -> None:
        self.device, self.steps = device, steps
        self.seconds: dict[str, float] = defaultdict(float)
        self._inner = [0.0]

    def measure(self, work: Callable[[], Any]) -> None:
        """Run it with a clock in each step."""
        patches = [
            patch.object(where, name, self._clocked(getattr(where, name), what)) for where, name, what in self.steps
        ]
        for each in patches:
            each.start()
        try:
            self._clocked(work, "results and the rest")()
        finally:
            for each in patches:
                each.stop()

    def print(self, people: int) -> None:
        """Microseconds a person, the longest first."""
        for what, seconds in sorted(self.seconds.items(), key=lambda step: -step[1]):
            print(f"  {1e6 * seconds / people:8.1f} us a person: {what}")

    def _clocked(self, work: Callable[..., Any], what: str) -> Callable[..., Any]:
        def clocked(*args: Any, **options: Any) -> Any:
            wait(self.device)
            began = time.perf_counter()
            self._inner.append(0.0)
            try:
                return work(*args, **options)
            finally:
                wait(self.device)
                took = time.perf_counter() - began
                self.seconds[what] += took - self._inner.pop()
                self._inner[-1] += took

        return clocked


def cut(index: int, label_size: int) -> CutPerson:
    """One person as data sets have them."""
    sample = make_sample(index, "realistic")
    evidence = weigh_evidence(sample.keypoints, sample.parts, sample.others)[0]
    observation, crop = crop_evidence(evidence, label_size=label_size)
    return CutPerson(replace(evidence, picture=None, groups=None), observation, crop)


if __name__ == "__main__":
    main(*sys.argv[1:])
