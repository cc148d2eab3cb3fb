"""Forces of creases, the borders of labels where the fronts of two ellipsoids that meet in space are equally near.

They are searched in cells no larger than a pixel: a crease enters and leaves where the two fronts cross on a cell's
sides, or it ends in the cell, at an outline. Between such points it is taken as straight.
"""

from typing import Any

import warp as wp

from ..lanes import ballot, lowest_bit, nth_bit, shuffle, sum_lanes
from .borders import chord_shares, find_crossing, front_at, front_gap, radicand_at, radicand_slope, root_at, slope_at
from .forces import EllipsoidView, Sampling, Share
from .picture_forces import PictureForces, add_picture_force
from .silhouette import Silhouette, inside_at, middle_at, to_disc

_NEWTON_STEPS = wp.constant(4)  # towards a crease's end
_MANY_CELLS = wp.constant(float(2**30))
_NOWHERE = wp.constant(1.0e30)  # gap where one of the two ellipsoids does not cover the point
_RIM = wp.constant(1.0e-3)  # smallest ``root_at`` at which a slope is taken, as a share of ``bulge``


@wp.func
def span(s: Silhouette, start: wp.vec2, way: wp.vec2):
    """Interval of shares of ``way`` in which an ellipsoid covers the line; empty (first > second) if it misses it."""
    place = to_disc(s, start[0] - s.mean[0], start[1] - s.mean[1])
    move = to_disc(s, way[0], way[1])
    a = wp.dot(move, move)
    b = wp.dot(place, move)
    miss = place[0] * move[1] - place[1] * move[0]
    square = a - miss * miss
    if square <= 0.0 or a <= 0.0:
        return wp.vec2(1.0, 0.0)
    root = wp.sqrt(square)
    return wp.vec2((-b - root) / a, (root - b) / a)


@wp.func
def is_hidden(view: EllipsoidView, j: int, place: wp.vec2):
    """True if a neighbour other than ellipsoid j is nearer than the ellipsoid's front."""
    x, y = place[0], place[1]
    nearness = front_at(view.own, x, y)
    for word in range(view.neighbours.shape[0]):
        bits = view.neighbours[word]
        while bits != wp.uint32(0):
            i = 32 * word + lowest_bit(bits)
            bits &= bits - wp.uint32(1)
            if i != j:
                other = view.silhouettes[i]
                inside = inside_at(other, x, y)
                if inside > 0.0 and middle_at(other, x, y) + other.bulge * wp.sqrt(inside) > nearness:
                    return True
    return False


@wp.func
def push_crease(forces: PictureForces, view: EllipsoidView, other: Silhouette, place: wp.vec2, cost: float):
    """Add the force on an ellipsoid at a point of a crease: cost times the crease's motion along its normal."""
    s = view.own
    x, y = place[0], place[1]
    middle = middle_at(s, x, y)
    other_middle = middle_at(other, x, y)
    root = root_at(s, x, y)
    other_root = root_at(other, x, y)
    # A small root is inaccurate. Both fronts are equally near, so the smaller root follows from the larger.
    if root * other.bulge < other_root * s.bulge:
        root = other_middle + other_root - middle
    else:
        other_root = middle + root - other_middle
    # At the outline slopes are infinite, but forces stay finite.
    root = wp.max(root, _RIM * s.bulge)
    other_root = wp.max(other_root, _RIM * other.bulge)
    slope = slope_at(s, x, y, root)
    steepness = wp.length(slope - slope_at(other, x, y, other_root))
    if steepness > 0.0:
        # A surface that moves by d changes the nearness at a fixed place by -slope . d.
        amount = cost / steepness
        forces = add_picture_force(forces, view, x, y, middle + root, -amount * slope, amount)
    return forces


@wp.func
def push_chord(
    forces: PictureForces, view: EllipsoidView, j: int, start: wp.vec2, end: wp.vec2, halvings: int, gradient: Any
):
    """Forces of a chord of the crease with ellipsoid j, as far as nothing hides it."""
    s = view.own
    other = view.silhouettes[j]
    start_hidden = is_hidden(view, j, start)
    end_hidden = is_hidden(view, j, end)
    if start_hidden and end_hidden:
        return forces
    if start_hidden != end_hidden:
        low = start
        high = end
        for _ in range(halvings):
            middle = 0.5 * (low + high)
            if is_hidden(view, j, middle) == start_hidden:
                low = middle
            else:
                high = middle
        if start_hidden:
            start = 0.5 * (low + high)
        else:
            end = 0.5 * (low + high)
    shares = chord_shares(view, start, end, s.label, other.label, gradient)
    if shares[0] != 0.0 or shares[1] != 0.0:
        shares *= wp.length(end - start)
        side = int(0)
        while side < 2:  # a loop over a constant range would be unrolled, which takes registers
            place = wp.where(side == 0, start, end)
            forces = push_crease(forces, view, other, place, wp.where(side == 0, shares[0], shares[1]))
            side += 1
    return forces


@wp.func
def gap_where_both(one: Silhouette, other: Silhouette, place: wp.vec2):
    """``front_gap`` where both ellipsoids cover the point, else _NOWHERE."""
    if inside_at(one, place[0], place[1]) <= 0.0 or inside_at(other, place[0], place[1]) <= 0.0:
        return _NOWHERE
    return front_gap(one, other, place[0], place[1])


@wp.func
def gap_in_spans(
    one: Silhouette, other: Silhouette, start: wp.vec2, way: wp.vec2, mine: wp.vec2, others: wp.vec2, share: float
):
    """``front_gap`` at a share of a way, with roots exactly 0 at the ends of the spans, which float32 would miss."""
    x = start[0] + share * way[0]
    y = start[1] + share * way[1]
    root = wp.where(share == mine[0] or share == mine[1], 0.0, root_at(one, x, y))
    other_root = wp.where(share == others[0] or share == others[1], 0.0, root_at(other, x, y))
    return middle_at(one, x, y) - middle_at(other, x, y) + root - other_root


@wp.func
def crossing_between(s: Silhouette, other: Silhouette, start: wp.vec2, end: wp.vec2, start_gap: float, end_gap: float):
    """Share of the way between two points at which two fronts cross; -1 if they cross not at all or twice."""
    way = end - start
    low = float(0.0)
    high = float(1.0)
    low_gap = start_gap
    high_gap = end_gap
    if start_gap == _NOWHERE or end_gap == _NOWHERE:
        mine = span(s, start, way)
        others = span(other, start, way)
        low = wp.max(wp.max(mine[0], others[0]), 0.0)
        high = wp.min(wp.min(mine[1], others[1]), 1.0)
        if low >= high:
            return -1.0
        low_gap = gap_in_spans(s, other, start, way, mine, others, low)
        high_gap = gap_in_spans(s, other, start, way, mine, others, high)
    if (low_gap < 0.0) == (high_gap < 0.0):
        return -1.0
    return find_crossing(s, other, start, way, low, high, wp.vec2(low_gap, high_gap))


@wp.func
def crease_end(s: Silhouette, other: Silhouette, place: wp.vec2):
    """Point near ``place`` where the other's front meets the outline of ``s``: there a crease passes into the outline.

    Third comes the outline's nearness less that of the other's middle; if negative, it is the other's back that meets.
    """
    for _ in range(_NEWTON_STEPS):
        x, y = place[0], place[1]
        # ``radicand`` and ``excess`` are smooth, and 0 at the point.
        radicand = radicand_at(s, x, y)
        over = middle_at(s, x, y) - middle_at(other, x, y)
        excess = radicand_at(other, x, y) - over * over
        inward = radicand_slope(s, x, y)
        along = radicand_slope(other, x, y) - 2.0 * over * (s.slope - other.slope)
        area = inward[0] * along[1] - inward[1] * along[0]
        if area != 0.0:
            place -= wp.vec2(radicand * along[1] - excess * inward[1], excess * inward[0] - radicand * along[0]) / area
    ahead = middle_at(s, place[0], place[1]) - middle_at(other, place[0], place[1])
    return wp.vec3(place[0], place[1], ahead)


@wp.func
def crease_end_in(view: EllipsoidView, j: int, place: wp.vec2, low: wp.vec2, high: wp.vec2):
    """Point in a cell where the crease that enters at ``place`` ends at an outline; ``place`` if there is none near."""
    found = place
    nearest = wp.length(high - low)
    which = int(0)
    while which < 2:
        one = view.silhouettes[wp.where(which == 0, view.k, j)]
        other = view.silhouettes[wp.where(which == 0, j, view.k)]
        end = crease_end(one, other, place)
        there = wp.vec2(end[0], end[1])
        far = wp.length(there - place)
        if end[2] >= 0.0 and far < nearest:
            nearest = far
            found = wp.max(wp.min(there, high), low)
        which += 1
    return found


@wp.func
def walk_cell(
    forces: PictureForces, view: EllipsoidView, j: int, low: wp.vec2, high: wp.vec2, halvings: int, gradient: Any
):
    """Forces of the creases with ellipsoid j in a cell of the picture, as chords between its sides."""
    s = view.own
    other = view.silhouettes[j]
    # The last four crossings of the fronts around the cell.
    first = wp.vec2()
    second = wp.vec2()
    third = wp.vec2()
    fourth = wp.vec2()
    count = int(0)
    end = low
    end_gap = gap_where_both(s, other, low)
    side = int(0)
    while side < 4:  # a loop over a constant range would be unrolled, which takes registers
        start = end
        start_gap = end_gap
        end = wp.vec2(wp.where(side < 2, high[0], low[0]), wp.where(side == 1 or side == 2, high[1], low[1]))
        end_gap = gap_where_both(s, other, end)
        share = crossing_between(s, other, start, end, start_gap, end_gap)
        if share >= 0.0:
            first = second
            second = third
            third = fourth
            fourth = start + share * (end - start)
            count += 1
        side += 1
    if count % 2 == 1:
        first = second
        second = third
        third = fourth
        fourth = crease_end_in(view, j, third, low, high)
        count += 1
    while count > 0:
        forces = push_chord(forces, view, j, third, fourth, halvings, gradient)
        third = first
        fourth = second
        count -= 2
    return forces


@wp.func
def radicand_range(s: Silhouette, x: float, y: float, half: float):
    """Bounds of ``radicand_at`` in a square cell around (x, y) of side 2 ``half``."""
    radicand = radicand_at(s, x, y)
    slope = radicand_slope(s, x, y)
    tilt = half * (wp.abs(slope[0]) + wp.abs(slope[1]))
    corner = to_disc(s, half, wp.where(s.factor[1] * s.factor[2] < 0.0, -half, half))  # the farthest
    bend = s.bulge * s.bulge * wp.dot(corner, corner)
    return wp.vec2(radicand - tilt - bend, radicand + tilt)


@wp.func
def fronts_may_meet(s: Silhouette, other: Silhouette, middle: wp.vec2, half: float):
    """False if bounds of two fronts show that they are nowhere equally near in a cell."""
    x, y = middle[0], middle[1]
    radicand = radicand_range(s, x, y, half)
    other_radicand = radicand_range(other, x, y, half)
    if radicand[1] <= 0.0 or other_radicand[1] <= 0.0:
        return False
    slope = s.slope - other.slope
    ahead = middle_at(s, x, y) - middle_at(other, x, y)
    spread = half * (wp.abs(slope[0]) + wp.abs(slope[1]))
    return (
        ahead + spread + wp.sqrt(radicand[1]) - wp.sqrt(wp.max(other_radicand[0], 0.0)) >= 0.0
        and ahead - spread + wp.sqrt(wp.max(radicand[0], 0.0)) - wp.sqrt(other_radicand[1]) <= 0.0
    )


@wp.func
def take_cell(row: int, column: int, j: int, finder: int):
    """Row and column that another thread found, and the ellipsoid, the same for all."""
    return wp.vec3i(int(shuffle(wp.uint32(row), finder)), int(shuffle(wp.uint32(column), finder)), j)


@wp.func
def crease_box(view: EllipsoidView, j: int):
    """First row and column, and number of columns and of cells between pixel centres that two ellipsoids may cover."""
    low = wp.max(view.own.low, view.silhouettes[j].low)
    high = wp.min(view.own.high, view.silhouettes[j].high)
    # Clamped in float against overflow. The first cell begins half a pixel before the picture.
    left = int(wp.floor(wp.clamp(low[0] - 0.5, -1.0, float(view.width))))
    right = int(wp.floor(wp.clamp(high[0] - 0.5, -2.0, float(view.width - 1))))
    top = int(wp.floor(wp.clamp(low[1] - 0.5, -1.0, float(view.height))))
    bottom = int(wp.floor(wp.clamp(high[1] - 0.5, -2.0, float(view.height - 1))))
    columns = wp.max(right - left + 1, 0)
    return wp.vec4i(top, left, columns, columns * wp.max(bottom - top + 1, 0))


@wp.func
def count_cells(view: EllipsoidView):
    """Number of cells in which an ellipsoid may meet others, for all threads of a warp."""
    cells = float(0.0)
    for j in range(view.lane, view.silhouettes.shape[0], view.scene.lanes):
        if (view.creases[j // 32] >> wp.uint32(j % 32)) & wp.uint32(1) != wp.uint32(0):
            cells += float(crease_box(view, j)[3])
    return int(wp.min(sum_lanes(cells), _MANY_CELLS))  # clamped in float against overflow


@wp.func
def walk_creases(forces: PictureForces, view: EllipsoidView, share: Share, sampling: Sampling, gradient: Any):
    """Forces of a share of an ellipsoid's creases."""
    lane = view.lane
    lanes = view.scene.lanes
    cells = int(wp.ceil(sampling.steps_per_pixel))
    size = 1.0 / float(cells)
    s = view.own
    for word in range(view.creases.shape[0]):
        bits = view.creases[word]
        # Cells between pixel centres are tested ``lanes`` at a time; these groups are numbered over all boxes. Cells
        # that may have a crease wait, one a thread, until all threads have one: the test is cheap, the work is not.
        group = int(share.number)
        begin = int(0)
        end = int(0)
        box = wp.vec4i()
        j = int(-1)
        waiting = int(0)
        cell = wp.vec3i()  # this thread's row and column, and the other ellipsoid
        looking = bool(True)
        while looking or waiting > 0:
            while group >= end and bits != wp.uint32(0):
                j = 32 * word + lowest_bit(bits)
                bits &= bits - wp.uint32(1)
                box = crease_box(view, j)
                begin = end
                end = begin + (box[3] + lanes - 1) // lanes
            looking = group < end
            n = (group - begin) * lanes + lane
            down = n // wp.max(box[2], 1)
            row = box[0] + down
            column = box[1] + n - down * box[2]
            found = bool(False)
            if looking and n < box[3]:
                found = fronts_may_meet(s, view.silhouettes[j], wp.vec2(float(column + 1), float(row + 1)), 0.5)
            group += share.count
            # Hand the found cells to the threads that have none yet; the rest waits.
            finders = ballot(found)
            total = waiting + wp.bit_count(finders)
            if total > waiting:
                found_cell = take_cell(row, column, j, nth_bit(finders, lane - waiting))
                if lane >= waiting:
                    cell = found_cell
            if total >= lanes or not looking:
                if lane < total:
                    corner = wp.vec2(float(cell[1]) + 0.5, float(cell[0]) + 0.5)
                    for i in range(cells * cells):
                        low = corner + size * wp.vec2(float(i % cells), float(i // cells))
                        high = low + wp.vec2(size, size)
                        other = view.silhouettes[cell[2]]
                        if cells == 1 or fronts_may_meet(s, other, 0.5 * (low + high), 0.5 * size):
                            forces = walk_cell(forces, view, cell[2], low, high, sampling.halvings, gradient)
                total -= lanes
                if total > 0:
                    cell = take_cell(row, column, j, nth_bit(finders, wp.bit_count(finders) - total + lane))
            waiting = wp.max(total, 0)
    return forces
