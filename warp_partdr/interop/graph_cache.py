"""Captured graphs, kept for the next call with the same sizes: the most recently used ones, within a memory budget.

For a small batch, launching takes longer than computing. So the second call with the same shapes is captured, in fixed
buffers. From then on, a call copies its arguments into them, replays the graph, and copies the results.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from typing import Generic, NamedTuple, TypeVar

import torch
import warp as wp

from ..errors import check_whole
from ..kernels.launch import get_num_threads, run_slices, split_batch
from .streams import capture_graph, launching, on_torch_stream

Launch = Callable[[], None]

_CPU_BYTES = 2**29
_CUDA_SHARE = 8  # one eighth of a device's memory
_MOST_KEYS = 512  # keys that are remembered
BYTES_PER_PIXEL = 16  # estimate for the CPU, which counts no memory: labels, target, the nearest part and its depth

_budget: int | None = None


def set_graph_memory(num_bytes: int | None) -> None:
    """Set how much memory the buffers of captured graphs may keep on each device. Graphs beyond that are freed now.

    Args:
        num_bytes: Number of bytes. 0 keeps no graphs and launches kernel by kernel, which is slower. None is the
            default: an eighth of a CUDA device's memory, and 512 MiB on the CPU.

    Raises:
        ValueError: If it is no integer, or negative.

    Examples:
        >>> from warp_partdr import set_graph_memory
        >>> set_graph_memory(64 * 2**20)  # at most 64 MiB on each device
        >>> set_graph_memory(None)  # the default
    """
    global _budget
    _budget = None if num_bytes is None else check_whole("num_bytes", num_bytes, 0, 2**63)
    graphs.shrink()


class CapturedBodies:
    """Captured launches for the bodies of a batch; on the CPU, each thread's bodies have a graph of their own.

    Args:
        prepare: Function that returns the launches for a slice of the bodies; it is called once for each slice.
        batch: Number of bodies.
        device: Device; on CUDA, launches are captured for torch's current stream.
        shared: True: threads share the bodies. False: one thread takes all bodies, because their work is short.
    """

    def __init__(
        self, prepare: Callable[[slice], Launch], batch: int, device: torch.device, *, shared: bool = True
    ) -> None:
        self._device = device
        self._stream = None if device.type == "cpu" else wp.stream_from_torch(torch.cuda.current_stream(device))
        self._slices = split_batch(batch, on_cpu=shared and device.type == "cpu")
        with on_torch_stream(device, torch_memory=True):
            # They are kept, because a graph does not keep its memory alive.
            self._launches = {part.start: prepare(part) for part in self._slices}
        self._graphs = {start: capture_graph(launch, device) for start, launch in self._launches.items()}

    def replay(self) -> None:
        """Launch everything, on the stream that was current when this was made."""
        with launching():
            if self._stream is None:
                run_slices(lambda part: wp.capture_launch(self._graphs[part.start]), self._slices)
            elif torch.cuda.current_device() == self._device.index:  # to enter a device takes as long as the launch
                wp.capture_launch(self._graphs[0], stream=self._stream)
            else:
                with torch.cuda.device(self._device):
                    wp.capture_launch(self._graphs[0], stream=self._stream)


_T = TypeVar("_T")


class _Kept(NamedTuple, Generic[_T]):
    """Graph with its buffers; None before the second call, or if it is larger than the budget."""

    graph: _T | None
    device: torch.device
    size: int  # [bytes]
    tried: bool


class GraphCache:
    """Graphs by key, least recently used first. Each thread and stream has its own graphs, because of their buffers."""

    def __init__(self) -> None:
        self._kept: OrderedDict[Hashable, _Kept[object]] = OrderedDict()
        self._lock = threading.Lock()
        self._unused = threading.local()  # its ``flag`` is True within ``unused``

    def find(
        self, key: Hashable, device: torch.device, num_bytes: int, make: Callable[[], _T], *, at_once: bool = False
    ) -> _T | None:
        """Find the graph of a key, which is made at the second call; None at the first, or if the budget has no room.

        It is also None while torch captures a graph of its own, which then holds these launches.

        Args:
            key: Key of the launches, with their options and sizes.
            device: Device of the launches.
            num_bytes: Estimate of the memory that the graph takes, for the CPU; on CUDA torch counts it.
            make: Function that makes the graph with its buffers.
            at_once: True: make it at the first call, because it will be replayed many times.
        """
        if device.type == "cuda" and (torch.cuda.is_current_stream_capturing() or hasattr(self._unused, "flag")):
            return None
        place = get_num_threads() if device.type == "cpu" else torch._C._cuda_getCurrentRawStream(device.index)
        key = threading.get_ident(), place, device, key
        with self._lock:
            kept = self._kept.get(key)
            if kept is None:
                self._kept[key] = _Kept(None, device, 0, tried=False)
            else:
                self._kept.move_to_end(key)
                if kept.tried:
                    return kept.graph  # type: ignore[return-value]
        if kept is None and not at_once:
            if len(self._kept) > _MOST_KEYS:
                self.shrink(device)
            return None
        if _find_budget(device) == 0:
            return None
        try:
            graph, size = _measure(device, num_bytes, make)
        except torch.OutOfMemoryError:
            self.shrink(device, 0)
            graph, size = _measure(device, num_bytes, make)
        fits = size <= _find_budget(device)
        with self._lock:
            self._kept[key] = _Kept(graph if fits else None, device, size if fits else 0, tried=True)
        self.shrink(device)
        return graph if fits else None

    @contextmanager
    def unused(self) -> Iterator[None]:
        """Launch kernel by kernel within, on CUDA: neither make graphs nor replay them, in this thread."""
        self._unused.flag = True
        try:
            yield
        finally:
            del self._unused.flag

    def shrink(self, device: torch.device | None = None, budget: int | None = None) -> None:
        """Free the least recently used graphs until the others keep to the budget, on one device or on each.

        If it is done on each device, graphs that were too large before are tried again at their next call.
        """
        dropped = []
        with self._lock:
            for each in {kept.device for kept in self._kept.values()} if device is None else {device}:
                allowed = _find_budget(each) if budget is None else budget
                total = sum(kept.size for kept in self._kept.values() if kept.device == each)
                for key, kept in list(self._kept.items()):
                    refused = device is None and kept.tried and kept.graph is None
                    if kept.device == each and (total > allowed or allowed == 0 or refused):
                        total -= kept.size
                        dropped.append(self._kept.pop(key))
            if len(self._kept) > _MOST_KEYS:
                dropped += [self._kept.popitem(last=False)[1] for _ in range(len(self._kept) - _MOST_KEYS // 2)]
        with launching():  # no graph may be freed while another one is captured
            dropped.clear()

    def __len__(self) -> int:
        return len(self._kept)

    def num_bytes(self, device: torch.device) -> int:
        """Memory that graphs keep on a device."""
        with self._lock:
            return sum(kept.size for kept in self._kept.values() if kept.device == device)


graphs = GraphCache()


def _find_budget(device: torch.device) -> int:
    if _budget is not None:
        return _budget
    if device.type == "cpu":
        return _CPU_BYTES
    return int(torch.cuda.get_device_properties(device).total_memory) // _CUDA_SHARE


def _measure(device: torch.device, num_bytes: int, make: Callable[[], _T]) -> tuple[_T, int]:
    """Make a graph, and measure the memory that it takes."""
    # Tensors of torch's inference mode can't be written to outside of it.
    with torch.inference_mode(False), torch.no_grad():
        if device.type == "cpu":
            return make(), num_bytes
        before = torch.cuda.memory_allocated(device)
        made = make()
        return made, max(torch.cuda.memory_allocated(device) - before, 0)
