"""Motion of a film's people that is smooth in time."""

from __future__ import annotations

import torch

_SLOPES = 0.1  # of smooth moves: weight of their squares, in standard deviations of the Gaussian
_ROUNDED = 1e-6  # share of a step, by which times are rounded


def time_shares(seen: torch.Tensor, times: torch.Tensor, width: float) -> torch.Tensor:
    """Shares of frames in each frame's smooth value, by a Gaussian of this standard deviation, (P, T, T).

    Value and slope of each frame are fitted to its neighbours (local linear regression): at the ends of a film, where
    neighbours are on one side, their mean alone would hold moving people back. Slopes are held a little to 0.

    ``seen``, (P, T), says which frames are counted; where none is near, the nearest one is. ``times``, (T,), float64,
    are those of the frames, in the unit of the width.
    """
    apart = (times - times[:, None]) / width
    near = (-apart.square() / 2).masked_fill(~seen[:, None], -torch.inf).softmax(-1)
    first = (near * apart).sum(-1, keepdim=True)
    second = (near * apart.square()).sum(-1, keepdim=True) + _SLOPES
    return near * (second - first * apart) / (second - first.square())


def feet_rates(times: torch.Tensor, width: float) -> torch.Tensor | None:
    """1 over the time from each frame to the next [1/s], shape (T - 1,), where feet may stand from one to the other.

    It is 0 where frames are farther from one another than the width, for a foot may have gone and stood again between
    them. Where it is 0 everywhere it is None.
    """
    steps = times.diff()
    near = steps <= width * (1 + _ROUNDED)
    return torch.where(near, 1 / steps, 0.0) if near.any() else None
