"""Guards around a training run: signals, and memory that runs out."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

import torch

from ..errors import InputError
from .config import TrainingConfig


@contextmanager
def signals(tell: Callable[[int], None]) -> Iterator[None]:
    """Report SIGTERM and SIGINT instead of being ended by them, so that a step is finished; a second SIGINT does end.

    Args:
        tell: Called with the signal.
    """

    def told(number: int, frame: FrameType | None) -> None:
        tell(number)
        if number == signal.SIGINT:  # launchers send SIGTERM more than once
            signal.signal(number, before[number])

    before: dict[int, Any] = {}
    try:
        for number in (signal.SIGTERM, signal.SIGINT):
            before[number] = signal.signal(number, told)
    except ValueError:
        pass  # not the main thread: whoever runs it handles signals
    try:
        yield
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
