"""Warp launches on torch's current stream and the tensors' device, and graph captures that nothing disturbs."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import cache
from types import ModuleType

import torch
import warp as wp

from ..kernels.launch import branch_on, launch_in_slices


class _Gate:
    """Lock between captures and launches of other threads.

    A capture in progress records every CPU launch of the process, whichever thread makes it; on CUDA much of what
    another thread may do, such as allocate or make a graph ready to be launched, spoils it. So a capture waits until no
    other thread launches, and the others wait until it ends.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._launching = 0
        self._capturing: int | None = None  # a thread
        self._own = threading.local()  # how often this thread is launching

    @contextmanager
    def launching(self, *, captured: bool = False) -> Iterator[None]:
        """Enter for a launch: any number of threads at once, but during a capture only those that belong to it.

        Args:
            captured: This thread launches on the stream that is captured: autograd's does, for which the one that
                captures waits.
        """
        with self._changed:
            self._changed.wait_for(lambda: captured or self._capturing in (None, threading.get_ident()))
            self._launching += 1
        self._own.count = getattr(self._own, "count", 0) + 1
        try:
            yield
        finally:
            self._own.count -= 1
            with self._changed:
                self._launching -= 1
                self._changed.notify_all()

    @contextmanager
    def capturing(self) -> Iterator[None]:
        """Enter for a capture: one thread at a time, and none that launches.

        Raises:
            RuntimeError: If this thread is launching: it would wait for itself.
        """
        if getattr(self._own, "count", 0):
            raise RuntimeError("a capture inside on_torch_stream; expected it outside")
        with self._changed:
            self._changed.wait_for(lambda: self._capturing is None and self._launching == 0)
            self._capturing = threading.get_ident()
        try:
            yield
        finally:
            with self._changed:
                self._capturing = None
                self._changed.notify_all()


_gate = _Gate()
launching, capturing = _gate.launching, _gate.capturing


def capture_graph(launch: Callable[[], None], device: torch.device) -> wp.Graph:
    """Capture what ``launch`` launches as a graph, without what other threads launch.

    Raises:
        RuntimeError: If it is called inside ``on_torch_stream``.
    """
    with _gate.capturing(), on_torch_stream(device) as where:
        stream, branch = _capture_streams(where)
        with branch_on(branch), wp.ScopedStream(stream), wp.ScopedCapture(where, stream) as capture:
            launch()
    return capture.graph


@cache
def _capture_streams(where: str) -> tuple[wp.Stream | None, wp.Stream | None]:
    """A stream to capture on and one for a branch; none on the CPU.

    Not torch's current one, which may be the default one, which can't be captured; and of torch's making, for those of
    Warp's wait for the default one, so that whatever another thread puts there meanwhile would spoil the capture. Kept,
    for torch has a few dozen streams in all and hands the same ones out again and again.
    """
    device = wp.get_device(where)
    if device.is_cpu:
        return None, None
    first, second = (wp.stream_from_torch(torch.cuda.Stream(device.ordinal, priority=-1)) for _ in range(2))
    return first, second


@contextmanager
def on_torch_stream(device: torch.device, *, torch_memory: bool = False) -> Iterator[str]:
    """Launch on torch's current stream of ``device``; yields the Warp device's alias, which launches have to name.

    On CUDA one thread at a time: call nothing inside that may wait for another one.

    Args:
        device: CPU or CUDA.
        torch_memory: Allocate Warp's arrays from torch on the default stream, too, so that torch counts them.

    Raises:
        ValueError: If Warp has no such device.
    """
    if device.type not in ("cpu", "cuda"):
        raise ValueError(f"device: {device}; expected a cpu or cuda device")
    wp.init()  # does nothing the second time; device_from_torch relies on it
    captured = device.type == "cuda" and torch.cuda.is_current_stream_capturing()
    with _gate.launching(captured=captured), _on_stream(device, torch_memory) as where:
        yield where


def launch_bodies_on(
    device: torch.device, launch: Callable[[slice], None], batch: int, modules: Sequence[ModuleType]
) -> None:
    """Call ``launch`` for slices of the batch on torch's current stream, see ``launch_in_slices``; not for 0 bodies."""
    if batch > 0:
        with on_torch_stream(device) as where:
            launch_in_slices(launch, batch, wp.get_device(where), modules=modules)


# Warp's current stream and device are the process's, torch's the thread's: without turns, a thread would launch on
# another one's stream, and read its results before they are there.
_one_stream = threading.RLock()


@contextmanager
def _on_stream(device: torch.device, torch_memory: bool) -> Iterator[str]:
    warp_device = wp.device_from_torch(device)
    if warp_device.is_cpu:
        yield warp_device.alias
        return
    torch_stream = torch.cuda.current_stream(device)
    of_torch = torch_memory or torch_stream != torch.cuda.default_stream(device)
    with _one_stream, _torch_memory(warp_device) if of_torch else nullcontext():
        if wp.get_stream(warp_device).cuda_stream == torch_stream.cuda_stream:
            with wp.ScopedDevice(warp_device):
                yield warp_device.alias
        else:
            with wp.ScopedStream(wp.stream_from_torch(torch_stream), sync_enter=False):
                yield warp_device.alias


class _TorchMemory:
    """Warp arrays in torch's memory, which comes back to the stream that it was taken for.

    Warp's own is freed on the default stream. That waits for streams of Warp's making, not for torch's side streams: an
    array could be handed on while a kernel on one of these still writes to it.
    """

    def __init__(self, device: int) -> None:
        self._device = device

    def allocate(self, size_in_bytes: int) -> int:
        """Allocate for the thread's current stream."""
        stream = torch.cuda.current_stream(self._device)
        return int(torch.cuda.caching_allocator_alloc(size_in_bytes, self._device, stream))

    def deallocate(self, ptr: int, size_in_bytes: int) -> None:
        """Free after the work that the stream has been given until now."""
        torch.cuda.caching_allocator_delete(ptr)


_memory_users: Counter[str] = Counter()


@contextmanager
def _torch_memory(device: wp.Device) -> Iterator[None]:
    """Make Warp allocate from torch; the last to leave resets it, where calls of a thread are nested."""
    _memory_users[device.alias] += 1
    if _memory_users[device.alias] == 1:
        wp.set_device_allocator(device, _TorchMemory(device.ordinal))
    try:
        yield
    finally:
        _memory_users[device.alias] -= 1
        if _memory_users[device.alias] == 0:
            wp.set_device_allocator(device, None)
