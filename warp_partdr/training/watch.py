"""Losses that are no numbers: found without waiting for the device, and the batch that led to one kept."""

from __future__ import annotations

import json
from collections import deque
from pathlib import Path
from typing import Any

import torch

from ..errors import InputError
from .tensor_tree import split_tensors

_LAG = 4  # steps that the device may be behind when a loss is looked at


class FiniteWatch:
    """Looks at each step's losses and gradient a few steps later, when the device has long been through with them.

    Args:
        path: Where the batches of a step that went wrong are saved.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._waiting: deque[tuple[int, torch.Tensor, torch.cuda.Event | None, list[Any]]] = deque()

    def see(self, step: int, numbers: list[torch.Tensor], batches: list[Any]) -> None:
        """Take in a step.

        Args:
            step: Which one, counted from 1.
            numbers: Losses and gradient norm, shape () each, that must be finite.
            batches: From which they come.

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
        while len(self._waiting) > left:
            step, finite, event, batches = self._waiting.popleft()
            if event is not None:
                event.synchronize()
            if not finite:
                self._save(step, batches)
                raise InputError(
                    f"step {step}: loss or gradient is NaN or infinite; expected finite numbers. {self._path} holds "
                    "the batch, the last checkpoint is from before; a lower learning_rate or clip may help"
                )

    def _save(self, step: int, batches: list[Any]) -> None:
        from safetensors.torch import save_file

        tree = batches[0] if len(batches) == 1 else batches
        tensors, rest = split_tensors(tree, "batch")
        save_file(tensors, self._path, {"step": str(step), "rest": json.dumps(rest, default=str)})
