"""Independent launches side by side, as two branches of a captured CUDA graph."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import warp as wp

_branch = threading.local()


@contextmanager
def branch_on(stream: wp.Stream | None) -> Iterator[None]:
    """While this thread captures a graph: the stream for a branch of it, which nobody else uses until the end."""
    _branch.stream = stream
    try:
        yield
    finally:
        _branch.stream = None


def launch_side_by_side(first: Callable[[], None], second: Callable[[], None]) -> None:
    """Call both, which launch kernels on Warp's current stream.

    Inside ``branch_on`` they become two branches of the graph; else one comes after the other, for starting a branch
    would take the host longer than the device gains.
    """
    side = getattr(_branch, "stream", None)
    if side is None:
        first()
        second()
        return
    try:
        with wp.ScopedStream(side):  # it waits for what was launched so far
            second()
        first()
    finally:
        wp.wait_stream(side)  # a capture can't end before its branches do
