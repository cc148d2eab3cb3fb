"""Creases as borders of labels: where two ellipsoids that meet in space are equally near.

They are looked for in cells of a share of a pixel: where the two fronts cross on a cell's sides, a crease enters and
leaves, or it ends in the cell, at an outline. Between such places it is taken as straight.
"""

from typing import Any

import warp as wp

from .ellipsoid_borders import chord_shares, lead, room_slope, root_at, slope_at
from .ellipsoids import Silhouette, lowest_bit, middle_at, room_at
from .surface_forces import Ellipsoid, Scene, SurfaceForces, add_nearness_force, load_ellipsoid

wp.set_module_options({"enable_backward": False})

_ROOT_STEPS = wp.constant(4)  # of false position on a cell's side
_NEWTON_STEPS = wp.constant(4)  # towards a crease's end
_NOWHERE = wp.constant(1.0e30)  # the lead where one of the two is not there
_RIM = wp.constant(1.0e-3)  # the smallest root, as a share of the largest, that a slope is taken at


@wp.func
def span(s: Silhouette, start: wp.vec2, way: wp.vec2):
    """Between which shares of the way from a place an ellipsoid is there; the first is larger if it is nowhere."""
    x = start[0] - s.mean[0]
    y = start[1] - s.mean[1]
    a = (s.conic[0] * way[0] + 2.0 * s.conic[1] * way[1]) * way[0] + s.conic[2] * way[1] * way[1]
    b = (s.conic[0] * x + s.conic[1] * y) * way[0] + (s.conic[1] * x + s.conic[2] * y) * way[1]
    square = b * b + a * room_at(s, start[0], start[1])
    if square <= 0.0 or a <= 0.0:
        return wp.vec2(1.0, 0.0)
    root = wp.sqrt(square)
    return wp.vec2((-b - root) / a, (root - b) / a)


@wp.func
def is_hidden(
    s: Silhouette, silhouettes: wp.array[Silhouette], neighbours: wp.array[wp.uint32], j: int, place: wp.vec2
):
    """Whether a neighbour other than ellipsoid j is nearer than an ellipsoid's front."""
    x = place[0]
    y = place[1]
    nearness = middle_at(s, x, y) + root_at(s, x, y)
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
    e: Ellipsoid,
    s: Silhouette,
    other: Silhouette,
    place: wp.vec2,
    cost: float,
    perspective: bool,
):
    """Force of a crease on an ellipsoid at a place: what a way of the crease across itself costs, times that way."""
    x = place[0]
    y = place[1]
    middle = middle_at(s, x, y)
    other_middle = middle_at(other, x, y)
    root = root_at(s, x, y)
    other_root = root_at(other, x, y)
    # A root is steep where it is small. Both fronts are equally near, so the larger one tells the smaller.
    if root * root * other.room < other_root * other_root * s.room:
        root = other_middle + other_root - middle
    else:
        other_root = middle + root - other_middle
    # At the outline itself slopes are infinite and forces are not.
    root = wp.max(root, _RIM * wp.sqrt(s.room))
    other_root = wp.max(other_root, _RIM * wp.sqrt(other.room))
    slope = slope_at(s, x, y, root)
    steepness = wp.length(slope - slope_at(other, x, y, other_root))
    if steepness > 0.0:
        sums = add_nearness_force(sums, e, x, y, middle + root, slope, cost / steepness, perspective)
    return sums


@wp.func
def push_chord(
    sums: SurfaceForces,
    scene: Scene,
    b: int,
    k: int,
    silhouettes: wp.array[Silhouette],
    neighbours: wp.array[wp.uint32],
    j: int,
    first: wp.vec2,
    second: wp.vec2,
    halvings: int,
    t: int,
    gradient: Any,
    height: int,
    width: int,
):
    """Forces of the bit of crease with ellipsoid j between two places, as far as nothing hides it."""
    s = silhouettes[k]
    other = silhouettes[j]
    start = first
    end = second
    start_hidden = is_hidden(s, silhouettes, neighbours, j, start)
    end_hidden = is_hidden(s, silhouettes, neighbours, j, end)
    if start_hidden and end_hidden:
        return sums
    if start_hidden != end_hidden:
        low = start
        high = end
        for _ in range(halvings):
            middle = 0.5 * (low + high)
            if is_hidden(s, silhouettes, neighbours, j, middle) == start_hidden:
                low = middle
            else:
                high = middle
        if start_hidden:
            start = 0.5 * (low + high)
        else:
            end = 0.5 * (low + high)
    shares = chord_shares(start, end, s.label, other.label, t, gradient, height, width)
    if shares[0] != 0.0 or shares[1] != 0.0:
        # Loaded where it is used: creases are few, and it would take registers all the way.
        e = load_ellipsoid(scene, b, k)
        shares *= wp.length(end - start)
        for side in range(2):
            place = start + float(side) * (end - start)
            sums = push_crease(sums, e, s, other, place, shares[side], scene.perspective)
    return sums


@wp.func
def lead_if_there(one: Silhouette, other: Silhouette, place: wp.vec2):
    """How much nearer one front surface is than another; _NOWHERE unless both are there."""
    if room_at(one, place[0], place[1]) <= 0.0 or room_at(other, place[0], place[1]) <= 0.0:
        return _NOWHERE
    return lead(one, other, place[0], place[1])


@wp.func
def lead_in_spans(
    one: Silhouette, other: Silhouette, start: wp.vec2, way: wp.vec2, mine: wp.vec2, others: wp.vec2, share: float
):
    """The lead at a share of a way. In float32 a root where a span ends would not come out as the 0 that it is."""
    x = start[0] + share * way[0]
    y = start[1] + share * way[1]
    root = wp.where(share == mine[0] or share == mine[1], 0.0, root_at(one, x, y))
    other_root = wp.where(share == others[0] or share == others[1], 0.0, root_at(other, x, y))
    return middle_at(one, x, y) - middle_at(other, x, y) + root - other_root


@wp.func
def crossing(s: Silhouette, other: Silhouette, start: wp.vec2, end: wp.vec2, start_lead: float, end_lead: float):
    """Which share of the way between two places leads to where two fronts cross; -1 if they do not, or twice."""
    way = end - start
    low = float(0.0)
    high = float(1.0)
    low_lead = start_lead
    high_lead = end_lead
    if start_lead == _NOWHERE or end_lead == _NOWHERE:
        mine = span(s, start, way)
        others = span(other, start, way)
        low = wp.max(wp.max(mine[0], others[0]), 0.0)
        high = wp.min(wp.min(mine[1], others[1]), 1.0)
        if low >= high:
            return -1.0
        low_lead = lead_in_spans(s, other, start, way, mine, others, low)
        high_lead = lead_in_spans(s, other, start, way, mine, others, high)
    if (low_lead < 0.0) == (high_lead < 0.0):
        return -1.0
    share = low
    for _ in range(_ROOT_STEPS):
        share = low + (high - low) * low_lead / (low_lead - high_lead)
        here = lead(s, other, start[0] + share * way[0], start[1] + share * way[1])
        if (here < 0.0) == (low_lead < 0.0):
            low = share
            low_lead = here
            high_lead *= 0.5  # Illinois: or one end would stay where it is
        else:
            high = share
            high_lead = here
            low_lead *= 0.5
    return share


@wp.func
def crease_end(s: Silhouette, other: Silhouette, place: wp.vec2):
    """Near a place, where the other's front meets the outline of the first: there creases pass into outlines.

    How much nearer the outline is than the other's middle comes third: where it is not, it meets the other's back.
    """
    for _ in range(_NEWTON_STEPS):
        x = place[0]
        y = place[1]
        # Both are 0 there, and smooth.
        room = room_at(s, x, y)
        over = middle_at(s, x, y) - middle_at(other, x, y)
        excess = room_at(other, x, y) - over * over
        inward = room_slope(s, x, y)
        along = room_slope(other, x, y) - 2.0 * over * (s.slope - other.slope)
        area = inward[0] * along[1] - inward[1] * along[0]
        if area != 0.0:
            place -= wp.vec2(room * along[1] - excess * inward[1], excess * inward[0] - room * along[0]) / area
    ahead = middle_at(s, place[0], place[1]) - middle_at(other, place[0], place[1])
    return wp.vec3(place[0], place[1], ahead)


@wp.func
def walk_cell(
    sums: SurfaceForces,
    scene: Scene,
    b: int,
    k: int,
    silhouettes: wp.array[Silhouette],
    neighbours: wp.array[wp.uint32],
    j: int,
    low: wp.vec2,
    high: wp.vec2,
    halvings: int,
    t: int,
    gradient: Any,
    height: int,
    width: int,
):
    """Forces of the creases with ellipsoid j in a cell of the picture, as chords between its sides."""
    s = silhouettes[k]
    other = silhouettes[j]
    pending = wp.vec2()
    odd = bool(False)
    end = low
    end_lead = lead_if_there(s, other, low)
    for side in range(5):
        place = wp.vec2()
        found = bool(False)
        if side < 4:
            start = end
            start_lead = end_lead
            end = wp.vec2(wp.where(side < 2, high[0], low[0]), wp.where(side == 1 or side == 2, high[1], low[1]))
            end_lead = lead_if_there(s, other, end)
            share = crossing(s, other, start, end, start_lead, end_lead)
            found = share >= 0.0
            place = start + share * (end - start)
        elif odd:
            # It ends in the cell, at an outline.
            nearest = wp.length(high - low)
            for which in range(2):
                one = silhouettes[wp.where(which == 0, k, j)]
                end_ahead = crease_end(one, silhouettes[wp.where(which == 0, j, k)], pending)
                there = wp.vec2(end_ahead[0], end_ahead[1])
                far = wp.length(there - pending)
                if end_ahead[2] >= 0.0 and far < nearest:
                    nearest = far
                    place = wp.max(wp.min(there, high), low)
                    found = True
        if found:
            if odd:
                sums = push_chord(
                    sums, scene, b, k, silhouettes, neighbours, j, pending, place, halvings, t, gradient, height, width
                )
            pending = place
            odd = not odd
    return sums


@wp.func
def room_range(s: Silhouette, x: float, y: float, half: wp.vec2):
    """Bounds of an ellipsoid's room in a cell around (x, y)."""
    room = room_at(s, x, y)
    slope = room_slope(s, x, y)
    tilt = wp.abs(slope[0]) * half[0] + wp.abs(slope[1]) * half[1]
    bend = (
        s.conic[0] * half[0] * half[0] + 2.0 * wp.abs(s.conic[1]) * half[0] * half[1] + s.conic[2] * half[1] * half[1]
    )
    return wp.vec2(room - tilt - bend, room + tilt)


@wp.func
def may_meet(s: Silhouette, other: Silhouette, low: wp.vec2, high: wp.vec2):
    """Whether two fronts can be equally near somewhere in a cell: bounds of each are."""
    middle = 0.5 * (low + high)
    half = 0.5 * (high - low)
    x = middle[0]
    y = middle[1]
    room = room_range(s, x, y, half)
    other_room = room_range(other, x, y, half)
    if room[1] <= 0.0 or other_room[1] <= 0.0:
        return False
    slope = s.slope - other.slope
    lead_of_middles = middle_at(s, x, y) - middle_at(other, x, y)
    spread = wp.abs(slope[0]) * half[0] + wp.abs(slope[1]) * half[1]
    return (
        lead_of_middles + spread + wp.sqrt(room[1]) - wp.sqrt(wp.max(other_room[0], 0.0)) >= 0.0
        and lead_of_middles - spread + wp.sqrt(wp.max(room[0], 0.0)) - wp.sqrt(other_room[1]) <= 0.0
    )


@wp.func
def is_border(parts: wp.array[wp.uint8], row: int, column: int, height: int, width: int, k: int, j: int):
    """Whether the pixels around a cell, from the centre of (row, column) to the next, differ and show k or j.

    Where not all are there, they may.
    """
    if row < 0 or column < 0 or row + 1 >= height or column + 1 >= width:
        return True
    first = int(parts[row * width + column])
    shown = bool(False)
    differ = bool(False)
    for i in range(4):
        part = int(parts[(row + i // 2) * width + column + i % 2])
        shown = shown or part == k + 1 or part == j + 1
        differ = differ or part != first
    return shown and differ


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
    cells: int,
    halvings: int,
    gradient: Any,
):
    """Forces of the creases between an ellipsoid and those that it meets in space, with ``cells``² cells a pixel."""
    size = 1.0 / float(cells)
    for word in range(creases.shape[0]):
        bits = creases[word]
        # Cells between pixel centres are dealt to the threads as one line over all boxes. Each thread looks for its
        # next cell with a crease, then all threads work on one each: looking is quick, working is not.
        n = int(lane)
        begin = int(0)
        end = int(0)
        left = int(0)
        top = int(0)
        columns = int(1)
        row = int(0)
        column = int(0)
        j = int(-1)
        corner = wp.vec2()
        searching = bool(True)
        while searching:
            found = bool(False)
            while searching and not found:
                while n >= end and bits != wp.uint32(0):
                    j = 32 * word + lowest_bit(bits)
                    bits &= bits - wp.uint32(1)
                    box_low = wp.max(silhouettes[k].low, silhouettes[j].low)
                    box_high = wp.min(silhouettes[k].high, silhouettes[j].high)
                    # Cells that hold a place where both are, clamped in float against overflow. The first begins half
                    # a pixel before the picture.
                    left = int(wp.floor(wp.clamp(box_low[0] - 0.5, -1.0, float(width))))
                    right = int(wp.floor(wp.clamp(box_high[0] - 0.5, -2.0, float(width - 1))))
                    top = int(wp.floor(wp.clamp(box_low[1] - 0.5, -1.0, float(height))))
                    bottom = int(wp.floor(wp.clamp(box_high[1] - 0.5, -2.0, float(height - 1))))
                    columns = right - left + 1
                    begin = end
                    end = begin + wp.max(columns, 0) * wp.max(bottom - top + 1, 0)
                searching = n < end
                if searching:
                    row = top + (n - begin) // columns
                    column = left + (n - begin) % columns
                    n += lanes
                    # Finer cells are for what is thinner than a pixel, too, and no pixel may show that.
                    found = cells > 1 or is_border(parts, row, column, height, width, k, j)
                    corner = wp.vec2(float(column) + 0.5, float(row) + 0.5)
                    if found:
                        found = may_meet(silhouettes[k], silhouettes[j], corner, corner + wp.vec2(1.0, 1.0))
            if found:
                for i in range(cells * cells):
                    low = corner + size * wp.vec2(float(i % cells), float(i // cells))
                    high = low + wp.vec2(size, size)
                    if cells == 1 or may_meet(silhouettes[k], silhouettes[j], low, high):
                        sums = walk_cell(
                            sums,
                            scene,
                            b,
                            k,
                            silhouettes,
                            neighbours,
                            j,
                            low,
                            high,
                            halvings,
                            t,
                            gradient,
                            height,
                            width,
                        )
    return sums
