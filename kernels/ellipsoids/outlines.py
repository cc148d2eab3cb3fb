"""Forces of outlines, where nothing hides an ellipsoid's outline and another label, or background, lies behind.

An outline is divided into steps shorter than a pixel; where the ellipsoid behind it, or one in front, changes within a
step, bisection finds the place.
"""

from typing import Any

import warp as wp

from ..lanes import ballot, lowest_bit, shuffle
from ..rotations import column
from .borders import chord_shares
from .forces import Ellipsoid, EllipsoidView, Sampling, Share, SurfaceForces, add_image_force, from_unit, load_ellipsoid
from .silhouette import inside_at, middle_at

_MAX_STEPS = wp.constant(float(2**22))  # of an outline; float32 could hardly distinguish the angles of more
_NO_BORDER = wp.constant(-1)  # instead of a label


@wp.func
def outline_circle(e: Ellipsoid):
    """Outline on the unit sphere: this matrix times (1, cos, sin) of an angle is a point where a ray is tangent."""
    # The direction away from the camera in the space where the ellipsoid is the unit sphere.
    away = wp.cw_div(e.axes[2], e.semi_axes)
    if e.perspective:
        away = wp.cw_div(wp.transpose(e.axes) * e.centre, e.semi_axes)
    direction = wp.normalize(away)
    offset = float(0.0)
    radius = float(1.0)
    if e.perspective:
        offset = -1.0 / wp.length(away)
        radius = wp.sqrt(wp.max(1.0 - offset * offset, 0.0))
    helper = wp.vec3(1.0, 0.0, 0.0)
    if wp.abs(direction[0]) > 0.7:
        helper = wp.vec3(0.0, 1.0, 0.0)
    first = wp.normalize(wp.cross(direction, helper))
    return wp.matrix_from_cols(offset * direction, radius * first, radius * wp.cross(direction, first))


@wp.func
def rim_of(e: Ellipsoid, circle: wp.mat33):
    """Outline as an ``Ellipsoid`` whose "unit sphere" holds (1, cos, sin) of angles, for ``add_image_force``."""
    rim = Ellipsoid()
    rim.centre = e.centre
    rim.axes = wp.matrix_from_cols(
        from_unit(e, column(circle, 0)), from_unit(e, column(circle, 1)), from_unit(e, column(circle, 2))
    )
    rim.semi_axes = wp.vec3(1.0, 1.0, 1.0)
    rim.camera = e.camera
    rim.perspective = e.perspective
    return rim


@wp.func
def turn_to(angle: float):
    """Homogeneous unit vector (1, cos, sin) of an angle along the outline."""
    return wp.vec3(1.0, wp.cos(angle), wp.sin(angle))


@wp.func
def image_of(rim: Ellipsoid, turn: wp.vec3):
    """Projection of a point of the outline [px]."""
    point = rim.centre + from_unit(rim, turn)
    if rim.perspective:
        point = point / point[2]
    return wp.vec2(rim.camera[0] * point[0] + rim.camera[2], rim.camera[1] * point[1] + rim.camera[3])


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
def push_outline(
    sums: SurfaceForces, view: EllipsoidView, rim: Ellipsoid, start: wp.vec3, end: wp.vec3, behind: int, gradient: Any
):
    """Force of a piece of outline: cost times outward normal times length, the chord turned by 90 degrees."""
    if behind == _NO_BORDER:
        return sums
    here = image_of(rim, start)
    there = image_of(rim, end)
    shares = chord_shares(view, here, there, view.own.label, behind, gradient)
    if shares[0] == 0.0 and shares[1] == 0.0:
        return sums
    normal = wp.vec2(there[1] - here[1], here[0] - there[0])
    if wp.dot(normal, 0.5 * (here + there) - view.own.mean) < 0.0:
        normal = -normal
    sums = add_image_force(sums, rim, start, shares[0] * normal)
    return add_image_force(sums, rim, end, shares[1] * normal)


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
def walk_outline(view: EllipsoidView, share: Share, count: int, sampling: Sampling, gradient: Any):
    """Forces of a share of an ellipsoid's outline in ``count`` steps or more, divided among a warp's threads."""
    sums = SurfaceForces()
    e = load_ellipsoid(view)
    lane = view.lane
    lanes = view.scene.lanes
    rim = rim_of(e, outline_circle(e))
    turns = (count + share.count * lanes - 1) // (share.count * lanes)
    step = 2.0 * wp.pi / float(turns * share.count * lanes)
    n = share.number * turns * lanes
    # End of a thread's step, and the label behind it.
    place = turn_to(float(n) * step)
    behind = look_behind(view, image_of(rim, place))
    # Step of this thread within which the label behind changes, and the labels before and after.
    changing = int(-1)
    before_change = int(0)
    after_change = int(0)
    n += lane
    for turn in range(turns + 1):
        changes = bool(False)
        start_behind = int(behind)
        if turn < turns:
            end = turn_to(float(n + 1) * step)
            end_behind = look_behind(view, image_of(rim, end))
            start = wp.vec3(
                1.0,
                wp.cast(previous_lane(wp.cast(end[1], wp.uint32), wp.cast(place[1], wp.uint32), lane, lanes), float),
                wp.cast(previous_lane(wp.cast(end[2], wp.uint32), wp.cast(place[2], wp.uint32), lane, lanes), float),
            )
            start_behind = int(previous_lane(wp.uint32(end_behind), wp.uint32(behind), lane, lanes))
            place = end
            behind = end_behind
            changes = start_behind != behind
            if not changes:
                sums = push_outline(sums, view, rim, start, place, behind, gradient)
        # Changes are few and bisection is slow: all threads do it at once, when one meets its second change or after
        # the last step.
        if ballot(turn == turns or (changes and changing >= 0)) != wp.uint32(0):
            if changing >= 0:
                low = float(changing) * step
                high = low + step
                for _ in range(sampling.halvings):
                    angle = 0.5 * (low + high)
                    middle = image_of(rim, turn_to(angle))
                    if look_behind(view, middle) == before_change:
                        low = angle
                    else:
                        high = angle
                # Usually one of the two pieces is no border.
                turn_place = turn_to(0.5 * (low + high))
                piece = int(wp.where(before_change == _NO_BORDER, 1, 0))
                pieces = int(wp.where(after_change == _NO_BORDER, 1, 2))
                while piece < pieces:
                    start = wp.where(piece == 0, turn_to(float(changing) * step), turn_place)
                    end = wp.where(piece == 0, turn_place, turn_to(float(changing + 1) * step))
                    now_behind = wp.where(piece == 0, before_change, after_change)
                    sums = push_outline(sums, view, rim, start, end, now_behind, gradient)
                    piece += 1
            changing = -1
        if changes:
            changing = n
            before_change = start_behind
            after_change = behind
        n += lanes
    # From (1, cos, sin) to the point of the unit sphere. The circle is found again, for it would occupy registers.
    sums.moment = sums.moment * wp.transpose(outline_circle(load_ellipsoid(view)))
    return sums
