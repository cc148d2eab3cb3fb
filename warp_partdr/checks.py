"""Checks of tensor arguments at the border: once, with errors that name the argument."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch

FLOATS = (torch.float32, torch.float64, torch.float16, torch.bfloat16)  # taken, and converted to float32


def check_tensor(
    name: str,
    tensor: torch.Tensor,
    shape: tuple[int | None, ...],
    *,
    dtypes: Sequence[torch.dtype],
    like: tuple[str, torch.Tensor] | None = None,
) -> None:
    """Raise unless ``tensor`` has this shape (None = any) and one of the dtypes.

    Args:
        name: The argument's name, for the message.
        tensor: What the user passed.
        shape: Expected size of each dimension; None takes any.
        dtypes: Accepted dtypes.
        like: Name and tensor whose device, and dtype where it is a floating one, must be the same.

    Raises:
        TypeError: If it is no tensor.
        ValueError: If shape, dtype or device differ.
    """
    if not isinstance(tensor, torch.Tensor):
        raise TypeError(f"{name}: {type(tensor).__name__}; expected a torch.Tensor")
    have = tensor.shape
    if have != shape and (
        len(have) != len(shape) or any(want not in (None, size) for want, size in zip(shape, have, strict=True))
    ):
        expected = ", ".join("*" if size is None else str(size) for size in shape)
        raise ValueError(f"{name}: shape {tuple(have)}; expected ({expected})")
    if tensor.dtype not in dtypes:
        raise ValueError(f"{name}: {tensor.dtype}; expected {' or '.join(map(str, dtypes))}")
    if like is not None:
        other_name, other = like
        if tensor.device != other.device:
            raise ValueError(f"{name}: on {tensor.device}; expected {other.device}, as {other_name}")
        if tensor.dtype != other.dtype and tensor.is_floating_point() and other.is_floating_point():
            raise ValueError(f"{name}: {tensor.dtype}; expected {other.dtype}, as {other_name}")


def check_image_size(image_size: Sequence[int]) -> None:
    """Raise ValueError unless ``image_size`` is two positive integers."""
    if len(image_size) != 2 or not all(isinstance(size, int) and size > 0 for size in image_size):
        raise ValueError(f"image_size: {image_size}; expected two positive integers (H, W)")


def check_finite(**tensors: torch.Tensor) -> None:
    """Raise ValueError if a tensor holds NaN or infinity; synchronises with the device, once for all of them."""
    with torch.no_grad():
        sums = torch.stack([tensor.sum(dtype=torch.float64) for tensor in tensors.values()])
        if math.isfinite(sums.sum()):
            return
        for name, tensor in tensors.items():  # which one, if any: large float64 numbers may just add up to infinity
            if not torch.isfinite(tensor).all():
                raise ValueError(f"{name}: holds NaN or infinity; expected finite numbers")
