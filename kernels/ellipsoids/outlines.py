"""Forces of outlines, where nothing hides an ellipsoid's outline and another label, or background, lies behind.

An outline is divided into steps shorter than a pixel; where the ellipsoid behind it, or one in front, changes within a
step, bisection finds the place.
"""

from typing import Any

import warp as wp

from ..lanes import ballot, lowest_bit, shuffle
from .borders import chord_shares
from .forces import EllipsoidView, Sampling, Share
from .picture_forces import PictureForces, add_picture_force
from .silhouette import Silhouette, inside_at, middle_at

_MAX_STEPS = wp.constant(float(2**22))  # of an outline; float32 could hardly distinguish the angles of more
# [rad], where a walk starts: beside the axes, which symmetric bodies have on the borders of pixels. There, rounding
# would choose the pixel that a point of an outline lies in.
_FIRST_ANGLE = wp.constant(0.01)
_NO_BORDER = wp.constant(-1)  # instead of a label


@wp.func
def outline_point(s: Silhouette, angle: float):
    """Point of an outline at an angle of the unit circle of ``to_disc`` [px]."""
    x = wp.cos(_FIRST_ANGLE + angle) / s.factor[0]
    return s.mean + wp.vec2(x, (wp.sin(_FIRST_ANGLE + angle) - s.factor[1] * x) / s.factor[2])


@wp.func
def look_behind(view: EllipsoidView, place: wp.vec2):
    """Label behind a point of the outline, 0 = background; _NO_BORDER if it is hidden or the label is the same."""
    s = view.own
    x, y = place[0], place[1]
    if x < 0.0 or y < 0.0 or x >= float(view.width) or y >= float(view.height):
        return _NO_BORDER
    nearness = middle_at(s, x, y)
    behind = float(-wp.inf)
    label = int(0)
    for word in range(view.neighbours.shape[0]):
        bits = view.neighbours[word]
        while bits != wp.uint32(0):
            j = 32 * word + lowest_bit(bits)
            bits &= bits - wp.uint32(1)
            other = view.silhouettes[j]
            inside = inside_at(other, x, y)
            if inside > 0.0:
                there = middle_at(other, x, y) + other.bulge * wp.sqrt(inside)
                if there > behind:
                    behind = there
                    label = other.label
    if behind < nearness and label != s.label:
        return label
    return _NO_BORDER


@wp.func
def push_outline(forces: PictureForces, view: EllipsoidView, start: wp.vec2, end: wp.vec2, behind: int, gradient: Any):
    """Force of a piece of outline: cost times outward normal times length, the chord turned by 90 degrees."""
    if behind == _NO_BORDER:
        return forces
    s = view.own
    shares = chord_shares(view, start, end, s.label, behind, gradient)
    if shares[0] == 0.0 and shares[1] == 0.0:
        return forces
    normal = wp.vec2(end[1] - start[1], start[0] - end[0])
    if wp.dot(normal, 0.5 * (start + end) - s.mean) < 0.0:
        normal = -normal
    forces = add_picture_force(
        forces, view, start[0], start[1], middle_at(s, start[0], start[1]), shares[0] * normal, 0.0
    )
    return add_picture_force(forces, view, end[0], end[1], middle_at(s, end[0], end[1]), shares[1] * normal, 0.0)


@wp.func
def previous_lane(value: wp.uint32, last: wp.uint32, lane: int, lanes: int):
    """Value of the thread before this one; for the first, the value the last thread had before."""
    return shuffle(wp.where(lane == lanes - 1, last, value), wp.where(lane == 0, lanes, lane) - 1)


@wp.func
def count_steps(view: EllipsoidView, sampling: Sampling):
    """Number of steps, shorter than a pixel, in which an outline is walked."""
    half = 0.5 * (view.own.high - view.own.low)
    # The root mean square of the radii bounds the perimeter from above; one of millions of pixels gets longer steps.
    return int(wp.min(sampling.steps_per_pixel * 2.0 * wp.pi * wp.length(half) * wp.sqrt(0.5), _MAX_STEPS)) + 9


@wp.func
def walk_outline(
    forces: PictureForces, view: EllipsoidView, share: Share, count: int, sampling: Sampling, gradient: Any
):
    """Forces of a share of an ellipsoid's outline in ``count`` steps or more, divided among a warp's threads."""
    s = view.own
    lane = view.lane
    lanes = view.scene.lanes
    turns = (count + share.count * lanes - 1) // (share.count * lanes)
    step = 2.0 * wp.pi / float(turns * share.count * lanes)
    n = share.number * turns * lanes
    # End of a thread's step, and the label behind it.
    place = outline_point(s, float(n) * step)
    behind = look_behind(view, place)
    # Step of this thread within which the label behind changes, and the labels before and after.
    changing = int(-1)
    before_change = int(0)
    after_change = int(0)
    n += lane
    for turn in range(turns + 1):
        changes = bool(False)
        start_behind = int(behind)
        if turn < turns:
            end = outline_point(s, float(n + 1) * step)
            end_behind = look_behind(view, end)
            start = wp.vec2(
                wp.cast(previous_lane(wp.cast(end[0], wp.uint32), wp.cast(place[0], wp.uint32), lane, lanes), float),
                wp.cast(previous_lane(wp.cast(end[1], wp.uint32), wp.cast(place[1], wp.uint32), lane, lanes), float),
            )
            start_behind = int(previous_lane(wp.uint32(end_behind), wp.uint32(behind), lane, lanes))
            place = end
            behind = end_behind
            changes = start_behind != behind
            if not changes:
                forces = push_outline(forces, view, start, place, behind, gradient)
        # Changes are few and bisection is slow: all threads do it at once, when one meets its second change or after
        # the last step.
        if ballot(turn == turns or (changes and changing >= 0)) != wp.uint32(0):
            if changing >= 0:
                low = float(changing) * step
                high = low + step
                for _ in range(sampling.halvings):
                    angle = 0.5 * (low + high)
                    if look_behind(view, outline_point(s, angle)) == before_change:
                        low = angle
                    else:
                        high = angle
                # Usually one of the two pieces is no border.
                turn_place = outline_point(s, 0.5 * (low + high))
                piece = int(wp.where(before_change == _NO_BORDER, 1, 0))
                pieces = int(wp.where(after_change == _NO_BORDER, 1, 2))
                while piece < pieces:
                    start = wp.where(piece == 0, outline_point(s, float(changing) * step), turn_place)
                    end = wp.where(piece == 0, turn_place, outline_point(s, float(changing + 1) * step))
                    now_behind = wp.where(piece == 0, before_change, after_change)
                    forces = push_outline(forces, view, start, end, now_behind, gradient)
                    piece += 1
            changing = -1
        if changes:
            changing = n
            before_change = start_behind
            after_change = behind
        n += lanes
    return forces
