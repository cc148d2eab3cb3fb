"""Torch tensors as Warp arrays."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import torch
import warp as wp


def contiguous(tensor: torch.Tensor) -> torch.Tensor:
    """Contiguous tensor in Warp's sense, to which an empty one with odd strides is not contiguous, unlike torch's."""
    tensor = tensor.contiguous()
    return tensor if tensor.numel() else tensor.new_empty(tensor.shape)


def dense_rows(tensor: torch.Tensor) -> torch.Tensor:
    """Tensor (B, ...) whose rows are contiguous each, such as a slice of columns, which kernels read where it lies."""
    if not tensor.numel() or not tensor[0].is_contiguous():
        return contiguous(tensor)
    return tensor


def warp_array(tensor: torch.Tensor, dtype: Any = None) -> wp.array:
    """A Warp array over a tensor's memory, without gradient.

    Args:
        tensor: Any strides; of a vector's or a matrix's type the last dimensions are contiguous.
        dtype: Warp's type; by default the tensor's scalars.
    """
    return wp.from_torch(tensor.detach(), dtype=dtype, requires_grad=False)


def warp_arrays(tensors: Iterable[torch.Tensor], kinds: Iterable[Any]) -> list[Any]:
    """Warp arrays over tensors' memory, each of its own of Warp's types; None takes a tensor's scalars."""
    return [warp_array(tensor, kind) for tensor, kind in zip(tensors, kinds, strict=True)]


def tensor_over(array: np.ndarray) -> torch.Tensor:
    """A tensor on the CPU over an array's memory, which is only to be read: the array may be read-only.

    Torch would warn of those, and copying them takes as long as an upload to a GPU.
    """
    tensor: torch.Tensor = wp.to_torch(wp.array(np.ascontiguousarray(array), copy=False, device="cpu"))
    return tensor
