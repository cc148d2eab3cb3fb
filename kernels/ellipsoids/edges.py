"""Gradient "edges" of exact ellipsoids: the area derivative, sampled where a border crosses a line of pixel centres.

``coverage`` integrates along outlines and creases; here each pair of neighbouring pixels with different ellipsoids
gives one sample of the border between them. A row and a column that cross a border share it by the squares of its
normal's components, so that every piece of border counts once. The two ellipsoids give the kind of border, and its
place follows in closed form (an outline) or from a few steps of false position (a crease). Parts too thin to cover a
pixel's centre have no gradient. Every thread adds in a fixed order.
"""

from typing import Any

import warp as wp

from ..labels import EACH_BYTE, HIGH_BITS, QUAD, are_words, excess_at, overload_gradients, unequal_bytes, words_of
from ..lanes import deal, prefix_sum, shuffle
from .borders import find_crossing, front_at, front_gap, nearness_slope, outline_end, outward_at
from .forces import (
    BLOCK,
    EllipsoidView,
    SceneArrays,
    SurfaceForces,
    make_view,
    store_forces,
    take_share,
)
from .picture_forces import PictureForces, add_picture_force, on_surface
from .silhouette import Silhouette, middle_at, pixel_box

wp.set_module_options({"enable_backward": False, "fast_math": True})

FEWEST_SHARES = 2  # of an ellipsoid's work
_WEIGHT = wp.constant(32)  # of a turn of squares
_LAST_BIT = wp.constant(wp.uint32(0x80000000))
_Rows: Any = wp.types.vector(length=QUAD + 1, dtype=wp.uint32)


@wp.func
def load_quad(view: EllipsoidView, row: int, column: int):
    """Four pixels of a row as one word, read one by one; past the picture's border as at it."""
    quad = wp.uint32(0)
    for i in range(QUAD):
        pixel = view.parts[row * view.width + wp.min(column + i, view.width - 1)]
        quad |= wp.uint32(pixel) << wp.uint32(8 * i)
    return quad


@wp.func
def find_borders(view: EllipsoidView, words: wp.array[wp.uint32], in_words: bool, row: int, quad: int):
    """Set of the borders of 4 by 4 pixels with their neighbours to the right and below; ``place_of`` locates a bit."""
    last_row = view.height - 1
    after = wp.min(QUAD * (quad + 1), view.width - 1)
    rows = _Rows()
    nexts = wp.vec4i()
    # All that is needed is loaded before any of it is looked at, so as to wait for memory once.
    if in_words:
        pitch = view.width // QUAD
        for i in range(QUAD + 1):
            rows[i] = words[wp.min(row + i, last_row) * pitch + quad]
    else:
        for i in range(QUAD + 1):
            rows[i] = load_quad(view, wp.min(row + i, last_row), QUAD * quad)
    for i in range(QUAD):
        nexts[i] = int(view.parts[wp.min(row + i, last_row) * view.width + after])

    borders = wp.uint32(0)
    value = view.k + 1
    four = wp.uint32(value) * EACH_BYTE
    here = unequal_bytes(rows[0], four) ^ HIGH_BITS  # the highest bit of each byte that shows the ellipsoid
    for i in range(QUAD):
        # Beyond the picture its last pixels repeat, so that there is no border.
        below = unequal_bytes(rows[i + 1], four) ^ HIGH_BITS
        right = (here >> wp.uint32(8)) | wp.where(nexts[i] == value, _LAST_BIT, wp.uint32(0))
        found = ((here ^ right) >> wp.uint32(2 * i)) | ((here ^ below) >> wp.uint32(2 * i + 1))
        borders |= wp.where(row + i <= last_row, found, wp.uint32(0))
        here = below
    return borders


@wp.func
def place_of(bit: int):
    """Row and column of a border among 4 by 4 pixels, and 0 for the neighbour to the right, 1 for the one below."""
    down = 7 - bit % 8
    return wp.vec3i(down // 2, bit // 8, down % 2)


@wp.func
def push_outline_crossing(forces: PictureForces, view: EllipsoidView, axis: int, x: float, y: float, excess: float):
    """Force on an ellipsoid whose outline a line along an axis crosses at (x, y)."""
    s = view.own
    normal = wp.normalize(outward_at(s, x, y))
    amount = excess * wp.abs(wp.where(axis == 0, normal[0], normal[1]))
    return add_picture_force(forces, view, x, y, middle_at(s, x, y), amount * normal, 0.0)


@wp.func
def push_crease_crossing(
    forces: PictureForces, view: EllipsoidView, other: Silhouette, axis: int, x: float, y: float, excess: float
):
    """Force on an ellipsoid whose front crosses another's at (x, y) on a line along an axis."""
    s = view.own
    slope = nearness_slope(s, x, y)
    away = slope - nearness_slope(other, x, y)
    across = wp.abs(wp.where(axis == 0, away[0], away[1]))
    length2 = wp.dot(away, away)
    if length2 == 0.0:
        return forces
    amount = excess * across / length2
    # A surface that moves by d changes the nearness at a fixed place by -slope . d.
    return add_picture_force(forces, view, x, y, front_at(s, x, y), -amount * slope, amount)


@wp.func
def distance_to_end(s: Silhouette, start: wp.vec2, axis: int, side: float, end: float):
    """Distance along an axis, to one side, of the outline's end [px], clamped to [0, 1], the next pixel's centre."""
    place = outline_end(s, start[0], start[1], axis, end)
    return wp.clamp(side * (place - wp.where(axis == 0, start[0], start[1])), 0.0, 1.0)


@wp.func
def push_border(forces: PictureForces, view: EllipsoidView, row: int, column: int, axis: int, gradient: Any):
    """Force of the border between a pixel and the next along an axis, one of which shows the ellipsoid."""
    s = view.own
    at = row * view.width + column
    seen = int(view.parts[at])
    other_part = int(view.parts[at + wp.where(axis == 0, 1, view.width)])
    start = wp.vec2(float(column) + 0.5, float(row) + 0.5)
    way = wp.where(axis == 0, wp.vec2(1.0, 0.0), wp.vec2(0.0, 1.0))
    side = float(1.0)
    if seen != view.k + 1:
        # The ellipsoid's own pixel is the second: start from there.
        side = -1.0
        start += way
        way = -way
        other_part = seen
    # Distances from its own pixel's centre, 0, to the other's, 1.
    place = distance_to_end(s, start, axis, side, side)
    behind = int(0)  # label across the border
    meet = bool(False)  # a crease
    other = Silhouette()
    if other_part > 0:
        other = view.silhouettes[other_part - 1]
        behind = other.label
        if behind == s.label:
            return forces
        begin = distance_to_end(other, start, axis, side, -side)
        if place < begin:
            behind = 0  # background is between them
        else:
            end_gap = front_gap(s, other, start[0] + place * way[0], start[1] + place * way[1])
            if place == 1.0 or end_gap <= 0.0:
                begin_gap = front_gap(s, other, start[0] + begin * way[0], start[1] + begin * way[1])
                if begin > 0.0 and begin_gap < 0.0:
                    return forces  # the other's outline hides this one
                meet = True
                if begin_gap <= 0.0:
                    place = begin
                elif end_gap < 0.0:
                    place = find_crossing(s, other, start, way, begin, place, wp.vec2(begin_gap, end_gap))
    x = start[0] + place * way[0]
    y = start[1] + place * way[1]
    pixel = wp.min(int(y), view.height - 1) * view.width + wp.min(int(x), view.width - 1)
    excess = excess_at(gradient, view.target, s.label, behind, pixel)
    if excess == 0.0:
        return forces
    if meet:
        return push_crease_crossing(forces, view, other, axis, x, y, excess)
    return push_outline_crossing(forces, view, axis, x, y, excess)


@wp.func
def push_borders(view: EllipsoidView, gradient: Any):
    """Share of one thread in the forces on an ellipsoid."""
    forces = PictureForces()
    left, right, top, bottom = pixel_box(view.own, view.height, view.width)
    if left > right or top > bottom:
        return SurfaceForces()
    scene = view.scene
    words = words_of(scene.parts[view.b])
    in_words = are_words(scene.parts)
    lanes = scene.lanes
    # Squares of 4 by 4 pixels that hold the ellipsoid's pixels and the neighbours before them.
    first_quad = wp.max(left - 1, 0) // QUAD
    first_row = wp.max(top - 1, 0)
    across = right // QUAD - first_quad + 1
    squares = across * ((bottom - first_row) // QUAD + 1)
    share = take_share(view, 0, view.shares, squares, _WEIGHT)
    if share.count == 0:
        return SurfaceForces()
    # Each thread searches a square, then all threads share the borders found: the search is cheap, the forces are not.
    for turn in range(share.number, (squares + share.turn - 1) // share.turn, share.count):
        square = turn * share.turn + view.lane
        borders = wp.uint32(0)
        if view.lane < share.turn and square < squares:
            row = first_row + QUAD * (square // across)
            borders = find_borders(view, words, in_words, row, first_quad + square % across)
        found = prefix_sum(wp.bit_count(borders))
        total = int(shuffle(wp.uint32(found), lanes - 1))
        for first in range(0, total, lanes):
            number = first + view.lane
            mine = deal(borders, found, square, number, lanes)
            if number < total:
                place = place_of(mine[1])
                row = first_row + QUAD * (mine[0] // across) + place[0]
                column = QUAD * (first_quad + mine[0] % across) + place[1]
                forces = push_border(forces, view, row, column, place[2], gradient)
    return on_surface(view, forces)


@wp.kernel(launch_bounds=(BLOCK, 12))  # 80 registers
def push_crossings(
    scene: SceneArrays,
    gradient: Any,
    forces: wp.array4d[float],  # as ``spread_forces`` reads them  OUTPUT
):
    """Sums over the forces on each ellipsoid."""
    view = make_view(scene, forces, gradient, wp.tid())
    store_forces(forces, view, push_borders(view, gradient), False)


overload_gradients(push_crossings)
