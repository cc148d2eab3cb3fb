"""Gradient of a weighted sum of costs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch


def backward_weighted(costs: Sequence[torch.Tensor], weights: Sequence[torch.Tensor]) -> None:
    """Compute gradients of the weighted sum of all numbers of the costs, as ``torch.autograd.backward`` does.

    That function imports sympy to compare the shapes, which takes half a second.

    Args:
        costs: Costs of any shapes.
        weights: Weight of each of their numbers, in their shapes.
    """
    _WeightedSum.apply(tuple(weights), *costs).backward()


class _WeightedSum(torch.autograd.Function):
    """Weighted sum of which only the gradient, which is the weights, is computed."""

    @staticmethod
    def forward(ctx: Any, weights: tuple[torch.Tensor, ...], *costs: torch.Tensor) -> torch.Tensor:
        ctx.weights = weights
        return costs[0].new_empty(())

    @staticmethod
    def backward(ctx: Any, adjoint: torch.Tensor) -> Any:
        return None, *ctx.weights
