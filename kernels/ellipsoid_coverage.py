"""The true derivative of the area that each ellipsoid's label covers, weighed by what a pixel's area costs.

The loss is the integral of cost(label(x), pixel of x) over the picture. It changes where the labels' borders move, by
(cost inside - cost outside) times the way along the normal. Borders are of two kinds: outlines, which one ellipsoid
owns and which are walked in steps of a share of a pixel, and creases, where two ellipsoids that meet in space are
equally near; those are looked for on lines a share of a pixel apart, wherever neighbouring pixels differ. One block of
threads owns an ellipsoid and adds in a fixed order.
"""

from collections.abc import Sequence
from typing import Any

import warp as wp

from .ellipsoids import Seen, Silhouette, lowest_bit, middle_at, room_at
from .surface_forces import (
    Ellipsoid,
    Scene,
    SurfaceForces,
    add_image_force,
    add_nearness_force,
    from_unit,
    load_ellipsoid,
    make_scene,
    rests,
)
from .targets import DenseGradient, LabelTarget, cost_at, flat, target_of

wp.set_module_options({"enable_backward": False, "fast_math": True})

BLOCK = 128  # threads that share one ellipsoid on CUDA; four such blocks at once leave each thread 128 registers
_ROOT_STEPS = wp.constant(4)  # of false position within a piece of a line
_MAX_STEPS = wp.constant(float(2**22))  # of an outline: with more, float32 would hardly tell their angles apart
_TINY = wp.constant(1.0e-20)


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


@wp.func
def nearness_slope(s: Silhouette, x: float, y: float):
    """Gradient in the picture of the front surface's nearness."""
    dx = x - s.mean[0]
    dy = y - s.mean[1]
    root = wp.sqrt(wp.max(room_at(s, x, y), _TINY))
    return s.slope - wp.vec2(s.conic[0] * dx + s.conic[1] * dy, s.conic[1] * dx + s.conic[2] * dy) / root


@wp.func
def lead(one: Silhouette, other: Silhouette, x: float, y: float):
    """How much nearer one front surface is than another."""
    root = wp.sqrt(wp.max(room_at(one, x, y), 0.0)) - wp.sqrt(wp.max(room_at(other, x, y), 0.0))
    return middle_at(one, x, y) - middle_at(other, x, y) + root


@wp.func
def outline_end(s: Silhouette, x: float, y: float, axis: int, side: float):
    """Where the line through (x, y) along an axis leaves (side 1) or enters (side -1) the outline."""
    across = wp.where(axis == 0, y - s.mean[1], x - s.mean[0])
    along = wp.where(axis == 0, s.conic[0], s.conic[2])
    lean = s.conic[1] * across
    root = lean * lean + along * (s.room - wp.where(axis == 0, s.conic[2], s.conic[0]) * across * across)
    return wp.where(axis == 0, s.mean[0], s.mean[1]) + (side * wp.sqrt(wp.max(root, 0.0)) - lean) / along


@wp.struct
class OutlinePoint:
    """One point of an outline, and what the loss says about the border there."""

    unit: wp.vec3
    image: wp.vec2  # [px]
    excess: float  # cost of area inside minus cost of area outside, 0 where the outline is no border of labels


@wp.func
def look_at_outline(
    e: Ellipsoid,
    s: Silhouette,
    silhouettes: wp.array[Silhouette],
    neighbours: wp.array[wp.uint32],
    circle: Circle,
    t: int,
    angle: float,
    perspective: bool,
    gradient: Any,
    height: int,
    width: int,
):
    """An outline is a border where nothing hides it and another label, or none, lies behind."""
    found = OutlinePoint()
    found.unit = circle.offset + wp.cos(angle) * circle.first + wp.sin(angle) * circle.second
    point = e.centre + from_unit(e, found.unit)
    if perspective:
        point = point / point[2]
    x = e.camera[0] * point[0] + e.camera[2]
    y = e.camera[1] * point[1] + e.camera[3]
    found.image = wp.vec2(x, y)
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
        row = int(y)
        column = int(x)
        found.excess = cost_at(gradient, t, s.label, row, column) - cost_at(gradient, t, label, row, column)
    return found


@wp.func
def push_outline(
    sums: SurfaceForces,
    e: Ellipsoid,
    s: Silhouette,
    start: OutlinePoint,
    end: OutlinePoint,
    excess: float,
    perspective: bool,
):
    """Force of a bit of outline: cost times the outward normal times length, which is its chord turned by a quarter."""
    normal = wp.vec2(end.image[1] - start.image[1], start.image[0] - end.image[0])
    middle = 0.5 * (start.image + end.image) - s.mean
    if wp.dot(normal, middle) < 0.0:
        normal = -normal
    unit = 0.5 * (start.unit + end.unit)
    return add_image_force(sums, e, unit, excess * normal[0], excess * normal[1], perspective)


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
    start = look_at_outline(
        e, s, silhouettes, neighbours, circle, t, float(n) * step, perspective, gradient, height, width
    )
    for i in range(each):
        low = float(n + i) * step
        high = low + step
        end = look_at_outline(e, s, silhouettes, neighbours, circle, t, high, perspective, gradient, height, width)
        if start.excess == end.excess or halvings == 0:
            if start.excess != 0.0 or end.excess != 0.0:
                sums = push_outline(sums, e, s, start, end, 0.5 * (start.excess + end.excess), perspective)
        else:
            # The cost changes in between: find where.
            middle = OutlinePoint()
            for _ in range(halvings):
                angle = 0.5 * (low + high)
                middle = look_at_outline(
                    e, s, silhouettes, neighbours, circle, t, angle, perspective, gradient, height, width
                )
                if middle.excess == start.excess:
                    low = angle
                else:
                    high = angle
            if start.excess != 0.0:
                sums = push_outline(sums, e, s, start, middle, start.excess, perspective)
            if end.excess != 0.0:
                sums = push_outline(sums, e, s, middle, end, end.excess, perspective)
        start = end
    return sums


@wp.func
def hidden(
    silhouettes: wp.array[Silhouette], neighbours: wp.array[wp.uint32], j: int, x: float, y: float, nearness: float
):
    """Whether a neighbour other than ellipsoid j is nearer at (x, y)."""
    for word in range(neighbours.shape[0]):
        bits = neighbours[word]
        while bits != wp.uint32(0):
            i = 32 * word + lowest_bit(bits)
            bits &= bits - wp.uint32(1)
            if i != j:
                other = silhouettes[i]
                room = room_at(other, x, y)
                if room > 0.0 and middle_at(other, x, y) + wp.sqrt(room) > nearness:
                    return True
    return False


@wp.func
def push_crease(
    sums: SurfaceForces,
    scene: Scene,
    b: int,
    k: int,
    s: Silhouette,
    silhouettes: wp.array[Silhouette],
    neighbours: wp.array[wp.uint32],
    t: int,
    j: int,
    axis: int,
    x: float,
    y: float,
    lines: int,
    gradient: Any,
    height: int,
    width: int,
):
    """Force on an ellipsoid at (x, y), where on one of ``lines`` lines a pixel its front and that of j cross."""
    other = silhouettes[j]
    row = wp.min(int(y), height - 1)
    column = wp.min(int(x), width - 1)
    excess = cost_at(gradient, t, s.label, row, column) - cost_at(gradient, t, other.label, row, column)
    nearness = middle_at(s, x, y) + wp.sqrt(wp.max(room_at(s, x, y), 0.0))
    if excess == 0.0 or hidden(silhouettes, neighbours, j, x, y, nearness):
        return sums
    slope = nearness_slope(s, x, y)
    away = slope - nearness_slope(other, x, y)
    # A row and a column that cross a border at one place share it by the squares of its normal, so that each bit counts
    # once.
    across = wp.abs(wp.where(axis == 0, away[0], away[1]))
    length2 = wp.dot(away, away)
    if across * across < 1.0e-6 * length2 or length2 == 0.0:
        return sums
    amount = excess * across / (float(lines) * length2)
    # Loaded where it is used: crossings are few, and it would take registers all the way.
    e = load_ellipsoid(scene, b, k)
    return add_nearness_force(sums, e, x, y, nearness, slope, amount, scene.perspective)


@wp.func
def walk_line(
    sums: SurfaceForces,
    scene: Scene,
    b: int,
    k: int,
    silhouettes: wp.array[Silhouette],
    neighbours: wp.array[wp.uint32],
    t: int,
    j: int,
    axis: int,
    x: float,
    y: float,
    lines: int,
    gradient: Any,
    height: int,
    width: int,
):
    """Forces of the creases with ellipsoid j on the pixel's length ahead of (x, y) along an axis."""
    s = silhouettes[k]
    other = silhouettes[j]
    along_x = wp.where(axis == 0, 1.0, 0.0)
    along_y = 1.0 - along_x
    # Both are there, and in the picture, from ``begin`` to ``end``.
    start = wp.where(axis == 0, x, y)
    begin = wp.max(outline_end(s, x, y, axis, -1.0), outline_end(other, x, y, axis, -1.0))
    end = wp.min(outline_end(s, x, y, axis, 1.0), outline_end(other, x, y, axis, 1.0))
    begin = wp.max(wp.max(begin, 0.0) - start, 0.0)
    end = wp.min(wp.min(end, float(wp.where(axis == 0, width, height))) - start, 1.0)
    aside = wp.where(axis == 0, y, x)
    if begin >= end or aside < 0.0 or aside >= float(wp.where(axis == 0, height, width)):
        return sums
    # Two fronts can cross twice within a pixel, so as many pieces as lines are looked at one by one.
    step = (end - begin) / float(lines)
    next_lead = lead(s, other, x + along_x * begin, y + along_y * begin)
    for piece in range(lines):
        low = begin + float(piece) * step
        high = low + step
        low_lead = next_lead
        high_lead = lead(s, other, x + along_x * high, y + along_y * high)
        next_lead = high_lead
        if low_lead * high_lead < 0.0:
            place = low
            for _ in range(_ROOT_STEPS):
                place = low + (high - low) * low_lead / (low_lead - high_lead)
                here = lead(s, other, x + along_x * place, y + along_y * place)
                if here * low_lead > 0.0:
                    low = place
                    low_lead = here
                    high_lead *= 0.5  # Illinois: or one end would stay where it is
                else:
                    high = place
                    high_lead = here
                    low_lead *= 0.5
            sums = push_crease(
                sums,
                scene,
                b,
                k,
                s,
                silhouettes,
                neighbours,
                t,
                j,
                axis,
                x + along_x * place,
                y + along_y * place,
                lines,
                gradient,
                height,
                width,
            )
    return sums


@wp.func
def is_mixed(parts: wp.array[wp.uint8], row: int, column: int, height: int, width: int):
    """Whether the pixels around a cell, from the centre of (row, column) to the next, differ or are not all there."""
    if row < 0 or column < 0 or row + 1 >= height or column + 1 >= width:
        return True
    upper = row * width + column
    lower = upper + width
    first = parts[upper]
    return first != parts[upper + 1] or first != parts[lower] or first != parts[lower + 1]


@wp.func
def walk_creases(
    sums: SurfaceForces,
    scene: Scene,
    b: int,
    k: int,
    silhouettes: wp.array[Silhouette],
    neighbours: wp.array[wp.uint32],
    creases: wp.array[wp.uint32],
    parts: wp.array[wp.uint8],
    height: int,
    width: int,
    t: int,
    lane: int,
    lanes: int,
    lines: int,
    gradient: Any,
):
    """Forces of the creases between an ellipsoid and those that it meets in space, on ``lines`` lines a pixel."""
    for word in range(creases.shape[0]):
        bits = creases[word]
        # Cells between pixel centres are dealt to the threads as one line over all boxes. Each thread looks for its
        # next mixed cell, then all threads work on one each: looking is quick, working is not.
        n = int(lane)
        begin = int(0)
        end = int(0)
        left = int(0)
        top = int(0)
        columns = int(1)
        row = int(0)
        column = int(0)
        j = int(-1)
        searching = bool(True)
        while searching:
            found = bool(False)
            while searching and not found:
                while n >= end and bits != wp.uint32(0):
                    j = 32 * word + lowest_bit(bits)
                    bits &= bits - wp.uint32(1)
                    low = wp.max(silhouettes[k].low, silhouettes[j].low)
                    high = wp.min(silhouettes[k].high, silhouettes[j].high)
                    # Cells that hold a place where both are, clamped in float against overflow. The first begins half
                    # a pixel before the picture.
                    left = int(wp.floor(wp.clamp(low[0] - 0.5, -1.0, float(width))))
                    right = int(wp.floor(wp.clamp(high[0] - 0.5, -2.0, float(width - 1))))
                    top = int(wp.floor(wp.clamp(low[1] - 0.5, -1.0, float(height))))
                    bottom = int(wp.floor(wp.clamp(high[1] - 0.5, -2.0, float(height - 1))))
                    columns = right - left + 1
                    begin = end
                    end = begin + wp.max(columns, 0) * wp.max(bottom - top + 1, 0)
                searching = n < end
                if searching:
                    row = top + (n - begin) // columns
                    column = left + (n - begin) % columns
                    n += lanes
                    found = is_mixed(parts, row, column, height, width)
            if found:
                for i in range(2 * lines):
                    # Each line halves a strip, and whole strips fill a pixel: one cost holds for all of a strip.
                    off = (float(lines // 2 + i // 2) + 0.5) / float(lines)
                    axis = i % 2
                    sums = walk_line(
                        sums,
                        scene,
                        b,
                        k,
                        silhouettes,
                        neighbours,
                        t,
                        j,
                        axis,
                        float(column) + wp.where(axis == 0, 0.5, off),
                        float(row) + wp.where(axis == 0, off, 0.5),
                        lines,
                        gradient,
                        height,
                        width,
                    )
    return sums


@wp.func
def coverage_on(
    scene: Scene, b: int, k: int, lane: int, lanes: int, steps_per_pixel: float, halvings: int, gradient: Any
):
    """The share of one of ``lanes`` threads in the forces on ellipsoid k."""
    sums = SurfaceForces()
    # Views of one body: an index of one dimension costs a fraction of one of three.
    silhouettes = scene.silhouettes[b]
    s = silhouettes[k]
    height = scene.parts.shape[1]
    width = scene.parts.shape[2]
    if rests(scene.active, b):
        return sums
    if s.low[0] < float(width) and s.low[1] < float(height) and s.high[0] > 0.0 and s.high[1] > 0.0:
        e = load_ellipsoid(scene, b, k)
        t = target_of(gradient, b)
        sums = walk_outline(
            sums,
            e,
            s,
            silhouettes,
            scene.neighbours[b, k],
            t,
            lane,
            lanes,
            steps_per_pixel,
            halvings,
            scene.perspective,
            gradient,
            height,
            width,
        )
        sums = walk_creases(
            sums,
            scene,
            b,
            k,
            silhouettes,
            scene.neighbours[b, k],
            scene.creases[b, k],
            flat(scene.parts[b]),
            height,
            width,
            t,
            lane,
            lanes,
            int(wp.ceil(steps_per_pixel)),
            gradient,
        )
    return sums


# On CUDA a block of threads shares an ellipsoid. The CPU device has a kernel of its own: a tile there, even one in a
# branch not taken, is memory that all threads of the process share.
@wp.kernel(launch_bounds=(BLOCK, 4))
def coverage_shared(
    scene: Scene,
    steps_per_pixel: float,
    halvings: int,
    gradient: Any,
    force: wp.array2d[wp.vec3],  # (B, P)  OUTPUT
    moment: wp.array2d[wp.mat33],  # (B, P)  OUTPUT
    camera_force: wp.array2d[wp.vec4],  # (B, P)  OUTPUT
):
    """Sums over the forces on each ellipsoid."""
    b, k, lane = wp.tid()
    sums = coverage_on(scene, b, k, lane, wp.block_dim(), steps_per_pixel, halvings, gradient)
    total_force = wp.tile_sum(wp.tile(wp.vec3(sums.force), preserve_type=True))
    total_moment = wp.tile_sum(wp.tile(wp.mat33(sums.moment), preserve_type=True))
    total_camera = wp.tile_sum(wp.tile(wp.vec4(sums.camera), preserve_type=True))
    if lane == 0:
        force[b, k] = total_force[0]
        moment[b, k] = total_moment[0]
        camera_force[b, k] = total_camera[0]


@wp.kernel
def coverage_alone(
    scene: Scene,
    steps_per_pixel: float,
    halvings: int,
    gradient: Any,
    force: wp.array2d[wp.vec3],
    moment: wp.array2d[wp.mat33],
    camera_force: wp.array2d[wp.vec4],
):
    """The same with one thread an ellipsoid."""
    b, k = wp.tid()
    sums = coverage_on(scene, b, k, 0, 1, steps_per_pixel, halvings, gradient)
    force[b, k] = sums.force
    moment[b, k] = sums.moment
    camera_force[b, k] = sums.camera


for _gradient in (LabelTarget, DenseGradient):
    wp.overload(coverage_shared, {"gradient": _gradient})
    wp.overload(coverage_alone, {"gradient": _gradient})


def launch_coverage_forces(
    ellipsoids: Sequence[wp.array],  # centres, axes, semi-axes, camera
    seen: Seen,
    parts: wp.array,
    *,
    perspective: bool,
    steps_per_pixel: float,
    halvings: int,
    gradient: Any,  # LabelTarget or DenseGradient
    force: wp.array,
    moment: wp.array,
    camera_force: wp.array,
    active: wp.array | None = None,
) -> None:
    """Fill the sums of forces on every ellipsoid; those of bodies that are not active come out 0."""
    inputs = [
        make_scene(ellipsoids, seen, parts, perspective=perspective, active=active),
        steps_per_pixel,
        halvings,
        gradient,
    ]
    outputs = [force, moment, camera_force]
    shape, device = seen.silhouettes.shape, parts.device
    if device.is_cpu:
        wp.launch(coverage_alone, shape, inputs, outputs, device=device)
    else:
        wp.launch(coverage_shared, (*shape, BLOCK), inputs, outputs, device=device, block_dim=BLOCK)
