"""Kernels that a function launches: their names, the memory they are given, and the time that each of them takes.

Warp has no hook for launches, so ``wp.launch`` is replaced while the function runs.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import warp as wp

from .timing import Timing, capture, graph_sample, repeat, time_in_turn

_Sample = Callable[[], list[float]]
_RUNS_IN_GRAPH = 10  # one replay of one small kernel is shorter than CUDA's clock is exact


@dataclass(frozen=True)
class Launched:
    """One kernel launch."""

    name: str  # of the kernel
    spans: np.ndarray  # memory from first to last element of each array that it was given, shape (N, 2) [bytes]

    @property
    def bytes(self) -> int:
        """Size of the arrays, each counted once."""
        return count_bytes([self])


def count_bytes(launches: Iterable[Launched]) -> int:
    """Size of the memory that launches share, each byte counted once."""
    spans = np.concatenate([np.zeros((0, 2), dtype=np.int64), *(launched.spans for launched in launches)])
    total = end = 0
    for first, last in spans[np.argsort(spans[:, 0])].tolist():
        total += max(last - max(first, end), 0)
        end = max(end, last)
    return total


def observe_launches(run: Callable[[], object]) -> list[Launched]:
    """Run once, and list what was launched."""
    seen: list[Launched] = []

    def note(launch: Mapping[str, Any]) -> None:
        arrays = (*launch.get("inputs", ()), *launch.get("outputs", ()))
        spans = [span for value in arrays for span in _spans(value)]
        seen.append(Launched(launch["kernel"].key, np.array(spans, dtype=np.int64).reshape(-1, 2)))

    with _after_each_launch(note):
        run()
    return seen


def time_kernels(run: Callable[[], None], device: str, budget: float) -> list[tuple[Launched, Timing]]:
    """Time that each kernel adds to a run, in its place and on the data it finds there.

    What clears memory counts for the kernel that follows.

    Args:
        run: Function that launches kernels on fixed buffers, whatever is in them.
        device: Device on which it launches them.
        budget: Time for each kernel [s].
    """
    launches = observe_launches(run)
    time_all = _time_pieces if wp.get_device(device).is_cpu else _time_beginnings
    return list(zip(launches, time_all(run, len(launches), device, budget), strict=True))


def _time_pieces(run: Callable[[], None], count: int, device: str, budget: float) -> list[Timing]:
    """Time each kernel on the CPU, in a graph of its own, one by one.

    Clocks are noisy there, and a graph starts in a microsecond.
    """
    pieces = [partial(wp.capture_launch, graph) for graph in _capture_pieces(run, device)]
    return time_in_turn(pieces, device, budget * count)


def _capture_pieces(run: Callable[[], None], device: str) -> list[wp.Graph]:
    """A graph of each kernel, and of what comes between it and the one before."""
    graphs: list[wp.Graph] = []

    def cut(_: Mapping[str, Any]) -> None:
        graphs.append(wp.capture_end(device))
        wp.capture_begin(device)

    wp.capture_begin(device)
    try:
        with _after_each_launch(cut):
            run()
    finally:
        wp.capture_end(device)
    return graphs


def _time_beginnings(run: Callable[[], None], count: int, device: str, budget: float) -> list[Timing]:
    """Time each kernel on CUDA, by graphs that end after it.

    The host takes longer to start a kernel than a kernel may take.

    The graphs are replayed in turn with those that end before it; what counts is the difference.
    """
    samples = [
        graph_sample(capture(partial(_run_first, run, index + 1), device, _RUNS_IN_GRAPH), device)
        for index in range(count)
    ]

    def differences(before: _Sample, after: _Sample) -> list[float]:
        longer = after()
        shorter = before() or [0.0] * len(longer)  # before the first there is nothing
        return [(long - short) / _RUNS_IN_GRAPH for long, short in zip(longer, shorter, strict=True)]

    return [repeat(partial(differences, *pair), budget) for pair in pairwise([list, *samples])]


class _Enough(Exception):  # noqa: N818  not an error
    """The launches asked for are done."""


def _run_first(run: Callable[[], None], count: int) -> None:
    """Run until ``count`` kernels are launched."""
    left = iter(range(count - 1))

    def stop(_: Mapping[str, Any]) -> None:
        if next(left, None) is None:
            raise _Enough

    with suppress(_Enough), _after_each_launch(stop):
        run()


@contextmanager
def _after_each_launch(act: Callable[[Mapping[str, Any]], None]) -> Iterator[None]:
    """Call ``act`` with the arguments of each launch, by name."""
    real = wp.launch
    signature = inspect.signature(real)

    def launch(*args: Any, **options: Any) -> Any:
        result = real(*args, **options)
        act(signature.bind(*args, **options).arguments)
        return result

    wp.launch = launch
    try:
        yield
    finally:
        wp.launch = real


def _spans(value: Any) -> list[tuple[int, int]]:
    """Memory of an array, or of those in a struct; none for anything else."""
    if isinstance(value, wp.array):
        if value.size == 0:
            return []
        reach = sum((size - 1) * stride for size, stride in zip(value.shape, value.strides, strict=True))
        return [(value.ptr, value.ptr + reach + wp.types.type_size_in_bytes(value.dtype))]
    if hasattr(value, "_cls"):  # a Warp struct
        return [span for name in value._cls.vars for span in _spans(getattr(value, name))]
    return []
