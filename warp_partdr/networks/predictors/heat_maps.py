"""Peaks of heat maps, finer than their cells."""

from __future__ import annotations

import torch
import torch.nn.functional as F

_SPREAD = 0.8  # [cells] of the blur before a peak's shape is looked at
_REACH = 5  # cells that it takes in, each way
_LEAST = 1e-3  # heat below which nothing is told apart
_FARTHEST = 1.0  # cells that a peak may be from its hottest cell


def find_peaks(heat: torch.Tensor) -> torch.Tensor:
    """Peak of each map, with the heat there.

    About its hottest cell a keypoint's heat is a Gaussian, whose logarithm is a parabola: one Newton step finds its
    top (Zhang et al. 2020, "Distribution-Aware Coordinate Representation").

    Args:
        heat: Heat maps, shape (N, K, h, w).

    Returns:
        Column and row [cells], the first cell's centre being 0, and heat, shape (N, K, 3).
    """
    width = heat.shape[-1]
    hottest = heat.flatten(2).max(dim=2)
    cells = torch.stack([hottest.indices % width, hottest.indices // width], dim=-1)
    near = F.pad(_blurred(heat).clamp_min(_LEAST).log(), (1, 1, 1, 1), mode="replicate")

    def at(across: int, down: int) -> torch.Tensor:
        index = (cells[..., 1] + 1 + down) * (width + 2) + cells[..., 0] + 1 + across
        return near.flatten(2).gather(2, index[..., None])[..., 0]

    slope_x, slope_y = (at(1, 0) - at(-1, 0)) / 2, (at(0, 1) - at(0, -1)) / 2
    bend_x, bend_y = at(1, 0) - 2 * at(0, 0) + at(-1, 0), at(0, 1) - 2 * at(0, 0) + at(0, -1)
    bend_xy = (at(1, 1) - at(1, -1) - at(-1, 1) + at(-1, -1)) / 4
    determinant = bend_x * bend_y - bend_xy**2
    steps = torch.stack([bend_xy * slope_y - bend_y * slope_x, bend_xy * slope_x - bend_x * slope_y], dim=-1)
    top = (bend_x < 0) & (determinant > 1e-12)  # else the heat is flat there, or a ridge
    steps = torch.where(top[..., None], steps / determinant.clamp_min(1e-12)[..., None], 0.0)
    return torch.cat([cells + steps.clamp(-_FARTHEST, _FARTHEST), hottest.values[..., None]], dim=-1)


def _blurred(heat: torch.Tensor) -> torch.Tensor:
    steps = torch.arange(-_REACH, _REACH + 1, device=heat.device, dtype=heat.dtype)
    weights = torch.exp(-(steps**2) / (2 * _SPREAD**2))
    weights = weights / weights.sum()
    maps = F.pad(heat.flatten(0, 1)[:, None], (_REACH,) * 4, mode="replicate")
    return F.conv2d(F.conv2d(maps, weights[None, None, None]), weights[None, None, :, None])[:, 0].view_as(heat)
