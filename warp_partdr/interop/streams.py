"""Warp launches on torch's current stream and the tensors' device, and graph captures that nothing disturbs."""

from __future__ import annotations

import gc
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import cache
from types import ModuleType
from weakref import WeakKeyDictionary

import torch
import warp as wp

from ..kernels.launch import branch_on, launch_in_slices
from .device_cache import keeping_tables


class _Gate:
    """Lock between captures and launches of other threads.

    A capture in progress records every CPU launch of the process, whichever thread makes it. On CUDA, much that another
    thread may do, such as allocating memory or instantiating a graph, spoils it. So a capture waits until no other
    thread launches, and the others wait until it ends.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._launching = 0
        self._capturing: int | None = None  # identity of the thread that captures
        self._own = threading.local()  # number of nested launches of this thread

    def launching(self, *, captured: bool = False) -> _Launching:
        """Enter for a launch: any number of threads at once, but during a capture only threads that belong to it.

        Args:
            captured: True if this thread launches on the stream that is captured. Autograd's thread does so, and the
                thread that captures waits for it.
        """
        return _Launching(self, captured)

    def enter(self, captured: bool) -> None:
        """Begin what ``launching`` is for."""
        with self._changed:
            self._changed.wait_for(lambda: captured or self._capturing in (None, threading.get_ident()))
            self._launching += 1
        self._own.count = getattr(self._own, "count", 0) + 1

    def leave(self) -> None:
        """End what ``launching`` is for."""
        self._own.count -= 1
        with self._changed:
            self._launching -= 1
            if not self._launching:
                self._changed.notify_all()

    @contextmanager
    def capturing(self) -> Iterator[None]:
        """Enter for a capture: one thread at a time, while no thread launches.

        Python collects no garbage meanwhile: a graph that it frees would spoil the capture.

        Raises:
            RuntimeError: If this thread is launching: it would wait for itself.
        """
        if getattr(self._own, "count", 0):
            raise RuntimeError("a capture inside on_torch_stream; expected it outside")
        with self._changed:
            self._changed.wait_for(lambda: self._capturing is None and self._launching == 0)
            self._capturing = threading.get_ident()
        collects = gc.isenabled()
        gc.disable()
        try:
            yield
        finally:
            if collects:
                gc.enable()
            with self._changed:
                self._capturing = None
                self._changed.notify_all()


class _Launching:
    """Context of a launch. It is a class, because a generator takes three times as long, as long as a short launch."""

    def __init__(self, gate: _Gate, captured: bool) -> None:
        self._gate, self._captured = gate, captured

    def __enter__(self) -> None:
        self._gate.enter(self._captured)

    def __exit__(self, *_: object) -> None:
        self._gate.leave()


_gate = _Gate()
launching, capturing = _gate.launching, _gate.capturing


def capture_graph(launch: Callable[[], None], device: torch.device) -> wp.Graph:
    """Capture the launches of ``launch`` as a graph, without those of other threads.

    Raises:
        RuntimeError: If it is called inside ``on_torch_stream``.
    """
    with _gate.capturing(), on_torch_stream(device) as where:
        stream, branch = _capture_streams(where)
        with (
            keeping_tables() as tables,
            branch_on(branch),
            wp.ScopedStream(stream),
            wp.ScopedCapture(where, stream) as capture,
        ):
            launch()
    _graph_tables[capture.graph] = tables
    return capture.graph


_graph_tables: WeakKeyDictionary[wp.Graph, list[object]] = WeakKeyDictionary()  # what graphs read, freed with them


@cache
def _capture_streams(where: str) -> tuple[wp.Stream | None, wp.Stream | None]:
    """Make a stream to capture on and one for a branch; None on the CPU.

    Torch's current stream may be the default one, which can't be captured. Warp's own streams wait for the default one,
    so launches of another thread on it would spoil the capture. So these are torch's streams. They are kept, because
    torch has only a few dozen streams and hands the same ones out again and again.
    """
    device = wp.get_device(where)
    if device.is_cpu:
        return None, None
    first = wp.stream_from_torch(torch.cuda.Stream(device.ordinal, priority=-1))
    second = wp.stream_from_torch(torch.cuda.Stream(device.ordinal, priority=-1))
    return first, second


@contextmanager
def on_side_stream(stream: torch.cuda.Stream) -> Iterator[None]:
    """Make a stream torch's current one within: it waits for the one that was, which waits for it at the end."""
    current = torch.cuda.current_stream(stream.device)
    stream.wait_stream(current)
    with torch.cuda.stream(stream):
        yield
    current.wait_stream(stream)


@contextmanager
def on_torch_stream(device: torch.device, *, torch_memory: bool = False) -> Iterator[str]:
    """Launch on torch's current stream of ``device`` within; yields the Warp device's alias, which launches must name.

    On CUDA, only one thread at a time is within. Call nothing inside that may wait for another thread.

    Args:
        device: Device of type "cpu" or "cuda".
        torch_memory: True: allocate Warp's arrays from torch even on the default stream, so that torch counts them.

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
    """Call ``launch`` for slices of the batch on torch's current stream (``launch_in_slices``), unless it is empty."""
    if batch > 0:
        with on_torch_stream(device) as where:
            launch_in_slices(launch, batch, wp.get_device(where), modules=modules)


# Warp's current stream and device belong to the process, torch's to the thread. Without this lock, a thread could
# launch on another thread's stream, and read its results too early.
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
    """Allocator of Warp arrays in torch's memory, which returns to the stream that it was allocated for.

    Warp's own memory is freed on the default stream. That stream waits for Warp's streams, but not for torch's side
    streams: memory could be used again while a kernel on a side stream still writes to it.
    """

    def __init__(self, device: int) -> None:
        self._device = device

    def allocate(self, size_in_bytes: int) -> int:
        """Allocate for the thread's current stream."""
        stream = torch.cuda.current_stream(self._device)
        return int(torch.cuda.caching_allocator_alloc(size_in_bytes, self._device, stream))

    def deallocate(self, ptr: int, size_in_bytes: int) -> None:
        """Free the memory after the work that is on the stream now."""
        torch.cuda.caching_allocator_delete(ptr)


_memory_users: Counter[str] = Counter()


@contextmanager
def _torch_memory(device: wp.Device) -> Iterator[None]:
    """Make Warp allocate from torch within; if calls of a thread are nested, the outermost one resets it."""
    _memory_users[device.alias] += 1
    if _memory_users[device.alias] == 1:
        wp.set_device_allocator(device, _TorchMemory(device.ordinal))
    try:
        yield
    finally:
        _memory_users[device.alias] -= 1
        if _memory_users[device.alias] == 0:
            wp.set_device_allocator(device, None)
