"""Torch tensors as Warp arrays."""

from __future__ import annotations

from typing import Any

import torch
import warp as wp


def contiguous(tensor: torch.Tensor) -> torch.Tensor:
    """Contiguous tensor in Warp's sense, to which an empty one with odd strides is not contiguous, unlike torch's."""
    tensor = tensor.contiguous()
    return tensor if tensor.numel() else tensor.new_empty(tensor.shape)


def warp_array(tensor: torch.Tensor, dtype: Any = None) -> wp.array:
    """A Warp array over a tensor's memory, without gradient.

    Args:
        tensor: Any strides; of a vector's or a matrix's type the last dimensions are contiguous.
        dtype: Warp's type; by default the tensor's scalars.
    """
    return wp.from_torch(tensor.detach(), dtype=dtype, requires_grad=False)
