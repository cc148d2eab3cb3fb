"""Outlines as borders of labels: where nothing hides one and another label, or none, lies behind.

An outline belongs to one ellipsoid. It is walked in steps of a share of a pixel; where what lies behind it, or in
front, changes within a step, the step is halved to find where.
"""

from typing import Any

import warp as wp

from .ellipsoid_borders import chord_shares
from .ellipsoids import Silhouette, lowest_bit, middle_at, room_at
from .surface_forces import Ellipsoid, SurfaceForces, add_image_force, from_unit

wp.set_module_options({"enable_backward": False})

_MAX_STEPS = wp.constant(float(2**22))  # of an outline: with more, float32 would hardly tell their angles apart


@wp.struct
class Circle:
    """The outline on the unit sphere: offset + first cos + second sin."""

    offset: wp.vec3
    first: wp.vec3
    second: wp.vec3


@wp.func
def outline_circle(e: Ellipsoid, perspective: bool):
    """Where rays of the camera touch the ellipsoid."""
    # The direction away from the camera in the space where the ellipsoid is the unit sphere.
    away = wp.cw_div(wp.vec3(e.axes[2, 0], e.axes[2, 1], e.axes[2, 2]), e.semi_axes)
    if perspective:
        away = wp.cw_div(wp.transpose(e.axes) * e.centre, e.semi_axes)
    direction = wp.normalize(away)
    circle = Circle()
    radius = float(1.0)
    if perspective:
        cosine = 1.0 / wp.length(away)
        circle.offset = -cosine * direction
        radius = wp.sqrt(wp.max(1.0 - cosine * cosine, 0.0))
    helper = wp.vec3(1.0, 0.0, 0.0)
    if wp.abs(direction[0]) > 0.7:
        helper = wp.vec3(0.0, 1.0, 0.0)
    first = wp.normalize(wp.cross(direction, helper))
    circle.first = radius * first
    circle.second = radius * wp.cross(direction, first)
    return circle


@wp.struct
class OutlinePoint:
    """One point of an outline, and what lies behind it."""

    unit: wp.vec3
    image: wp.vec2  # [px]
    behind: int  # label, 0 = background; -1 where the outline is no border of labels


@wp.func
def outline_point(e: Ellipsoid, circle: Circle, angle: float, perspective: bool):
    """Where the outline is at an angle."""
    found = OutlinePoint()
    found.unit = circle.offset + wp.cos(angle) * circle.first + wp.sin(angle) * circle.second
    point = e.centre + from_unit(e, found.unit)
    if perspective:
        point = point / point[2]
    found.image = wp.vec2(e.camera[0] * point[0] + e.camera[2], e.camera[1] * point[1] + e.camera[3])
    found.behind = -1
    return found


@wp.func
def look_at_outline(
    e: Ellipsoid,
    s: Silhouette,
    silhouettes: wp.array[Silhouette],
    neighbours: wp.array[wp.uint32],
    circle: Circle,
    angle: float,
    perspective: bool,
    height: int,
    width: int,
):
    """An outline is a border where nothing hides it and another label, or none, lies behind."""
    found = outline_point(e, circle, angle, perspective)
    x = found.image[0]
    y = found.image[1]
    if x < 0.0 or y < 0.0 or x >= float(width) or y >= float(height):
        return found
    nearness = middle_at(s, x, y)
    behind = float(-wp.inf)
    label = int(0)
    for word in range(neighbours.shape[0]):
        bits = neighbours[word]
        while bits != wp.uint32(0):
            j = 32 * word + lowest_bit(bits)
            bits &= bits - wp.uint32(1)
            other = silhouettes[j]
            room = room_at(other, x, y)
            if room > 0.0:
                there = middle_at(other, x, y) + wp.sqrt(room)
                if there > behind:
                    behind = there
                    label = other.label
    if behind < nearness and label != s.label:
        found.behind = label
    return found


@wp.func
def push_outline(
    sums: SurfaceForces,
    e: Ellipsoid,
    s: Silhouette,
    start: OutlinePoint,
    end: OutlinePoint,
    behind: int,
    t: int,
    perspective: bool,
    gradient: Any,
    height: int,
    width: int,
):
    """Force of a bit of outline: cost times the outward normal times length, which is its chord turned by a quarter."""
    if behind < 0:
        return sums
    shares = chord_shares(start.image, end.image, s.label, behind, t, gradient, height, width)
    if shares[0] == 0.0 and shares[1] == 0.0:
        return sums
    normal = wp.vec2(end.image[1] - start.image[1], start.image[0] - end.image[0])
    if wp.dot(normal, 0.5 * (start.image + end.image) - s.mean) < 0.0:
        normal = -normal
    first = shares[0] * normal
    second = shares[1] * normal
    sums = add_image_force(sums, e, start.unit, first[0], first[1], perspective)
    return add_image_force(sums, e, end.unit, second[0], second[1], perspective)


@wp.func
def walk_outline(
    sums: SurfaceForces,
    e: Ellipsoid,
    s: Silhouette,
    silhouettes: wp.array[Silhouette],
    neighbours: wp.array[wp.uint32],
    t: int,
    lane: int,
    lanes: int,
    steps_per_pixel: float,
    halvings: int,
    perspective: bool,
    gradient: Any,
    height: int,
    width: int,
):
    """Forces of an ellipsoid's own outline; each thread walks one piece of it."""
    circle = outline_circle(e, perspective)
    half = 0.5 * (s.high - s.low)
    # The root mean square of the radii bounds the perimeter from above. One of millions of pixels gets longer steps.
    count = int(wp.min(steps_per_pixel * 2.0 * wp.pi * wp.length(half) * wp.sqrt(0.5), _MAX_STEPS)) + 9
    each = (count + lanes - 1) // lanes
    step = 2.0 * wp.pi / float(each * lanes)
    n = lane * each
    start = look_at_outline(e, s, silhouettes, neighbours, circle, float(n) * step, perspective, height, width)
    for i in range(each):
        low = float(n + i) * step
        high = low + step
        end = look_at_outline(e, s, silhouettes, neighbours, circle, high, perspective, height, width)
        if start.behind == end.behind:
            sums = push_outline(sums, e, s, start, end, end.behind, t, perspective, gradient, height, width)
        else:
            # What lies behind, or in front, changes in between: find where.
            for _ in range(halvings):
                angle = 0.5 * (low + high)
                middle = look_at_outline(e, s, silhouettes, neighbours, circle, angle, perspective, height, width)
                if middle.behind == start.behind:
                    low = angle
                else:
                    high = angle
            turn = outline_point(e, circle, 0.5 * (low + high), perspective)
            sums = push_outline(sums, e, s, start, turn, start.behind, t, perspective, gradient, height, width)
            sums = push_outline(sums, e, s, turn, end, end.behind, t, perspective, gradient, height, width)
        start = end
    return sums
