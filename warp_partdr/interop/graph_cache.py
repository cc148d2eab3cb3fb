"""Captured graphs, kept for the next call of the same sizes: the most recently used ones, within a budget of memory.

For a small batch, launching takes longer than computing. So what is asked for twice is captured, in fixed buffers, and
from then on a call copies its arguments into them, replays, and copies the results.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, NamedTuple, TypeVar

import torch
import warp as wp

from ..errors import check_whole
from ..kernels.launch import get_num_threads, run_slices, split_batch
from .streams import capture_graph, launching, on_torch_stream

Launch = Callable[[], None]

_CPU_BYTES = 2**29
_CUDA_SHARE = 8  # of a device's memory, one in so many bytes
_MOST_KEYS = 512  # that are remembered
BYTES_PER_PIXEL = 16  # on the CPU, where nobody counts: labels, target, the nearest with its depth

_budget: int | None = None


def set_graph_memory(num_bytes: int | None) -> None:
    """Set how much memory the buffers of captured graphs may keep on each device; frees what is too much now.

    Args:
        num_bytes: 0 keeps none, and launches kernel by kernel: slower calls. None is the default: an eighth of a CUDA
            device's memory, and 512 MiB on the CPU.

    Raises:
        ValueError: If it is no integer, or negative.
    """
    global _budget
    _budget = None if num_bytes is None else check_whole("num_bytes", num_bytes, 0, 2**63)
    graphs.shrink()


class CapturedBodies:
    """Launches for the bodies of a batch, captured; on the CPU device one graph for each thread's bodies.

    Args:
        prepare: Returns the launches of a slice of the bodies; called once for each.
        batch: Number of bodies.
        device: On CUDA, for torch's current stream.
        shared: False: one thread has all bodies, whose work is short.
    """

    def __init__(
        self, prepare: Callable[[slice], Launch], batch: int, device: torch.device, *, shared: bool = True
    ) -> None:
        self._device = device
        self._stream = None if device.type == "cpu" else wp.stream_from_torch(torch.cuda.current_stream(device))
        self._slices = split_batch(batch, on_cpu=shared and device.type == "cpu")
        with on_torch_stream(device, torch_memory=True):
            # They are kept, for a graph holds no memory alive.
            self._launches = {part.start: prepare(part) for part in self._slices}
        self._graphs = {start: capture_graph(launch, device) for start, launch in self._launches.items()}

    def replay(self) -> None:
        """Launch all, on the stream that was current at first."""
        if self._stream is None:
            with launching():
                run_slices(lambda part: wp.capture_launch(self._graphs[part.start]), self._slices)
        else:
            with launching(), torch.cuda.device(self._device):
                wp.capture_launch(self._graphs[0], stream=self._stream)


_T = TypeVar("_T")


class _Kept(NamedTuple, Generic[_T]):
    """A graph with its buffers; None before the second call, and in place of one larger than the budget."""

    graph: _T | None
    device: torch.device
    size: int  # [bytes]
    tried: bool


class GraphCache:
    """Graphs by key, least recently used first; each thread and stream has graphs of its own, as their buffers."""

    def __init__(self) -> None:
        self._kept: OrderedDict[Hashable, _Kept[object]] = OrderedDict()
        self._lock = threading.Lock()

    def find(
        self, key: Hashable, device: torch.device, num_bytes: int, make: Callable[[], _T], *, at_once: bool = False
    ) -> _T | None:
        """Graph of a key, made if it is asked for the second time; None at first, and if the budget has no room for it.

        None, too, while torch captures a graph of its own, which holds these launches then.

        Args:
            key: Of what is launched, its options and sizes.
            device: Where.
            num_bytes: Estimate of the memory that it takes, for the CPU; on CUDA torch counts it.
            make: Makes the graph with its buffers.
            at_once: Make it the first time, for it will be replayed many times.
        """
        if device.type == "cuda" and torch.cuda.is_current_stream_capturing():
            return None
        where = get_num_threads() if device.type == "cpu" else torch._C._cuda_getCurrentRawStream(device.index)
        key = threading.get_ident(), where, device, key
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

    def shrink(self, device: torch.device | None = None, budget: int | None = None) -> None:
        """Free the least recently used graphs until the others keep to the budget, on one device or on each.

        On each, what was too large before is tried again.
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
        with launching():  # no graph goes while another one is captured
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
    """A new graph, and the memory that it took."""
    # Tensors of torch's inference mode can't be written to outside of it.
    with torch.inference_mode(False), torch.no_grad():
        if device.type == "cpu":
            return make(), num_bytes
        before = torch.cuda.memory_allocated(device)
        made = make()
        return made, max(torch.cuda.memory_allocated(device) - before, 0)
