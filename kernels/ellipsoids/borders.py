"""Front surfaces and outlines at points of the picture, their crossings, and the cost of moving a border."""

from typing import Any

import warp as wp

from ..labels import excess_at
from .forces import EllipsoidView
from .silhouette import Silhouette, along_row, inside_at, middle_at, row_lean, row_root, to_disc

_TINY = wp.constant(1.0e-18)  # smallest ``inside_at`` at which a front's slope is taken
_ROOT_STEPS = wp.constant(4)  # of false position


@wp.func
def root_at(s: Silhouette, x: float, y: float):
    """Nearness of the front surface less that of the outline's plane, a square root; 0 outside."""
    return s.bulge * wp.sqrt(wp.max(inside_at(s, x, y), 0.0))


@wp.func
def front_at(s: Silhouette, x: float, y: float):
    """Nearness of the front surface; outside the outline, of the outline's plane."""
    return middle_at(s, x, y) + root_at(s, x, y)


@wp.func
def outward_at(s: Silhouette, x: float, y: float):
    """Outward normal of the outline, not of unit length: gradient of -inside_at / 2."""
    place = to_disc(s, x - s.mean[0], y - s.mean[1])
    return wp.vec2(s.factor[0] * place[0] + s.factor[1] * place[1], s.factor[2] * place[1])


@wp.func
def radicand_at(s: Silhouette, x: float, y: float):
    """Square of ``root_at``, negative outside."""
    return s.bulge * s.bulge * inside_at(s, x, y)


@wp.func
def radicand_slope(s: Silhouette, x: float, y: float):
    """Gradient of ``radicand_at`` in the picture."""
    return -2.0 * s.bulge * s.bulge * outward_at(s, x, y)


@wp.func
def slope_at(s: Silhouette, x: float, y: float, root: float):
    """Gradient in the picture of the front surface's nearness, given its ``root_at``."""
    return s.slope - s.bulge * (s.bulge / root) * outward_at(s, x, y)


@wp.func
def nearness_slope(s: Silhouette, x: float, y: float):
    """Gradient in the picture of the front surface's nearness."""
    return slope_at(s, x, y, s.bulge * wp.sqrt(wp.max(inside_at(s, x, y), _TINY)))


@wp.func
def front_gap(one: Silhouette, other: Silhouette, x: float, y: float):
    """Nearness of one front surface less that of the other: positive where ``one`` is in front."""
    return middle_at(one, x, y) - middle_at(other, x, y) + root_at(one, x, y) - root_at(other, x, y)


@wp.func
def find_crossing(
    one: Silhouette, other: Silhouette, start: wp.vec2, way: wp.vec2, low: float, high: float, gaps: wp.vec2
):
    """Root of ``front_gap`` along a line, as a share of ``way``, between two shares at which its signs differ."""
    share = low
    low_gap = gaps[0]
    high_gap = gaps[1]
    for _ in range(_ROOT_STEPS):
        share = low + (high - low) * low_gap / (low_gap - high_gap)
        here = front_gap(one, other, start[0] + share * way[0], start[1] + share * way[1])
        if (here < 0.0) == (low_gap < 0.0):
            low = share
            low_gap = here
            high_gap *= 0.5  # the Illinois method: else one end may never move
        else:
            high = share
            high_gap = here
            low_gap *= 0.5
    return share


@wp.func
def line_root(s: Silhouette, x: float, y: float, axis: int):
    """Discriminant of the intersection of the outline with the line through (x, y) along an axis; positive if any."""
    if axis == 0:
        return row_root(s, y - s.mean[1])
    reach = s.factor[0] * (x - s.mean[0])
    return 1.0 - reach * reach


@wp.func
def outline_end(s: Silhouette, x: float, y: float, axis: int, side: float):
    """Coordinate at which the line through (x, y) along an axis leaves (side 1) or enters (side -1) the outline."""
    root = wp.sqrt(wp.max(line_root(s, x, y, axis), 0.0))
    if axis == 0:
        return s.mean[0] + (side * root - row_lean(s, y - s.mean[1])) / along_row(s)
    upward = wp.sign(s.factor[2])  # negative if the camera mirrors the picture
    return s.mean[1] + (side * upward * root - s.factor[1] * (x - s.mean[0])) / s.factor[2]


@wp.func
def chord_shares(view: EllipsoidView, start: wp.vec2, end: wp.vec2, inside: int, outside: int, gradient: Any):
    """Mean cost of area inside less that outside along a chord, shared between its two ends by linear interpolation."""
    way = end - start
    # The share of the chord that is in the picture is ``here`` to ``last``.
    here = float(0.0)
    last = float(1.0)
    for axis in range(2):
        size = float(wp.where(axis == 0, view.width, view.height))
        if way[axis] != 0.0:
            one = -start[axis] / way[axis]
            other = (size - start[axis]) / way[axis]
            here = wp.max(here, wp.min(one, other))
            last = wp.min(last, wp.max(one, other))
        elif start[axis] < 0.0 or start[axis] >= size:
            last = 0.0
    column = int(wp.clamp(start[0] + here * way[0], 0.0, float(view.width - 1)))
    row = int(wp.clamp(start[1] + here * way[1], 0.0, float(view.height - 1)))
    right = int(wp.where(way[0] > 0.0, 1, 0))
    down = int(wp.where(way[1] > 0.0, 1, 0))
    shares = wp.vec2()
    while here < last and column >= 0 and row >= 0 and column < view.width and row < view.height:
        next_x = float(2.0)
        next_y = float(2.0)
        if way[0] != 0.0:
            next_x = (float(column + right) - start[0]) / way[0]
        if way[1] != 0.0:
            next_y = (float(row + down) - start[1]) / way[1]
        there = wp.clamp(wp.min(next_x, next_y), here, last)
        excess = excess_at(gradient, view.target, inside, outside, row * view.width + column)
        middle = 0.5 * (here + there)
        shares += excess * (there - here) * wp.vec2(1.0 - middle, middle)
        if next_x < next_y:
            column += 2 * right - 1
        else:
            row += 2 * down - 1
        here = there
    return shares
