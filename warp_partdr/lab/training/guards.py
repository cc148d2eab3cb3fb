"""Guards of a training run: signals, memory that runs out, and losses that are no numbers."""

from __future__ import annotations

import json
import signal
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import torch

from ...errors import InputError
from .checkpoints import split_tensors
from .config import TrainingConfig

_LAG = 4  # steps that the device may be behind when a loss is looked at


@contextmanager
def signals() -> Iterator[list[int]]:
    """Collect SIGTERM and SIGINT instead of being ended by them, so that a step is finished; a second SIGINT ends."""
    received: list[int] = []
    before: dict[int, Any] = {}

    def tell(number: int, frame: FrameType | None) -> None:
        received.append(number)
        if number == signal.SIGINT:  # launchers send SIGTERM more than once
            signal.signal(number, before[number])

    try:
        for number in (signal.SIGTERM, signal.SIGINT):
            before[number] = signal.signal(number, tell)
    except ValueError:
        pass  # not the main thread: whoever runs it handles signals
    try:
        yield received
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)


@contextmanager
def memory_errors(config: TrainingConfig) -> Iterator[None]:
    """Say what to lower where memory runs out.

    Raises:
        InputError: In place of torch's or Warp's error.
    """
    try:
        yield
    except RuntimeError as error:
        if not isinstance(error, torch.OutOfMemoryError) and "Failed to allocate" not in str(error):  # Warp's
            raise
        raise InputError(
            f"batch_size: {config.batch_size}: out of memory; expected a smaller one (with accumulation, now "
            f"{config.accumulation}, raised as much the step's batch stays), precision 'bf16', or smaller pictures"
        ) from error


class FiniteWatch:
    """Looks at each step's losses and gradient a few steps later, when the device has long been through with them.

    The batches of a step that went wrong are written to a file ``path``.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._waiting: deque[tuple[int, torch.Tensor, torch.cuda.Event | None, list[Any]]] = deque()

    def see(self, step: int, numbers: list[torch.Tensor], batches: list[Any]) -> None:
        """Take in a step, counted from 1: losses and gradient norm, shape () each, and the batches that they come from.

        Raises:
            InputError: If an earlier step's are not.
        """
        finite = torch.isfinite(torch.stack(numbers)).all()
        event = None
        if finite.is_cuda:
            finite = finite.to("cpu", non_blocking=True)
            event = torch.cuda.Event()
            event.record()
        self._waiting.append((step, finite, event, batches))
        self.settle(_LAG if event else 0)

    def settle(self, left: int = 0) -> None:
        """Look at all steps but the last ``left``.

        Raises:
            InputError: If one's losses or gradient are not finite.
        """
        from safetensors.torch import save_file

        while len(self._waiting) > left:
            step, finite, event, batches = self._waiting.popleft()
            if event is not None:
                event.synchronize()
            if not finite:
                tensors, rest = split_tensors(batches[0] if len(batches) == 1 else batches, "batch")
                save_file(tensors, self._path, {"step": str(step), "rest": json.dumps(rest, default=str)})
                raise InputError(
                    f"step {step}: loss or gradient is NaN or infinite; expected finite numbers. {self._path} holds "
                    "the batch, the last checkpoint is from before; a lower learning_rate or clip may help"
                )
