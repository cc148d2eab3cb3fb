"""Convolutions as products of matrices, with which the first call on a GPU starts sooner.

For each new shape, cuDNN makes a plan, and loads kernels that few other shapes use. Products of matrices need no plan,
and share a few kernels. Windows take more memory than the pictures do: these are for few pictures.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F


def convolve_windows(
    values: torch.Tensor,
    weight: torch.Tensor,
    bias: torch.Tensor,
    stride: int = 1,
    zeros: tuple[int, int, int, int] = (0, 0, 0, 0),
) -> torch.Tensor:
    """Convolution of pictures, as a product of their windows and the weights.

    Args:
        values: Pictures, shape (B, C, H, W). If channels come last in memory, windows of 1 x 1 are not copied.
        weight: Weights, shape (D, C, height, width), best with channels last in memory.
        bias: Number that is added to each of the D channels, shape (D,).
        stride: Step of the windows, across and down [px].
        zeros: Padding with zeros around the pictures: left, right, above, below [px].

    Returns:
        Pictures, shape (B, D, h, w), channels last in memory.
    """
    pixels = values.permute(0, 2, 3, 1)
    if any(zeros):
        pixels = F.pad(pixels, (0, 0, *zeros))
    windows = pixels.unfold(1, weight.shape[2], stride).unfold(
        2, weight.shape[3], stride
    )  # (B, h, w, C, height, width)
    rows = windows.permute(0, 1, 2, 4, 5, 3).reshape(-1, weight[0].numel())
    columns = weight.permute(2, 3, 1, 0).reshape(-1, len(weight))
    return torch.addmm(bias, rows, columns).view(*windows.shape[:3], -1).permute(0, 3, 1, 2)
