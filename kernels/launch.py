"""Launches side by side: on threads of the CPU device, and as two branches of a captured CUDA graph.

The CPU device runs a launch on one core, so each thread takes some bodies of a batch. ``wp.launch`` releases the
interpreter's lock, so that launches overlap. The CPU device's atomics are not atomic, so threads must not share an
output.
"""

import math
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import ModuleType
from typing import Any

import warp as wp

from ..errors import check_whole

_LEAST_TO_SHARE = 2**17  # numbers of threads' work, more than graphs are captured for on the CPU
_MIN_BODIES = 2  # a thread; for less, starting it costs more than it saves

_num_threads = 0  # 0: as many as there are cores
_branch = threading.local()


def set_num_threads(count: int) -> None:
    """Set the number of threads that share a batch on the CPU device; 0 = as many as there are cores.

    Raises:
        ValueError: If ``count`` is no integer, or negative.

    Examples:
        >>> from warp_partdr import set_num_threads
        >>> set_num_threads(1)  # one thread a process, where several processes fit
        >>> set_num_threads(0)  # the default: as many as there are cores
    """
    global _num_threads
    _num_threads = check_whole("count", count, 0)


def get_num_threads() -> int:
    """Number of threads that share a batch on the CPU device."""
    if _num_threads:
        return _num_threads
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def launch_in_slices(
    launch: Callable[[slice], None], batch: int, device: wp.Device, *, modules: Sequence[ModuleType | wp.Module] = ()
) -> None:
    """Call ``launch`` for slices that together are the batch: one slice a thread on the CPU device, one in all on CUDA.

    Args:
        launch: Function that launches the work of the bodies ``start`` to ``stop``. All that it writes must belong to
            these bodies alone.
        batch: Number of bodies. If it is 0, ``launch`` is called once, with an empty slice.
        device: Device on which the work is launched.
        modules: Modules of the kernels, Python's or Warp's. They are loaded before there are threads, each of which
            would build what is missing.
    """
    slices = split_batch(batch, on_cpu=device.is_cpu)
    if len(slices) > 1:
        for module in modules:
            wp.load_module(module, device=device)
    run_slices(launch, slices)


def launch_shared(
    kernel: wp.Kernel, shape: Sequence[int], inputs: Sequence[Any], outputs: Sequence[wp.array], *, work: int = 1
) -> None:
    """Launch a kernel whose rows threads of the CPU device share where they take so much work that threads pay.

    Args:
        kernel: Kernel that takes the inputs, the row of its first thread, and the outputs. Each row fills its own part
            of them.
        shape: Shape of its threads, rows first.
        inputs: Inputs of the kernel, on the outputs' device.
        outputs: Outputs of the kernel, at least one.
        work: Count of numbers that a thread goes through.
    """
    device, (rows, *others) = outputs[0].device, shape

    def launch(part: slice) -> None:
        wp.launch(kernel, (part.stop - part.start, *others), [*inputs, part.start], outputs, device=device)

    if math.prod(shape) * work < _LEAST_TO_SHARE:
        launch(slice(0, rows))
    else:
        launch_in_slices(launch, rows, device, modules=(kernel.module,))


def split_batch(batch: int, *, on_cpu: bool) -> list[slice]:
    """Slices that together are the batch: one a thread on the CPU device, one in all on CUDA."""
    count = max(min(get_num_threads(), batch // _MIN_BODIES), 1) if on_cpu else 1
    return [slice(batch * k // count, batch * (k + 1) // count) for k in range(count)]


def run_slices(work: Callable[[slice], None], slices: Sequence[slice]) -> None:
    """Call ``work`` for each slice on a thread of its own, the first on this one; raise what any of them raises."""
    if len(slices) == 1:
        work(slices[0])
        return
    failures: list[BaseException] = []

    def guarded(part: slice) -> None:
        try:
            work(part)
        except BaseException as failure:
            failures.append(failure)

    threads = [threading.Thread(target=guarded, args=(part,)) for part in slices[1:]]
    for thread in threads:
        thread.start()
    guarded(slices[0])
    for thread in threads:
        thread.join()
    if failures:
        raise failures[0]


@contextmanager
def branch_on(stream: wp.Stream | None) -> Iterator[None]:
    """Set the stream for a branch of the graph that this thread captures.

    Nobody else may use the stream before the context ends.
    """
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
        second()  # the order of a capture, too
        first()
        return
    try:
        with wp.ScopedStream(side):  # it waits for what was launched so far
            second()
        first()
    finally:
        wp.wait_stream(side)  # a capture can't end before its branches do
