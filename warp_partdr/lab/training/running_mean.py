"""Running mean of a network's weights over the steps of a run."""

from __future__ import annotations

from copy import deepcopy
from itertools import chain

import torch


class RunningMean:
    """Exponential moving average of a network's weights and floating-point buffers, at first a copy of them.

    The share of the mean that stays at a step is ``decay``, in the first steps (1 + step) / (10 + step). Unlike torch's
    ``AveragedModel`` it counts on the host, so that no step waits for the device.

    Attributes:
        module: The network of mean weights, in evaluation mode.
        steps: Number of updates.
    """

    def __init__(self, model: torch.nn.Module, decay: float) -> None:
        self.module = deepcopy(model).eval().requires_grad_(False)
        self.steps, self._decay = 0, decay

    @torch.no_grad()
    def update(self, model: torch.nn.Module) -> None:
        """Move toward the weights of ``model``; whole numbers become its own."""
        self.steps += 1
        share = 1 - min(self._decay, (1 + self.steps) / (10 + self.steps))
        pairs = [(mean, new.detach()) for mean, new in zip(_tensors(self.module), _tensors(model), strict=True)]
        floats = [pair for pair in pairs if pair[0].is_floating_point()]
        wholes = [pair for pair in pairs if not pair[0].is_floating_point()]
        torch._foreach_lerp_([mean for mean, _ in floats], [new for _, new in floats], share)
        if wholes:
            torch._foreach_copy_([mean for mean, _ in wholes], [new for _, new in wholes])


def _tensors(model: torch.nn.Module) -> chain[torch.Tensor]:
    return chain(model.parameters(), model.buffers())
