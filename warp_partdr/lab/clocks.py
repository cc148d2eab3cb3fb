"""Clocks for measurements: the steps inside a piece of work, each without those of steps inside it."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any
from unittest.mock import patch

import torch

from .tables import FigureTable


def synchronize(device: str) -> None:
    """Wait until a device has done all that it was given."""
    if device != "cpu":
        torch.cuda.synchronize(device)


@dataclass(frozen=True)
class Step:
    """Function that is a step of some work.

    Attributes:
        owner: Module or class that the function is called from.
        name: Name of the function there.
        title: Name of the step in tables.
    """

    owner: Any
    name: str
    title: str


class StepClock:
    """Clock of a work's steps.

    Attributes:
        seconds: Time of each step by its title, without steps inside it; the clock waits for the device in each.
    """

    def __init__(self, device: str, steps: Sequence[Step]) -> None:
        self.device, self.steps = device, steps
        self.seconds: dict[str, float] = defaultdict(float)
        self._inner = [0.0]

    def measure(self, work: Callable[[], Any]) -> None:
        """Do the work with a clock in each step."""
        patches = [
            patch.object(step.owner, step.name, self._clocked(getattr(step.owner, step.name), step.title))
            for step in self.steps
        ]
        for each in patches:
            each.start()
        try:
            self._clocked(work, "results and the rest")()
        finally:
            for each in patches:
                each.stop()

    def table(self, title: str, people: int) -> FigureTable:
        """Table of microseconds for each person, the longest step first."""
        table = FigureTable(title, {"step": "", "µs a person": ".1f"})
        for step, seconds in sorted(self.seconds.items(), key=lambda step: -step[1]):
            table.add(step, 1e6 * seconds / people)
        return table

    def _clocked(self, work: Callable[..., Any], title: str) -> Callable[..., Any]:
        def clocked(*args: Any, **options: Any) -> Any:
            synchronize(self.device)
            began = time.perf_counter()
            self._inner.append(0.0)
            try:
                return work(*args, **options)
            finally:
                synchronize(self.device)
                took = time.perf_counter() - began
                self.seconds[title] += took - self._inner.pop()
                self._inner[-1] += took

        return clocked
