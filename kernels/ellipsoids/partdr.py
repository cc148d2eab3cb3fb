"""Gradient "partdr" of exact ellipsoids: the mesh renderer's (paper, eq. 10 to 12) in the limit of ever finer meshes.

A pixel row and a column meet an outline in closed form; there the outline is pulled and pushed by pixels as a mesh's
silhouette edge is, and the force acts on that point of the surface. ``reference/ellipsoids.py`` is the definition.
Every thread adds in a fixed order.
"""

from typing import Any

import warp as wp

from ..labels import (
    EACH_BYTE,
    HIGH_BITS,
    IGNORED,
    MISSING,
    QUAD,
    SURPLUS,
    DenseGradient,
    LabelTarget,
    all_wrong,
    are_words,
    expected_block,
    extent,
    has_extent,
    hidden_gradient,
    load_block,
    may_have_gradient,
    overload_gradients,
    pixel_gradient,
    pixels_of,
    unequal_bytes,
    wrong_on_line,
)
from ..lanes import AT_ONCE, at_once, ballot, deal, lowest_bit, prefix_sum, shuffle
from ..mesh.push_z import MIN_DELTA_Z
from .borders import front_at, line_root, outline_end
from .forces import (
    BLOCK,
    Ellipsoid,
    EllipsoidView,
    SceneArrays,
    SurfaceForces,
    add_force,
    add_image_force,
    load_ellipsoid,
    make_view,
    store_forces,
    take_share,
    to_unit,
    unproject,
)
from .silhouette import Silhouette, depth_of, in_box, inside_at, middle_at, pixel_box

wp.set_module_options({"enable_backward": False, "fast_math": True})


FEWEST_SHARES = 4  # of an ellipsoid's work: two for lines and two for depths
_WEIGHT = wp.constant(16)  # of a turn of ends of lines, or of squares of pixels


@wp.func
def label_at(silhouettes: wp.array[Silhouette], part: int):
    """Label of an entry of the image of parts."""
    if part == 0:
        return 0
    return silhouettes[part - 1].label


@wp.func
def shows_label(view: EllipsoidView, part: int, alone: bool):
    """True if an entry of the image of parts shows the ellipsoid's label; ``alone``: no other ellipsoid has it."""
    return part == view.k + 1 or (not alone and label_at(view.silhouettes, part) == view.own.label)


@wp.func
def pixels_within(reach: float, count: int):
    """Number of the first ``count`` pixels of a line that are no farther from its first one than ``reach``."""
    if float(count) > reach:
        return int(wp.floor(reach)) + 1
    return count


@wp.func
def walk_line(
    view: EllipsoidView,
    axis: int,
    line: int,
    side: int,  # -1: the outline's low end on this line, 1: its high end
    crossing: float,
    alone: bool,  # no other ellipsoid shows the label
    edge_nearness: float,
    max_distance: float,
    gradient: Any,
):
    """Slope of the loss when the outline moves along one line where it crosses it."""
    label = view.own.label
    count = wp.where(axis == 0, view.width, view.height)
    # First pixel centres strictly outside and at or inside the crossing, clamped in float against overflow.
    place = wp.clamp(crossing, -1.0, float(count) + 1.0)
    inside = int(wp.floor(place - 0.5))
    outside = inside + 1
    if side < 0:
        inside = int(wp.ceil(place - 0.5))
        outside = inside - 1
    slope = float(0.0)
    # Pixels of the line follow one another in memory by ``pitch``.
    begin = wp.where(axis == 0, line * view.width, line)
    pitch = wp.where(axis == 0, 1, view.width)
    if outside >= 0 and outside < count:
        # An outline inside its own label's picture bounds nothing.
        part = int(view.parts[begin + outside * pitch])
        if shows_label(view, part, alone):
            return slope
    far = -float(side) * wp.inf  # beyond which no pixel shows the label
    if alone:
        # One pixel more, since rounding decides what the outline covers.
        across = float(line) + 0.5
        far = outline_end(view.own, across, across, axis, -float(side)) - float(side)
    pixels = pixels_of(gradient, view.target, label)
    missing = wrong_on_line(extent(gradient, view.b, MISSING, label), axis, line, count)
    last = wp.where(side > 0, missing[1], missing[0])
    pixel = int(wp.where(side > 0, wp.max(outside, 0), wp.min(outside, count - 1)))
    distance = wp.abs(float(pixel) + 0.5 - crossing)
    left = pixels_within(max_distance - distance, (last - pixel) * side + 1)
    done = int(0)
    while done < left:
        shown = wp.vec4i()
        values = wp.vec4()
        for i in range(AT_ONCE):
            if i < at_once():
                at = begin + (pixel + wp.min(done + i, left - 1) * side) * pitch
                shown[i] = int(view.parts[at])
                values[i] = pixel_gradient(pixels, at, label, False)
        for i in range(AT_ONCE):
            if i < at_once() and done + i < left and shows_label(view, shown[i], alone):
                left = done + i
            if i < at_once() and done + i < left and values[i] != 0.0:
                switches = shown[i] == 0
                if not switches:
                    place = float(pixel + (done + i) * side) + 0.5
                    x = wp.where(axis == 0, place, float(line) + 0.5)
                    y = wp.where(axis == 0, float(line) + 0.5, place)
                    switches = front_at(view.silhouettes[shown[i] - 1], x, y) < edge_nearness
                if switches:
                    slope += values[i] / wp.max(distance + float(done + i), 1.0)
        done += at_once()
    surplus = wrong_on_line(extent(gradient, view.b, SURPLUS, label), axis, line, count)
    last = wp.where(side > 0, surplus[0], surplus[1])
    pixel = int(wp.where(side > 0, wp.min(inside, count - 1), wp.max(inside, 0)))
    distance = wp.abs(float(pixel) + 0.5 - crossing)
    reach = wp.min(max_distance - distance, float(side) * (float(pixel) + 0.5 - far))
    left = pixels_within(reach, (pixel - last) * side + 1)
    done = int(0)
    while done < left:
        shown = wp.vec4i()
        values = wp.vec4()
        for i in range(AT_ONCE):
            if i < at_once():
                at = begin + (pixel - wp.min(done + i, left - 1) * side) * pitch
                shown[i] = int(view.parts[at])
                values[i] = pixel_gradient(pixels, at, label, True)
        for i in range(AT_ONCE):
            if i < at_once() and done + i < left and shown[i] == 0:
                left = done + i
            if i < at_once() and done + i < left and shows_label(view, shown[i], alone):
                slope += values[i] / wp.max(distance + float(done + i), 1.0)
        done += at_once()
    return float(side) * slope


@wp.func
def is_alone(view: EllipsoidView):
    """True if no other ellipsoid of the body shows the same label."""
    others = bool(False)
    for j in range(view.lane, view.silhouettes.shape[0], view.scene.lanes):
        if j != view.k and view.silhouettes[j].label == view.own.label:
            others = True
    return ballot(others) == wp.uint32(0)


@wp.func
def wrong_box(view: EllipsoidView, gradient: Any):
    """First and last column, first and last row of the outline's pixel box in which its label is wrong anywhere."""
    left, right, top, bottom = pixel_box(view.own, view.height, view.width)
    wrong = all_wrong(gradient, view.b, view.own.label)
    return wp.max(left, wrong[2]), wp.min(right, wrong[3]), wp.max(top, wrong[0]), wp.min(bottom, wrong[1])


@wp.func
def walk_lines(sums: SurfaceForces, view: EllipsoidView, most: int, max_distance: float, gradient: Any):
    """Forces in x and y: from rows and columns that meet the outline, two ends each."""
    s = view.own
    left, right, top, bottom = wrong_box(view, gradient)
    rows = wp.max(bottom - top + 1, 0)
    columns = wp.max(right - left + 1, 0)
    alone = is_alone(view)
    ends = 2 * (rows + columns)
    share = take_share(view, 0, most, ends, _WEIGHT)
    n = wp.where(share.count > 0 and view.lane < share.turn, share.number * share.turn + view.lane, ends)
    while n < ends:
        side = 2 * (n % 2) - 1
        axis = 0
        line = top + n // 2
        if n >= 2 * rows:
            axis = 1
            line = left + (n - 2 * rows) // 2
        across = float(line) + 0.5
        if line_root(s, across, across, axis) > 0.0:
            crossing = outline_end(s, across, across, axis, float(side))
            x = wp.where(axis == 0, crossing, across)
            y = wp.where(axis == 0, across, crossing)
            nearness = middle_at(s, x, y)
            slope = walk_line(view, axis, line, side, crossing, alone, nearness, max_distance, gradient)
            if slope != 0.0:
                e = load_ellipsoid(view)
                unit = to_unit(e, unproject(e, x, y, nearness))
                push = wp.vec2(wp.where(axis == 0, slope, 0.0), wp.where(axis == 0, 0.0, slope))
                sums = add_image_force(sums, e, unit, push)
        n += share.count * share.turn
    return sums


@wp.func
def push_depth(sums: SurfaceForces, e: Ellipsoid, x: float, y: float, nearness: float, amount: float):
    """Add a force along z on the surface point at (x, y)."""
    unit = to_unit(e, unproject(e, x, y, nearness))
    return add_force(sums, wp.vec3(0.0, 0.0, amount), unit)


@wp.func
def is_nearest_of_label(silhouettes: wp.array[Silhouette], k: int, nearness: float, x: float, y: float):
    """True if no other ellipsoid of k's label is nearer there; of equal ones the lower index is."""
    label = silhouettes[k].label
    for j in range(silhouettes.shape[0]):
        if j != k and silhouettes[j].label == label and in_box(silhouettes[j], x, y):
            if inside_at(silhouettes[j], x, y) > 0.0:
                there = front_at(silhouettes[j], x, y)
                if there > nearness or (there == nearness and j < k):
                    return False
    return True


@wp.func
def depth_between(front: float, back: float, perspective: bool):
    """Distance in depth of two nearnesses [m], never 0."""
    return wp.max(depth_of(back, perspective) - depth_of(front, perspective), MIN_DELTA_Z)


@wp.func
def may_push_depths(g: LabelTarget, own: wp.uint32, shown: wp.uint32, expected: wp.uint32, label: int):
    """Highest bit of each of four pixels where a depth may matter: the ellipsoid hides the target, or is it and hidden.

    ``own`` are the bits of pixels that show the ellipsoid, ``shown`` the parts that pixels show.
    """
    wanted = unequal_bytes(expected, wp.uint32(label) * EACH_BYTE)
    some = unequal_bytes(expected, wp.uint32(0)) & unequal_bytes(expected, IGNORED)
    return (own & wanted & some) | (~own & ~wanted & unequal_bytes(shown, wp.uint32(0)))


@wp.func
def may_push_depths(g: DenseGradient, own: wp.uint32, shown: wp.uint32, expected: wp.uint32, label: int):
    """Highest bit of each of four pixels that show a part."""
    return unequal_bytes(shown, wp.uint32(0))


@wp.func
def push_behind(
    sums: SurfaceForces, view: EllipsoidView, e: Ellipsoid, row: int, column: int, depth_weight: float, gradient: Any
):
    """Force back where the ellipsoid, which shows at a pixel, hides another that should."""
    s = view.own
    silhouettes = view.silhouettes
    at = row * view.width + column
    x = float(column) + 0.5
    y = float(row) + 0.5
    front = front_at(s, x, y)
    for word in range((silhouettes.shape[0] + 31) // 32):
        # First find the hidden ones: for each thread they are others, but few, so that all push together.
        hidden = wp.uint32(0)
        for bit in range(wp.min(32, silhouettes.shape[0] - 32 * word)):
            j = 32 * word + bit
            other = silhouettes[j].label
            if (
                other != s.label
                and may_have_gradient(gradient, view.target, other, at)
                and in_box(silhouettes[j], x, y)
            ):
                if inside_at(silhouettes[j], x, y) > 0.0:
                    hidden |= wp.uint32(1) << wp.uint32(bit)
        while hidden != wp.uint32(0):
            j = 32 * word + lowest_bit(hidden)
            hidden &= hidden - wp.uint32(1)
            g = hidden_gradient(gradient, view.target, silhouettes[j].label, at)
            back = front_at(silhouettes[j], x, y)
            if g != 0.0 and is_nearest_of_label(silhouettes, j, back, x, y):
                between = depth_between(front, back, e.perspective)
                amount = depth_weight * g * wp.log(1.0 / between + 1.0)
                sums = push_depth(sums, e, x, y, front, amount)
    return sums


@wp.func
def pull_forward(
    sums: SurfaceForces, view: EllipsoidView, e: Ellipsoid, row: int, column: int, depth_weight: float, gradient: Any
):
    """Force forward where the ellipsoid is hidden at a pixel that another shows."""
    s = view.own
    at = row * view.width + column
    front = view.silhouettes[int(view.parts[at]) - 1]
    x = float(column) + 0.5
    y = float(row) + 0.5
    if front.label != s.label and inside_at(s, x, y) > 0.0:
        g = hidden_gradient(gradient, view.target, s.label, at)
        if g != 0.0:
            back = front_at(s, x, y)
            if is_nearest_of_label(view.silhouettes, view.k, back, x, y):
                between = depth_between(front_at(front, x, y), back, e.perspective)
                amount = -depth_weight * g * wp.log(1.0 / between + 1.0)
                sums = push_depth(sums, e, x, y, back, amount)
    return sums


@wp.func
def walk_depths(sums: SurfaceForces, view: EllipsoidView, most: int, depth_weight: float, gradient: Any):
    """Forces in z: where the target's label is hidden, its ellipsoid comes forward, the one that hides it goes back."""
    left, right, top, bottom = pixel_box(view.own, view.height, view.width)
    if has_extent(gradient, view.own.label):
        left, right, top, bottom = wrong_box(view, gradient)
    image = view.scene.parts[view.b]
    in_words = are_words(view.scene.parts)
    four = wp.uint32(view.k + 1) * EACH_BYTE
    first_quad = left // QUAD
    across = wp.max(right // QUAD - first_quad + 1, 0)
    squares = across * wp.max((bottom - top) // QUAD + 1, 0)
    lanes = view.scene.lanes
    share = take_share(view, view.shares - most, most, squares, _WEIGHT)
    if share.count == 0:
        return sums
    # Each thread looks at 4 by 4 pixels, then all share those that matter.
    for turn in range(share.number, (squares + share.turn - 1) // share.turn, share.count):
        square = turn * share.turn + view.lane
        pixels = wp.uint32(0)
        if view.lane < share.turn and square < squares:
            row = top + QUAD * (square // across)
            column = QUAD * (first_quad + square % across)
            shown = load_block(image, row, column, in_words)
            expected = expected_block(gradient, view.target, row, column)
            for i in range(QUAD):
                own = unequal_bytes(shown[i], four) ^ HIGH_BITS
                pixels |= may_push_depths(gradient, own, shown[i], expected[i], view.own.label) >> wp.uint32(i)
        found = prefix_sum(wp.bit_count(pixels))
        total = int(shuffle(wp.uint32(found), lanes - 1))
        for first in range(0, total, lanes):
            number = first + view.lane
            mine = deal(pixels, found, square, number, lanes)
            if number < total:
                row = top + QUAD * (mine[0] // across) + 7 - mine[1] % 8
                column = QUAD * (first_quad + mine[0] % across) + mine[1] // 8
                e = load_ellipsoid(view)
                if int(view.parts[row * view.width + column]) == view.k + 1:
                    sums = push_behind(sums, view, e, row, column, depth_weight, gradient)
                else:
                    sums = pull_forward(sums, view, e, row, column, depth_weight, gradient)
    return sums


@wp.kernel(launch_bounds=(BLOCK, 8))  # 128 registers
def partdr_forces(
    scene: SceneArrays,
    max_distance: float,  # [px]
    depth_weight: float,
    gradient: Any,
    forces: wp.array4d[float],  # as ``spread_forces`` reads them  OUTPUT
):
    """Sums over the forces on each ellipsoid."""
    sums = SurfaceForces()
    view = make_view(scene, forces, gradient, wp.tid())
    if view.own.low[0] <= view.own.high[0]:
        if has_extent(gradient, view.own.label):
            sums = walk_lines(sums, view, wp.max(view.shares // 2, 1), max_distance, gradient)
        if depth_weight != 0.0:
            sums = walk_depths(sums, view, (view.shares + 1) // 2, depth_weight, gradient)
    store_forces(forces, view, sums)


overload_gradients(partdr_forces)
