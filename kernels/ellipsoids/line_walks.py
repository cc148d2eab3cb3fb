"""Walks of PartDR along lines of pixels, from an outline's end to the pixels that it meets (paper, eq. 10 and 11)."""

from typing import Any

import warp as wp

from ..labels import MISSING, SURPLUS, all_wrong, extent, pixel_gradient, pixels_of, wrong_on_line
from ..lanes import AT_ONCE, at_once, ballot
from .borders import front_at, line_root, outline_end
from .forces import EllipsoidView, take_share
from .picture_forces import PictureForces, add_picture_force, on_surface
from .silhouette import Silhouette, middle_at, pixel_box

_WEIGHT = wp.constant(16)  # of a turn of ends of lines


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
def walk_lines(view: EllipsoidView, max_distance: float, gradient: Any):
    """Forces in x and y: from rows and columns that meet the outline, two ends each."""
    s = view.own
    forces = PictureForces()
    left, right, top, bottom = wrong_box(view, gradient)
    rows = wp.max(bottom - top + 1, 0)
    columns = wp.max(right - left + 1, 0)
    alone = is_alone(view)
    ends = 2 * (rows + columns)
    share = take_share(view, 0, view.shares, ends, _WEIGHT)
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
                push = wp.vec2(wp.where(axis == 0, slope, 0.0), wp.where(axis == 0, 0.0, slope))
                forces = add_picture_force(forces, view, x, y, nearness, push, 0.0)
        n += share.count * share.turn
    return on_surface(view, forces)
