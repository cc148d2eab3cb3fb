"""Feet that stand in films, which do not slide.

One camera sees hardly how far away a foot is, so there a foot that stands slides to and fro. It sees very well whether
the foot moves across the view, and that says which feet stand.
"""

from __future__ import annotations

import math

import torch

FEET = ("left_heel", "left_big_toe", "left_small_toe", "right_heel", "right_big_toe", "right_small_toe")
POINTS = len(FEET) // 2  # of a foot
# Standard deviations of speeds across the view, along each of its axes [m/s], of feet that stand and of others: in fits
# of PartBench's clips 0 to 11 without this term they are 0.07 and 0.74, and large ones are commoner than normal.
_STANDS, _MOVES = 0.15, 0.75


def slides(seen: torch.Tensor, shown: torch.Tensor, rate: torch.Tensor) -> torch.Tensor:
    """Squared speeds of points in each frame since the one before [m^2/s^2], times how surely they stand.

    A point stands or moves, as likely before its speed is seen; speeds across the view are normal about 0. Of several
    views the one that sees it fastest counts. What tells is no part of the gradient: nothing is to move so as to count
    less.

    Args:
        seen: Points in each camera's frame [m], shape (P, T, V, F, 3).
        shown: Who is seen where, shape (P, T, V), bool; where nobody sees a person, nothing stands.
        rate: Frames a second, shape ().

    Returns:
        Shape (P, T - 1, F).
    """
    velocities = (seen[:, 1:] - seen[:, :-1]) * rate
    squares = velocities.square().sum(-1)
    with torch.no_grad():
        rays = torch.nn.functional.normalize(seen[:, 1:] + seen[:, :-1], dim=-1)
        across = squares - (velocities * rays).sum(-1).square()
        both = (shown[:, 1:] & shown[:, :-1])[..., None]
        odds = 2 * math.log(_MOVES / _STANDS) - across / 2 * (_STANDS**-2 - _MOVES**-2)
        stands = odds.masked_fill(~both, math.inf).amin(2).sigmoid() * both.any(2)
    return stands * squares[:, :, 0]
