"""The derivative of covered area from one crossing of a border between each two neighbouring pixels that differ.

What ``ellipsoid_coverage`` walks along outlines and creases is sampled here where the picture shows it: on the lines
through pixel centres. A row and a column that cross a border share it by the squares of its normal, so that every bit
of border counts once. Nothing is looked for: who is seen on either side says which border runs between them, and its
place follows in closed form (an outline) or from a few steps of false position (a crease). Parts too thin to cover a
pixel's centre have no gradient. Every thread adds in a fixed order.
"""

from collections.abc import Sequence
from typing import Any

import warp as wp

from .ellipsoid_borders import lead, nearness_slope, outline_end
from .ellipsoids import Seen, Silhouette, middle_at, room_at
from .lanes import count_up, tell
from .surface_forces import (
    BLOCK,
    Forces,
    Scene,
    SurfaceForces,
    Worker,
    launch_on_ellipsoids,
    load_ellipsoid,
    make_scene,
    rests,
    store_forces,
    worker_of,
)
from .targets import DenseGradient, LabelTarget, are_words, excess_at, flat, target_of, words_of

wp.set_module_options({"enable_backward": False, "fast_math": True})

_QUAD = wp.constant(4)  # pixels a word
_ROOT_STEPS = wp.constant(4)  # of false position
_EACH_BYTE = wp.constant(wp.uint32(0x01010101))
_LOW_BITS = wp.constant(wp.uint32(0x7F7F7F7F))
_TOP_BITS = wp.constant(wp.uint32(0x80808080))
_LAST_BIT = wp.constant(wp.uint32(0x80000000))


@wp.func
def find_equal(
    parts: wp.array[wp.uint8],
    words: wp.array[wp.uint32],
    in_words: bool,
    row: int,
    quad: int,
    width: int,
    value: int,
):
    """The top bit of each byte that is set where one of four pixels has a value; past the border as the last pixel."""
    if in_words:
        differ = words[row * (width // _QUAD) + quad] ^ (wp.uint32(value) * _EACH_BYTE)
        return ~(((differ & _LOW_BITS) + _LOW_BITS) | differ) & _TOP_BITS
    equal = wp.uint32(0)
    for i in range(_QUAD):
        if int(parts[row * width + wp.min(_QUAD * quad + i, width - 1)]) == value:
            equal |= wp.uint32(0x80) << wp.uint32(8 * i)
    return equal


@wp.func
def find_borders(
    parts: wp.array[wp.uint8],
    words: wp.array[wp.uint32],
    in_words: bool,
    row: int,
    quad: int,
    height: int,
    width: int,
    value: int,
):
    """Where one of 4 by 4 pixels and its neighbour to the right or below has a value: a bit each, see ``place_of``."""
    borders = wp.uint32(0)
    here = find_equal(parts, words, in_words, wp.min(row, height - 1), quad, width, value)
    for i in range(_QUAD):
        # Past the picture's border as at it: a pixel does not differ from itself.
        at = wp.min(row + i, height - 1)
        below = find_equal(parts, words, in_words, wp.min(at + 1, height - 1), quad, width, value)
        if row + i < height:
            right = here >> wp.uint32(8)
            if int(parts[at * width + wp.min(_QUAD * (quad + 1), width - 1)]) == value:
                right |= _LAST_BIT
            borders |= ((here ^ right) >> wp.uint32(2 * i)) | ((here ^ below) >> wp.uint32(2 * i + 1))
        here = below
    return borders


@wp.func
def place_of(bit: int):
    """Row and column among 4 by 4 pixels, and whether the neighbour is to the right (0) or below (1)."""
    down = 7 - bit % 8
    return wp.vec3i(down // 2, bit // 8, down % 2)


@wp.func
def nth_bit(bits: wp.uint32, n: int):
    """Index of the bit before which n others are set."""
    index = int(0)
    left = n
    rest = bits
    for i in range(5):
        half = 16 >> i
        count = wp.bit_count(rest & ((wp.uint32(1) << wp.uint32(half)) - wp.uint32(1)))
        if left >= count:
            left -= count
            rest = rest >> wp.uint32(half)
            index += half
    return index


@wp.struct
class Lever:
    """What turns a force at a place of the picture into one on an ellipsoid."""

    centre: wp.vec3  # [m]
    camera: wp.vec4  # f_x, f_y, c_x, c_y
    perspective: bool


@wp.func
def push_outline(sums: SurfaceForces, lever: Lever, s: Silhouette, axis: int, x: float, y: float, excess: float):
    """Force on an ellipsoid whose outline a line along an axis crosses at (x, y)."""
    dx = x - s.mean[0]
    dy = y - s.mean[1]
    normal = wp.normalize(wp.vec2(s.conic[0] * dx + s.conic[1] * dy, s.conic[1] * dx + s.conic[2] * dy))
    amount = excess * wp.abs(wp.where(axis == 0, normal[0], normal[1]))
    return push_picture(sums, lever, x, y, middle_at(s, x, y), amount * normal, 0.0)


@wp.func
def push_crease(
    sums: SurfaceForces, lever: Lever, s: Silhouette, other: Silhouette, axis: int, x: float, y: float, excess: float
):
    """Force on an ellipsoid whose front crosses another's at (x, y) on a line along an axis."""
    slope = nearness_slope(s, x, y)
    away = slope - nearness_slope(other, x, y)
    across = wp.abs(wp.where(axis == 0, away[0], away[1]))
    length2 = wp.dot(away, away)
    if length2 == 0.0:
        return sums
    nearness = middle_at(s, x, y) + wp.sqrt(wp.max(room_at(s, x, y), 0.0))
    amount = excess * across / length2
    # A surface that moves takes its nearness along: at a fixed place that changes it by the slope times the way back.
    return push_picture(sums, lever, x, y, nearness, -amount * slope, amount)


@wp.func
def push_picture(sums: SurfaceForces, lever: Lever, x: float, y: float, nearness: float, push: wp.vec2, pull: float):
    """Add dL/d(x, y) = push and dL/d nearness = pull of a surface point; its moment is with the way from the centre."""
    ray = wp.vec2((x - lever.camera[2]) / lever.camera[0], (y - lever.camera[3]) / lever.camera[1])
    force = wp.vec3(lever.camera[0] * push[0], lever.camera[1] * push[1], -pull)
    point = wp.vec3(ray[0], ray[1], -nearness)
    if lever.perspective:
        point = wp.vec3(ray[0], ray[1], 1.0) / nearness
        back = force[0] * ray[0] + force[1] * ray[1] + pull * nearness
        force = nearness * wp.vec3(force[0], force[1], -back)
    sums.force += force
    sums.moment += wp.outer(force, point - lever.centre)
    sums.camera += wp.vec4(push[0] * ray[0], push[1] * ray[1], push[0], push[1])
    return sums


@wp.func
def push_border(
    sums: SurfaceForces,
    lever: Lever,
    k: int,
    s: Silhouette,
    silhouettes: wp.array[Silhouette],
    parts: wp.array[wp.uint8],
    t: int,
    row: int,
    column: int,
    axis: int,
    height: int,
    width: int,
    gradient: Any,
):
    """Force on ellipsoid k of the border between a pixel and the next along an axis, one of which shows k."""
    at = row * width + column
    seen = int(parts[at])
    other_part = int(parts[at + wp.where(axis == 0, 1, width)])
    side = float(1.0)
    x = float(column) + 0.5
    y = float(row) + 0.5
    along_x = wp.where(axis == 0, 1.0, 0.0)
    along_y = 1.0 - along_x
    if seen != k + 1:
        # Seen from its own pixel, which is the second.
        side = float(-1.0)
        x += along_x
        y += along_y
        other_part = seen
    # Distances from its own pixel's centre to the other's, from 0 to 1.
    place = wp.clamp(side * (outline_end(s, x, y, axis, side) - wp.where(axis == 0, x, y)), 0.0, 1.0)
    along_x *= side
    along_y *= side
    behind = int(0)  # label across the border
    meet = bool(False)  # a crease
    other = Silhouette()
    if other_part > 0:
        other = silhouettes[other_part - 1]
        behind = other.label
        if behind == s.label:
            return sums
        begin = wp.clamp(side * (outline_end(other, x, y, axis, -side) - wp.where(axis == 0, x, y)), 0.0, 1.0)
        if place < begin:
            behind = 0  # background is between them
        else:
            end_lead = lead(s, other, x + along_x * place, y + along_y * place)
            if place == 1.0 or end_lead <= 0.0:
                begin_lead = lead(s, other, x + along_x * begin, y + along_y * begin)
                if begin > 0.0 and begin_lead < 0.0:
                    return sums  # the other's outline hides this one
                meet = True
                low = begin
                high = place
                if begin_lead <= 0.0:
                    place = begin
                elif end_lead < 0.0:
                    for _ in range(_ROOT_STEPS):
                        place = low + (high - low) * begin_lead / (begin_lead - end_lead)
                        here = lead(s, other, x + along_x * place, y + along_y * place)
                        if here > 0.0:
                            low = place
                            begin_lead = here
                            end_lead *= 0.5  # Illinois: or one end would stay where it is
                        else:
                            high = place
                            end_lead = here
                            begin_lead *= 0.5
    x += along_x * place
    y += along_y * place
    pixel = wp.min(int(y), height - 1) * width + wp.min(int(x), width - 1)
    excess = excess_at(gradient, t, s.label, behind, pixel)
    if excess == 0.0:
        return sums
    if meet:
        return push_crease(sums, lever, s, other, axis, x, y, excess)
    return push_outline(sums, lever, s, axis, x, y, excess)


@wp.func
def find_lane(found: int, number: int, lanes: int):
    """Which thread found a border, counted over all of them; ``found`` are the counts up to each."""
    lane = int(0)
    step = lanes // 2
    while step > 0:
        if int(tell(wp.uint32(found), lane + step - 1)) <= number:
            lane += step
        step = step // 2
    return lane


@wp.func
def push_borders(scene: Scene, w: Worker, lanes: int, gradient: Any):
    """A thread's share in the forces on an ellipsoid."""
    sums = SurfaceForces()
    silhouettes = scene.silhouettes[w.b]
    s = silhouettes[w.k]
    height = scene.parts.shape[1]
    width = scene.parts.shape[2]
    # Pixels whose centres may be inside.
    left = int(wp.clamp(wp.ceil(s.low[0] - 0.5), 0.0, float(width)))
    right = int(wp.clamp(wp.floor(s.high[0] - 0.5), -1.0, float(width - 1)))
    top = int(wp.clamp(wp.ceil(s.low[1] - 0.5), 0.0, float(height)))
    bottom = int(wp.clamp(wp.floor(s.high[1] - 0.5), -1.0, float(height - 1)))
    if left > right or top > bottom or rests(scene.active, w.b):
        return sums
    parts = flat(scene.parts[w.b])
    words = words_of(scene.parts[w.b])
    in_words = are_words(scene.parts)
    t = target_of(gradient, w.b)
    lever = Lever()
    lever.centre = scene.centres[w.b, w.k]
    lever.camera = scene.camera[w.b]
    lever.perspective = scene.perspective
    # And those before them, in squares of 4 by 4.
    first_quad = wp.max(left - 1, 0) // _QUAD
    first_row = wp.max(top - 1, 0)
    across = right // _QUAD - first_quad + 1
    squares = across * ((bottom - first_row) // _QUAD + 1)
    # Each thread looks at a square, then the borders that all of them found are dealt out: looking is quick, pushing is
    # not.
    for turn in range((squares + w.count - 1) // w.count):
        square = turn * w.count + w.number
        borders = wp.uint32(0)
        if square < squares:
            row = first_row + _QUAD * (square // across)
            borders = find_borders(parts, words, in_words, row, first_quad + square % across, height, width, w.k + 1)
        found = count_up(wp.bit_count(borders))
        total = int(tell(wp.uint32(found), lanes - 1))
        for first in range(0, total, lanes):
            finder = find_lane(found, first + w.lane, lanes)
            theirs = tell(borders, finder)
            before = int(tell(wp.uint32(found), finder)) - wp.bit_count(theirs)
            origin = int(tell(wp.uint32(square), finder))
            if first + w.lane < total:
                place = place_of(nth_bit(theirs, first + w.lane - before))
                row = first_row + _QUAD * (origin // across) + place[0]
                column = _QUAD * (first_quad + origin % across) + place[1]
                sums = push_border(
                    sums, lever, w.k, s, silhouettes, parts, t, row, column, place[2], height, width, gradient
                )
    # From the way from the centre to the point of the unit sphere.
    e = load_ellipsoid(scene, w.b, w.k)
    for i in range(3):
        arm = wp.transpose(e.axes) * wp.vec3(sums.moment[i, 0], sums.moment[i, 1], sums.moment[i, 2])
        for j in range(3):
            sums.moment[i, j] = arm[j] / e.semi_axes[j]
    return sums


@wp.kernel(launch_bounds=(BLOCK, 12))  # 80 registers
def push_edges(
    scene: Scene,
    gradient: Any,
    lanes: int,
    forces: Forces,  # OUTPUT
):
    """Sums over the forces on each ellipsoid."""
    w = worker_of(forces, lanes, wp.tid())
    store_forces(forces, w, push_borders(scene, w, lanes, gradient))


for _gradient in (LabelTarget, DenseGradient):
    wp.overload(push_edges, {"gradient": _gradient})


def launch_edge_forces(
    ellipsoids: Sequence[wp.array],  # centres, axes, semi-axes, camera
    seen: Seen,
    parts: wp.array,
    *,
    perspective: bool,
    gradient: Any,  # LabelTarget or DenseGradient
    forces: Forces,
    active: wp.array | None = None,
) -> None:
    """Fill the sums of forces on every ellipsoid; those of bodies that are not active come out 0."""
    scene = make_scene(ellipsoids, seen, parts, perspective=perspective, active=active)
    launch_on_ellipsoids(push_edges, [scene, gradient], forces)
