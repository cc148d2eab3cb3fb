"""Gradient "partdr" of exact ellipsoids: the mesh renderer's (paper, eq. 10 to 12) in the limit of ever finer meshes.

A pixel row and a column meet an outline in closed form; there the outline is pulled and pushed by pixels as a mesh's
silhouette edge is, and the force acts on that point of the surface. ``reference/ellipsoids.py`` is the definition.

A wrong pixel of a label that a single ellipsoid shows finds the ends of its row and column without a walk: so all
threads have work. Labels that several ellipsoids share, and dense gradients, are walked line by line. Every thread
adds in a fixed order.
"""

from typing import Any

import warp as wp

from ..labels import (
    EACH_BYTE,
    HIGH_BITS,
    IGNORED,
    QUAD,
    all_wrong,
    are_words,
    expected_block,
    has_extent,
    load_block,
    overload_gradients,
    unequal_bytes,
)
from ..lanes import deal, prefix_sum, shuffle
from .borders import front_at, line_root, outline_end
from .depth_forces import may_push_depths, pull_forward, push_behind
from .forces import BLOCK, EllipsoidView, SceneArrays, SurfaceForces, make_view, store_forces, take_share
from .line_walks import walk_lines, wrong_box
from .picture_forces import PictureForces, add_picture_force, on_surface
from .silhouette import middle_at, pixel_box

wp.set_module_options({"enable_backward": False, "fast_math": True})

FEWEST_SHARES = 4  # of an ellipsoid's work
_WEIGHT = wp.constant(32)  # of a turn of squares of pixels


@wp.func
def may_push_outline(own: wp.uint32, expected: wp.uint32, label: int):
    """Highest bit of each of four pixels where a label that one ellipsoid shows is wrong; ``own`` are its pixels."""
    wanted = unequal_bytes(expected, wp.uint32(label) * EACH_BYTE)
    return (own & wanted & unequal_bytes(expected, IGNORED)) | ~(own | wanted) & HIGH_BITS


@wp.func
def push_ends(forces: PictureForces, view: EllipsoidView, row: int, column: int, max_distance: float):
    """Forces of a wrong pixel on the outline's ends in its row and column, as in ``walk_line``."""
    s = view.own
    x = float(column) + 0.5
    y = float(row) + 0.5
    shown = int(view.parts[row * view.width + column])
    own = shown == view.k + 1
    front = float(-wp.inf)
    if shown > 0 and not own:
        front = front_at(view.silhouettes[shown - 1], x, y)
    n = int(0)
    while n < 4:  # a loop over a constant range would be unrolled
        axis = n // 2
        side = float(2 * (n % 2) - 1)
        if line_root(s, x, y, axis) > 0.0:
            crossing = outline_end(s, x, y, axis, side)
            beyond = side * (wp.where(axis == 0, x, y) - crossing)
            end_x = wp.where(axis == 0, crossing, x)
            end_y = wp.where(axis == 0, y, crossing)
            distance = wp.abs(beyond)
            nearness = middle_at(s, end_x, end_y)
            if (own or (beyond > 0.0 and front < nearness)) and distance <= max_distance:
                slope = side * wp.where(own, 2.0, -2.0) / wp.max(distance, 1.0)
                push = wp.vec2(wp.where(axis == 0, slope, 0.0), wp.where(axis == 0, 0.0, slope))
                forces = add_picture_force(forces, view, end_x, end_y, nearness, push, 0.0)
        n += 1
    return forces


@wp.func
def pixels_to_look_at(view: EllipsoidView, distinct: bool, gradient: Any):
    """First and last column, first and last row of the pixels that may push an ellipsoid."""
    if not has_extent(gradient, view.own.label):
        return pixel_box(view.own, view.height, view.width)
    if not distinct:
        return wrong_box(view, gradient)
    wrong = all_wrong(gradient, view.b, view.own.label)
    return wrong[2], wrong[3], wrong[0], wrong[1]


@wp.func
def push_pixels(view: EllipsoidView, max_distance: float, depth_weight: float, distinct: bool, gradient: Any):
    """Forces of pixels: in z, and in x and y as far as ``walk_outlines`` does not add them."""
    forces = PictureForces()
    left, right, top, bottom = pixels_to_look_at(view, distinct, gradient)
    pushes_outline = distinct and has_extent(gradient, view.own.label)
    image = view.scene.parts[view.b]
    in_words = are_words(view.scene.parts)
    four = wp.uint32(view.k + 1) * EACH_BYTE
    first_quad = left // QUAD
    across = wp.max(right // QUAD - first_quad + 1, 0)
    squares = across * wp.max((bottom - top) // QUAD + 1, 0)
    lanes = view.scene.lanes
    share = take_share(view, 0, view.shares, squares, _WEIGHT)
    if share.count == 0:
        return SurfaceForces()
    # Each thread looks at 4 by 4 pixels, then all share those that matter.
    for turn in range(share.number, (squares + share.turn - 1) // share.turn, share.count):
        square = turn * share.turn + view.lane
        pixels = wp.uint32(0)
        depth_pixels = wp.uint32(0)
        if view.lane < share.turn and square < squares:
            row = top + QUAD * (square // across)
            column = QUAD * (first_quad + square % across)
            shown = load_block(image, row, column, in_words)
            expected = expected_block(gradient, view.target, row, column)
            for i in range(QUAD):
                own = unequal_bytes(shown[i], four) ^ HIGH_BITS
                if pushes_outline:
                    pixels |= may_push_outline(own, expected[i], view.own.label) >> wp.uint32(i)
                if depth_weight != 0.0:
                    found = may_push_depths(gradient, own, shown[i], expected[i], view.own.label)
                    depth_pixels |= found >> wp.uint32(i)
        before = prefix_sum(wp.bit_count(pixels))
        total = int(shuffle(wp.uint32(before), lanes - 1))
        for first in range(0, total, lanes):
            number = first + view.lane
            mine = deal(pixels, before, square, number, lanes)
            if number < total:
                row = top + QUAD * (mine[0] // across) + 7 - mine[1] % 8
                column = QUAD * (first_quad + mine[0] % across) + mine[1] // 8
                forces = push_ends(forces, view, row, column, max_distance)
        before = prefix_sum(wp.bit_count(depth_pixels))
        total = int(shuffle(wp.uint32(before), lanes - 1))
        for first in range(0, total, lanes):
            number = first + view.lane
            mine = deal(depth_pixels, before, square, number, lanes)
            if number < total:
                row = top + QUAD * (mine[0] // across) + 7 - mine[1] % 8
                column = QUAD * (first_quad + mine[0] % across) + mine[1] // 8
                if int(view.parts[row * view.width + column]) == view.k + 1:
                    forces = push_behind(forces, view, row, column, depth_weight, distinct, gradient)
                else:
                    forces = pull_forward(forces, view, row, column, depth_weight, distinct, gradient)
    return on_surface(view, forces)


@wp.kernel(launch_bounds=(BLOCK, 8))  # 128 registers
def partdr_forces(
    scene: SceneArrays,
    max_distance: float,  # [px]
    depth_weight: float,
    distinct: bool,  # no two ellipsoids show the same label, and the gradient is a LabelTarget
    gradient: Any,
    forces: wp.array4d[float],  # as ``spread_forces`` reads them  OUTPUT
):
    """Sums over the forces on each ellipsoid."""
    sums = SurfaceForces()
    view = make_view(scene, forces, gradient, wp.tid())
    if view.own.low[0] <= view.own.high[0]:
        sums = push_pixels(view, max_distance, depth_weight, distinct, gradient)
    store_forces(forces, view, sums, False)


@wp.kernel(launch_bounds=(BLOCK, 8))  # 128 registers
def walk_outlines(
    scene: SceneArrays,
    max_distance: float,  # [px]
    depth_weight: float,
    distinct: bool,  # no two ellipsoids show the same label, and the gradient is a LabelTarget
    gradient: Any,
    forces: wp.array4d[float],  # as ``spread_forces`` reads them  MODIFIED
):
    """Add the forces in x and y that ``partdr_forces`` leaves out."""
    view = make_view(scene, forces, gradient, wp.tid())
    if view.own.low[0] <= view.own.high[0] and has_extent(gradient, view.own.label):
        store_forces(forces, view, walk_lines(view, max_distance, gradient), True)


overload_gradients(partdr_forces, walk_outlines)
