"""Adam in torch's functional form: ``torch.optim.Adam`` loads torch's compiler, which takes longer than a fit."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch.optim.adam import adam


class Adam:
    """Adam (Kingma and Ba 2015) with torch's defaults.

    Args:
        groups: Tensors that share a learning rate, and that rate.
    """

    def __init__(self, groups: Iterable[tuple[list[torch.Tensor], float]]) -> None:
        self._groups = [
            (
                tensors,
                [torch.zeros_like(tensor) for tensor in tensors],
                [torch.zeros_like(tensor) for tensor in tensors],
                [torch.zeros((), device="cpu") for _ in tensors],  # steps, which ``adam`` counts
                rate,
            )
            for tensors, rate in groups
            if tensors
        ]

    @torch.no_grad()
    def step(self, share: float) -> None:
        """Move the tensors by their gradients, at this share of their rates, and forget the gradients."""
        for tensors, means, squares, counts, rate in self._groups:
            grads = [torch.zeros_like(tensor) if tensor.grad is None else tensor.grad for tensor in tensors]
            adam(
                tensors, grads, means, squares, [], counts,
                lr=share * rate, amsgrad=False, beta1=0.9, beta2=0.999, weight_decay=0, eps=1e-8, maximize=False,
            )  # fmt: skip
            for tensor in tensors:
                tensor.grad = None
