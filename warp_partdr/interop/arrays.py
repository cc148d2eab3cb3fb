"""Torch tensors as Warp arrays."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
import torch
import warp as wp


def contiguous(tensor: torch.Tensor) -> torch.Tensor:
    """Make a tensor contiguous for Warp. Unlike torch, Warp wants the usual strides of an empty tensor, too."""
    tensor = tensor.contiguous()
    return tensor if tensor.numel() else tensor.new_empty(tensor.shape)


def dense_rows(tensor: torch.Tensor) -> torch.Tensor:
    """Make each row of a tensor (B, ...) contiguous. Kernels read a slice of columns in place, without a copy."""
    if not tensor.numel() or not tensor[0].is_contiguous():
        return contiguous(tensor)
    return tensor


def warp_array(tensor: torch.Tensor, dtype: Any = None) -> wp.array:
    """Wrap a tensor's memory as a Warp array without gradient.

    Args:
        tensor: Tensor with any strides. For a vector's or a matrix's dtype, the last dimensions must be contiguous.
        dtype: Warp's type; None: the tensor's scalars.
    """
    return wp.from_torch(tensor.detach(), dtype=dtype, requires_grad=False)


def warp_arrays(tensors: Iterable[torch.Tensor], dtypes: Iterable[Any]) -> list[Any]:
    """Wrap tensors' memory as Warp arrays, each with its own type of Warp; None takes the tensor's scalars."""
    return [warp_array(tensor, dtype) for tensor, dtype in zip(tensors, dtypes, strict=True)]


def tensor_over(array: np.ndarray) -> torch.Tensor:
    """Wrap an array's memory as a tensor on the CPU. It must only be read, because the array may be read-only.

    Torch would warn about a read-only array, and a copy takes as long as an upload to a GPU.
    """
    tensor: torch.Tensor = wp.to_torch(wp.array(np.ascontiguousarray(array), copy=False, device="cpu"))
    return tensor


def same_memory(tensors: Sequence[torch.Tensor]) -> tuple[torch.Tensor, ...]:
    """Tensors over the same memory as these, and the same objects as in the last calls.

    ``torch.compile`` may wrap a constant tensor anew in each call. What is kept for a tensor is found by the object.
    """
    return tuple([_first_over(_Memory.of(tensor)) for tensor in tensors])


@dataclass(frozen=True)
class _Memory:
    """Memory of a tensor, which stays where it is while this is kept."""

    place: tuple[int, torch.device, torch.dtype, torch.Size, tuple[int, ...]]
    tensor: torch.Tensor = field(compare=False)

    @classmethod
    def of(cls, tensor: torch.Tensor) -> _Memory:
        place = tensor.data_ptr(), tensor.device, tensor.dtype, tensor.shape, tensor.stride()
        return cls(place, tensor)


@lru_cache(maxsize=64)
def _first_over(memory: _Memory) -> torch.Tensor:
    return memory.tensor
