"""Batch normalisation over the joint batch of all processes, on any device, that never lets the host wait.

torch's ``SyncBatchNorm`` is for CUDA alone and drops processes without samples by a mask, whose size the host must
know: a wait in each layer, in which it launches nothing. Here every process has samples.
"""

from __future__ import annotations

from typing import Any

import torch
import torch.distributed as dist
from torch import nn
from torch.nn.modules.batchnorm import _BatchNorm

from ...interop.derivatives import once


def normalise_jointly(model: nn.Module) -> nn.Module:
    """Make each batch normalisation within a model a ``JointBatchNorm``, in place, and return the model."""
    for module in model.modules():
        if isinstance(module, _BatchNorm):
            assert module.affine
            assert module.track_running_stats
            module.__class__ = JointBatchNorm  # of its attributes nothing changes
    return model


class JointBatchNorm(_BatchNorm):
    """Batch normalisation with the statistics of all processes' samples while training."""

    running_mean: torch.Tensor
    running_var: torch.Tensor
    num_batches_tracked: torch.Tensor
    momentum: float

    def _check_input_dim(self, input: torch.Tensor) -> None:
        pass  # of any number

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        """Shape (B, C, ...), of any dtype; statistics are float32."""
        if not self.training:
            return super().forward(values)
        mean, variance, count = self._joint_statistics(values.detach())
        with torch.no_grad():
            self.running_mean.lerp_(mean, self.momentum)
            self.running_var.lerp_(variance * (count / (count - 1).clamp_min(1)), self.momentum)
            self.num_batches_tracked.add_(1)
        normalised: torch.Tensor = _Normalise.apply(values, self.weight, self.bias, mean, variance, count, self.eps)
        return normalised

    def _joint_statistics(self, values: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Mean, biased variance and number of samples a channel, of all processes."""
        own = values.numel() // values.shape[1]
        # What it would update only tells of what type the statistics are to be.
        unused = torch.empty_like(self.running_mean), torch.empty_like(self.running_var)
        mean, variance = torch.batch_norm_update_stats(values, *unused, 0.0)
        found = torch.stack([mean, variance, torch.full_like(mean, own)])
        each = found.new_empty(dist.get_world_size(), *found.shape)
        dist.all_gather(list(each), found)
        means, variances, counts = each.unbind(1)
        count = counts.sum(0)
        mean = (means * counts).sum(0) / count
        variance = ((variances + (means - mean).square()) * counts).sum(0) / count
        return mean, variance, count


def _normalise(values: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor, *statistics: Any) -> torch.Tensor:
    """``weight * (values - mean) / sqrt(variance + eps) + bias``, in one kernel."""
    mean, variance, eps = statistics
    return torch.native_batch_norm(values, weight, bias, mean, variance, False, 0.0, eps)[0]


class _Normalise(torch.autograd.Function):
    """``_normalise``, whose mean and variance are functions of all processes' values."""

    @staticmethod
    def forward(ctx: Any, values: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor, *statistics: Any) -> Any:
        mean, variance, count, eps = statistics
        ctx.save_for_backward(values, weight, mean, variance, count)
        ctx.eps = eps
        return _normalise(values, weight, bias, mean, variance, eps)

    @staticmethod
    def backward(ctx: Any, *gradients: Any) -> Any:
        values, weight, mean, variance, count = ctx.saved_tensors
        inverse = (variance + ctx.eps).rsqrt()
        # As if the statistics were constants, then what their being means takes away.
        through, of_weight, of_bias = torch.ops.aten.native_batch_norm_backward(
            gradients[0], values, weight, mean, variance, mean, inverse, False, ctx.eps, [True, True, True]
        )
        joint = torch.stack([of_weight, of_bias])
        dist.all_reduce(joint)
        share = -weight * inverse / count
        through = through + _normalise(values, share * joint[0], share * joint[1], mean, variance, ctx.eps)
        found = once("JointBatchNorm", (through, of_weight, of_bias), *gradients, values, weight)
        return *found, None, None, None, None
