"""Steps of torch, captured as one CUDA graph: a hundred short kernels are replayed in the time of one launch."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

import torch

from .streams import capturing

_T = TypeVar("_T")


class CapturedStep(Generic[_T]):
    """Captured step. Its ``result`` stays in the same memory, which each replay fills again.

    Args:
        step: Function that reads and writes the same tensors at each call and never waits for the device. It is called
            once before the capture.
        device: CUDA device.
    """

    def __init__(self, step: Callable[[], _T], device: torch.device) -> None:
        stream = torch.cuda.Stream(device)
        stream.wait_stream(torch.cuda.current_stream(device))
        with torch.cuda.stream(stream):
            step()  # loads kernels, and torch's libraries
        torch.cuda.current_stream(device).wait_stream(stream)
        self._graph = torch.cuda.CUDAGraph()
        # Other threads may allocate meanwhile; their launches of Warp wait.
        with capturing(), torch.cuda.graph(self._graph, stream=stream, capture_error_mode="thread_local"):
            self.result = step()

    def replay(self) -> None:
        """Run the step on torch's current stream."""
        self._graph.replay()
