"""Steps of torch, captured as one CUDA graph: a hundred short kernels are replayed in the time of one launch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Generic, TypeVar

import torch

from .device_cache import keeping_tables
from .streams import capturing, on_side_stream

_T = TypeVar("_T")


class CapturedStep(Generic[_T]):
    """Captured step. Its ``result`` stays in the same memory, which each replay fills again.

    Args:
        step: Function that reads and writes the same tensors at each call and never waits for the device.
        device: CUDA device.
        stream: Stream on which the step was called before. None: one of its own, on which it is called once before the
            capture.
        pool: Memory that it shares with other captured steps of the same stream, from ``torch.cuda.graph_pool_handle``.
            Their results must be read before another one is replayed.
        generators: Generators besides torch's own that the step draws random numbers from.
    """

    def __init__(
        self,
        step: Callable[[], _T],
        device: torch.device,
        *,
        stream: torch.cuda.Stream | None = None,
        pool: Any = None,
        generators: Sequence[torch.Generator] = (),
    ) -> None:
        if stream is None:
            stream = torch.cuda.Stream(device)
            with on_side_stream(stream):
                step()  # loads kernels, and torch's libraries
        self._graph = torch.cuda.CUDAGraph()
        for generator in generators:
            self._graph.register_generator_state(generator)
        try:
            # Other threads may allocate meanwhile; their launches of Warp wait. A capture that fails leaves its stream
            # current, so it is made so here, too.
            with (
                capturing(),
                keeping_tables() as self._tables,
                torch.cuda.stream(stream),
                torch.cuda.graph(self._graph, pool=pool, stream=stream, capture_error_mode="thread_local"),
            ):
                self.result = step()
        except BaseException:
            _clean_up(self._graph, stream.device_index, generators)
            raise

    def replay(self) -> None:
        """Run the step on torch's current stream."""
        self._graph.replay()


def _clean_up(graph: torch.cuda.CUDAGraph, device: int, generators: Sequence[torch.Generator]) -> None:
    """Let torch go on after a capture that failed, whose end it has not noticed everywhere (torch 2.11).

    Generators get states that are in no capture. Graphs from before keep the old ones, so ``torch.manual_seed`` does
    not reach them any more.
    """
    with suppress(RuntimeError):  # memory is allocated for the graph no more
        torch._C._cuda_endAllocateToPool(device, graph.pool())
    for generator in (torch.cuda.default_generators[device], *generators):
        generator.graphsafe_set_state(generator.clone_state())
