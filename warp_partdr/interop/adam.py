"""Adam in torch's functional form: ``torch.optim.Adam`` loads torch's compiler, which takes longer than a fit."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

import torch
from torch.optim.adam import adam

_PIECE = 1024  # numbers


def cosine_share(step: int, iterations: int, last: float) -> float:
    """Share of the learning rate at a step: from 1 to the last share along a cosine, then constant."""
    course = min(step, iterations) / max(iterations, 1)
    return last + (1 - last) * (1 + math.cos(math.pi * course)) / 2


def descend(
    step: Callable[[int, float], object],
    iterations: int,
    *,
    last_share: float,
    progress: Callable[[int], None] | None = None,
) -> None:
    """Take all steps of a refinement by Adam.

    Args:
        step: Function that takes one step, from its number and its share of the learning rate.
        iterations: Number of steps.
        last_share: Share of the learning rate to which ``cosine_share`` falls.
        progress: Function that is called after each step with the number of steps that are done.
    """
    for iteration in range(iterations):
        step(iteration, cosine_share(iteration, iterations, last_share))
        if progress is not None:
            progress(iteration + 1)


class Adam:
    """Adam (Kingma and Ba 2015) with torch's defaults.

    Args:
        groups: Tensors that share a learning rate, and that rate.
        betas: Shares of the gradients' mean, and of their squares' mean, that each step keeps.
    """

    def __init__(
        self, groups: Iterable[tuple[list[torch.Tensor], float]], *, betas: tuple[float, float] = (0.9, 0.999)
    ) -> None:
        self._betas = betas
        self._groups = [_Group.of(tensors, rate) for tensors, rate in groups if tensors]

    @torch.no_grad()
    def step(self, share: float | torch.Tensor) -> None:
        """Move the tensors by their gradients, at this share of their rates, and forget the gradients.

        In a captured graph, the share must be a tensor on the device; a float would be the same at each replay.
        """
        beta1, beta2 = self._betas
        for group in self._groups:
            tensors = group.tensors
            grads = [torch.zeros_like(tensor) if tensor.grad is None else tensor.grad for tensor in tensors]
            means, squares = _pieces(group.means), _pieces(group.squares)
            # On CUDA, one kernel replaces fifteen, which matters in a captured graph.
            on_cuda = tensors[0].is_cuda
            adam(
                _pieces(tensors), _pieces(grads), means, squares, [], group.counts, capturable=on_cuda, fused=on_cuda,
                foreach=False, lr=share * group.rate, amsgrad=False, beta1=beta1, beta2=beta2, weight_decay=0,
                eps=1e-8, maximize=False,
            )  # fmt: skip
            for tensor in tensors:
                tensor.grad = None

    @torch.no_grad()
    def restart(self) -> None:
        """Forget all steps."""
        torch._foreach_zero_([state for each in self._groups for state in (*each.means, *each.squares, *each.counts)])


class _Group(NamedTuple):
    """Tensors that share a learning rate, and what Adam knows of them."""

    tensors: list[torch.Tensor]
    means: list[torch.Tensor]  # of gradients
    squares: list[torch.Tensor]
    counts: list[torch.Tensor]  # of each piece's steps
    rate: float

    @classmethod
    def of(cls, tensors: list[torch.Tensor], rate: float) -> _Group:
        means = [torch.zeros_like(tensor) for tensor in tensors]
        squares = [torch.zeros_like(tensor) for tensor in tensors]
        # ``adam`` counts the steps; on the device, so that a captured graph can count them, too
        counts = [torch.zeros((), device=piece.device) for piece in _pieces(means)]
        return cls(tensors, means, squares, counts, rate)


def _pieces(tensors: list[torch.Tensor]) -> list[torch.Tensor]:
    """Tensors, but vectors on CUDA in pieces: for each, a single block of the fused kernel takes its time."""
    found: list[torch.Tensor] = []
    for tensor in tensors:
        found += tensor.split(_PIECE) if tensor.is_cuda and tensor.ndim == 1 else [tensor]
    return found
