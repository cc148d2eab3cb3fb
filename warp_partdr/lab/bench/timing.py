"""Repeated timing: of captured graphs on the device's own clock, and of calls from Python on the wall's."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
import warp as wp

from ...interop.streams import capture_graph

_MIN_REPEATS = 3
_MAX_REPEATS = 200
_QUEUED = 10  # replays that wait on CUDA at once, so that the host is never what is timed


@dataclass(frozen=True)
class Timing:
    """Repeated runs of one thing."""

    seconds: tuple[float, ...]  # each run's duration, at least one

    @property
    def median(self) -> float:
        """Median time [s]."""
        return float(np.median(self.seconds))

    @property
    def spread(self) -> float:
        """Interquartile range [s]."""
        low, high = np.percentile(self.seconds, (25, 75))
        return float(high - low)

    @property
    def fastest(self) -> float:
        """Shortest time [s]; on a machine with other work the least disturbed figure."""
        return min(self.seconds)


def repeat(sample: Callable[[], list[float]], budget: float) -> Timing:
    """Collect durations until the budget is spent, after a first sample that does not count.

    Args:
        sample: Function that runs once or more and returns each run's duration [s].
        budget: Time to spend [s]. There are at least 3 durations in any case, and about 200 at most.
    """
    sample()
    seconds: list[float] = []
    end = time.perf_counter() + budget
    while len(seconds) < _MIN_REPEATS or (len(seconds) < _MAX_REPEATS and time.perf_counter() < end):
        seconds += sample()
    return Timing(tuple(seconds))


def time_calls(call: Callable[[], object], device: str, budget: float) -> Timing:
    """Wall time of a call from Python, until the device is done."""
    return repeat(lambda: [wall_time(call, device)], budget)


def time_in_turn(calls: Sequence[Callable[[], object]], device: str, budget: float) -> list[Timing]:
    """Wall time of calls, each once in every turn, so that what disturbs the machine disturbs them alike."""
    turns: list[list[float]] = []

    def turn() -> list[float]:
        turns.append([wall_time(call, device) for call in calls])
        return [sum(turns[-1])]

    repeat(turn, budget)
    return [Timing(seconds) for seconds in zip(*turns[1:], strict=True)]  # the first does not count


def peak_memory(call: Callable[[], object], device: str) -> int | None:
    """Memory that torch takes for a call at most, beside what it held before [bytes]; None on the CPU device."""
    if wp.get_device(device).is_cpu:
        return None
    before = torch.cuda.memory_allocated(device)
    torch.cuda.reset_peak_memory_stats(device)
    call()
    wp.synchronize_device(device)
    return torch.cuda.max_memory_allocated(device) - before


def time_graph(graph: wp.Graph, device: str, budget: float) -> Timing:
    """Time of one replay: between events on CUDA, on the wall on the CPU device."""
    return repeat(graph_sample(graph, device), budget)


def capture(launch: Callable[[], None], device: str, times: int = 1) -> wp.Graph:
    """A graph of ``times`` runs one after another; the first run, outside, loads the kernels."""
    wp.synchronize_device(device)  # torch, which made the inputs, has streams of its own
    launch()
    wp.synchronize_device(device)

    def launch_all() -> None:
        for _ in range(times):
            launch()

    return capture_graph(launch_all, torch.device(wp.device_to_torch(wp.get_device(device))))


def graph_sample(graph: wp.Graph, device: str) -> Callable[[], list[float]]:
    """A sample of replays for ``repeat``."""
    return device_sample(lambda: wp.capture_launch(graph, stream=_stream(device)), device)


def device_sample(work: Callable[[], object], device: str) -> Callable[[], list[float]]:
    """A sample for ``repeat`` of work on Warp's current stream: between events on CUDA, on the wall on the CPU."""
    if wp.get_device(device).is_cpu:
        return lambda: [wall_time(work, device)]

    def run() -> list[float]:
        events = [wp.Event(device, enable_timing=True) for _ in range(_QUEUED + 1)]
        stream = wp.get_stream(device)
        for event in events:
            stream.record_event(event)
            if event is not events[-1]:
                work()
        # At the first event the queue is still empty: the first run waits for the host.
        return [1e-3 * wp.get_event_elapsed_time(start, end) for start, end in pairwise(events[1:])]

    return run


def _stream(device: str) -> wp.Stream | None:
    return None if wp.get_device(device).is_cpu else wp.get_stream(device)


def wall_time(call: Callable[[], object], device: str) -> float:
    """Wall time of one call, until the device is done [s]."""
    start = time.perf_counter()
    call()
    wp.synchronize_device(device)
    return time.perf_counter() - start
