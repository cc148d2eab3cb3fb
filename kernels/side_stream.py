"""Two pieces of work that need nothing of one another, side by side in a captured CUDA graph."""

import threading
from collections.abc import Callable
from functools import lru_cache

import warp as wp

make_stream: Callable[[wp.Device], wp.Stream | None] = wp.Stream
"""For a branch; to be set by who captures, whose streams may have to be of another kind."""


def launch_side_by_side(first: Callable[[], None], second: Callable[[], None], device: wp.Device) -> None:
    """Call both, which launch kernels on Warp's current stream.

    While a graph is captured on CUDA they become two branches of it; else one comes after the other, for starting a
    branch would take the host longer than the device gains.
    """
    if device.is_cpu or not device.is_capturing:
        first()
        second()
        return
    side = _side_stream(device.alias, threading.get_ident())
    try:
        with wp.ScopedStream(side):  # it waits for what was launched so far
            second()
        first()
    finally:
        wp.wait_stream(side)  # a capture can't end before its branches do


@lru_cache(maxsize=32)
def _side_stream(device: str, thread: int) -> wp.Stream | None:
    """One for each thread: a stream that takes part in a capture is closed to others."""
    return make_stream(wp.get_device(device))
