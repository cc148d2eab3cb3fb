"""Muon (Jordan et al., 2024): steps of matrices and convolutions that turn all their directions alike.

``torch.optim.Muon`` is for matrices alone, and takes them one by one: a third of a step's launches here. Those of one
shape are stepped side by side, and a convolution is the matrix of its filters (Jordan, 2024, airbench).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from typing import Any

import torch

_MOMENTUM = 0.95
_ROUNDS = 5  # of Newton and Schulz
_POLYNOMIAL = (3.4445, -4.7750, 2.0315)  # of a singular value, its cube and its fifth power
_LEAST = 1e-7  # norm of a matrix
_RATE = 0.2  # of AdamW's, so that numbers move as far as there (Liu et al., 2025)


class Muon(torch.optim.Optimizer):
    """Optimizer of parameters with two or four axes, with the learning rate and decay of AdamW.

    Args:
        parameters: Matrices (out, in) and convolutions (out, in, height, width).
        lr: Learning rate.
        weight_decay: Decoupled, as in AdamW.

    Raises:
        ValueError: If a parameter has another number of axes.
    """

    def __init__(self, parameters: Iterable[torch.nn.Parameter], *, lr: float, weight_decay: float) -> None:
        super().__init__(parameters, {"lr": lr, "weight_decay": weight_decay})
        for group in self.param_groups:
            for value in group["params"]:
                if value.ndim not in (2, 4):
                    raise ValueError(f"parameters: one of shape {tuple(value.shape)}; expected 2 or 4 axes")

    @torch.no_grad()
    def step(self, closure: Any = None) -> Any:
        """One step of all parameters that have a gradient."""
        loss = None
        if closure is not None:
            with torch.enable_grad():
                loss = closure()
        for group in self.param_groups:
            given = [value for value in group["params"] if value.grad is not None]
            if not given:
                continue
            for value in given:
                if "momentum_buffer" not in self.state[value]:
                    self.state[value]["momentum_buffer"] = torch.zeros_like(value)
            gradients = [value.grad for value in given]
            means = [self.state[value]["momentum_buffer"] for value in given]
            torch._foreach_lerp_(means, gradients, 1 - _MOMENTUM)
            ways = torch._foreach_lerp(gradients, means, _MOMENTUM)  # Nesterov's
            torch._foreach_mul_(given, 1 - group["lr"] * group["weight_decay"])
            groups: dict[tuple[torch.Size, bool], list[int]] = defaultdict(list)
            for index, way in enumerate(ways):
                groups[way.shape, way.is_contiguous()].append(index)
            for indices in groups.values():
                _step_alike([given[index] for index in indices], [ways[index] for index in indices], group["lr"])
        return loss


def _step_alike(values: list[torch.Tensor], ways: list[torch.Tensor], rate: float) -> None:
    """Move parameters of one shape along ways whose directions are made as long as each other."""
    stacked = torch.stack(ways)
    # A convolution's filters in the order they have in memory.
    filters = stacked.permute(0, 1, 3, 4, 2) if stacked.ndim == 5 else stacked
    turned = orthogonalized(filters.flatten(2))
    found = turned.to(stacked.dtype).view(filters.shape)
    found = found.permute(0, 1, 4, 2, 3) if stacked.ndim == 5 else found
    longest = max(turned.shape[1:])
    torch._foreach_add_(values, found.unbind(), alpha=-_RATE * rate * longest**0.5)


def orthogonalized(matrices: torch.Tensor) -> torch.Tensor:
    """Matrices (N, R, C) with singular values of 0.5 to 1.5 instead of theirs, in bfloat16."""
    tall = matrices.shape[1] > matrices.shape[2]
    wide = (matrices.mT if tall else matrices).bfloat16()
    wide = wide / wide.norm(dim=(1, 2), keepdim=True).clamp_min(_LEAST)
    first, third, fifth = _POLYNOMIAL
    for _ in range(_ROUNDS):
        gram = wide @ wide.mT
        wide = torch.baddbmm(wide, torch.baddbmm(gram, gram, gram, beta=third, alpha=fifth), wide, beta=first)
    return wide.mT if tall else wide
