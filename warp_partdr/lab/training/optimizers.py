"""Optimizers of a training run: AdamW, or Muon for matrices and convolutions and AdamW for all else."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import torch

from .config import TrainingConfig
from .muon import Muon

# Layers that see pictures or say results, and tables: matrices that Muon is not for.
_OTHERS = ("stem.", "heads.", "uncertainty.layers.2.", "attention.names")


def make_optimizer(config: TrainingConfig, model: torch.nn.Module, device: torch.device) -> torch.optim.Optimizer:
    """The run's optimizer of all parameters of ``model``."""
    named = dict(model.named_parameters())
    matrices = [value for name, value in named.items() if config.optimizer == "muon" and _is_matrix(name, value)]
    taken = set(matrices)
    rest = [value for value in named.values() if value not in taken]
    found: list[torch.optim.Optimizer] = []
    if matrices:
        found.append(Muon(matrices, lr=config.learning_rate, weight_decay=config.weight_decay))
    if rest:
        groups = _groups(rest, config.weight_decay)
        fused = device.type == "cuda"
        found.append(torch.optim.AdamW(groups, lr=config.learning_rate, betas=config.betas, fused=fused))
    return found[0] if len(found) == 1 else cast(torch.optim.Optimizer, _Joined(found))


def _is_matrix(name: str, value: torch.Tensor) -> bool:
    return value.ndim in (2, 4) and not any(other in name for other in _OTHERS)


def _groups(parameters: Sequence[torch.nn.Parameter], decay: float) -> list[dict[str, Any]]:
    """Weights that decay, and biases and normalisation, which don't."""
    weights = [parameter for parameter in parameters if parameter.ndim > 1]
    others = [parameter for parameter in parameters if parameter.ndim <= 1]
    groups = [{"params": weights, "weight_decay": decay}, {"params": others, "weight_decay": 0.0}]
    return [group for group in groups if group["params"]]


class _Joined:
    """Several optimizers as one, as far as a run asks of one."""

    def __init__(self, optimizers: Sequence[torch.optim.Optimizer]) -> None:
        self._optimizers = optimizers

    @property
    def param_groups(self) -> list[dict[str, Any]]:
        return [group for each in self._optimizers for group in each.param_groups]

    @property
    def state(self) -> dict[torch.Tensor, Any]:
        return {parameter: state for each in self._optimizers for parameter, state in each.state.items()}

    def step(self) -> None:
        for each in self._optimizers:
            each.step()

    def zero_grad(self) -> None:
        for each in self._optimizers:
            each.zero_grad()

    def state_dict(self) -> dict[str, Any]:
        return {"param_groups": self.param_groups}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """State by the place of each parameter in all groups, one after another."""
        first = 0
        for each in self._optimizers:
            groups = each.state_dict()["param_groups"]
            last = first + sum(len(group["params"]) for group in groups)
            own = {index - first: value for index, value in state["state"].items() if first <= index < last}
            each.load_state_dict({"state": own, "param_groups": groups})
            first = last
