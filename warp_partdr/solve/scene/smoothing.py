"""Weights that make the motion of a film's people smooth in time."""

from __future__ import annotations

import torch

_SLOPES = 0.1  # weight of the squared slopes; the unit of time is the standard deviation of the Gaussian
_ROUNDED = 1e-6  # share of a step by which times may be rounded


def time_shares(observed: torch.Tensor, times: torch.Tensor, width: float) -> torch.Tensor:
    """Shares that all frames have in the smooth value of each frame.

    A value and a slope are fitted to the neighbours of each frame with Gaussian weights (local linear regression). At
    the ends of a film, all neighbours are on one side, and their mean alone would hold moving people back. Slopes are
    held a little to 0.

    Args:
        observed: True for frames that count, shape (P, T). If none of them is near, the nearest one counts.
        times: Times of the frames, in the unit of ``width``, shape (T,), float64.
        width: Standard deviation of the Gaussian.

    Returns:
        Shares, shape (P, T, T).
    """
    apart = (times - times[:, None]) / width
    near = (-apart.square() / 2).masked_fill(~observed[:, None], -torch.inf).softmax(-1)
    first = (near * apart).sum(-1, keepdim=True)
    second = (near * apart.square()).sum(-1, keepdim=True) + _SLOPES
    return near * (second - first * apart) / (second - first.square())


def feet_rates(times: torch.Tensor, width: float) -> torch.Tensor | None:
    """Rates of frames, between which feet may stand still: 1 over the time to the next frame [1/s], shape (T - 1,).

    A rate is 0 where the next frame is farther away than ``width``, because a foot may have moved and stopped between
    them. The result is None if all rates are 0.
    """
    steps = times.diff()
    near = steps <= width * (1 + _ROUNDED)
    return torch.where(near, 1 / steps, 0.0) if near.any() else None
