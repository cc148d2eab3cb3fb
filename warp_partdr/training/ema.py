"""The running mean of a network's weights."""

from __future__ import annotations

from copy import deepcopy

import torch


class RunningMean:
    """Exponential moving average of a network's weights, and of its floating-point buffers.

    torch's ``AveragedModel`` counts the steps on the device, for which the host would wait to raise the decay.

    Args:
        model: The network that is trained, not yet wrapped; ``module`` begins as a copy of it.
        decay: Share of the mean that stays at a step; lower in the first steps.
    """

    def __init__(self, model: torch.nn.Module, decay: float) -> None:
        self.module = deepcopy(model).eval().requires_grad_(False)
        self._decay = decay

    @torch.no_grad()
    def update(self, model: torch.nn.Module, step: int) -> None:
        """Take in the weights after step ``step``, counted from 1."""
        kept = min(self._decay, (1 + step) / (10 + step))
        means, news = ([*module.parameters(), *module.buffers()] for module in (self.module, model))
        floats = [pair for pair in zip(means, news, strict=True) if pair[0].is_floating_point()]
        torch._foreach_lerp_([mean for mean, _ in floats], [new for _, new in floats], 1 - kept)
        for mean, new in zip(means, news, strict=True):
            if not mean.is_floating_point():
                mean.copy_(new)
