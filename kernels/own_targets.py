"""People's own labels along their limbs, and drawn in the crops about them.

``reference.own_pixels`` says the same of one person.
"""

from collections.abc import Sequence
from typing import Any

import warp as wp

from .lanes import num_lanes
from .own_pixels import (
    NOBODYS,
    OTHERS,
    PeopleArrays,
    PixelArrays,
    floor_index,
    group_at,
    group_of,
    picture_index,
    shows_part,
    squared_distance,
)

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

Line: Any = wp.types.vector(length=4, dtype=wp.float64)  # start (x, y) and way to the end
Around: Any = wp.types.vector(length=6, dtype=wp.float32)  # the same, the way's square, and a squared distance
NUM_SIDES = 3  # numbers of places on a limb's own label, on the other side's, and on any other


@wp.struct
class LimbArrays:
    """Bones of limbs of N people."""

    lines: wp.array2d[Line]  # (N, L)
    around: wp.array2d[Around]  # (N, L) and what is ignored about them if they are missing, hands with the forearms
    there: wp.array2d[wp.uint8]  # (N, L) 1 where both ends are known
    missing: wp.array2d[wp.uint8]  # (N, L) 1 of those that are missing


@wp.func
def others_group(people: PeopleArrays, n: int, row: int, column: int) -> wp.uint8:
    """Group of a pixel of a picture that can't be the person's."""
    return wp.where(group_at(people, n, row, column) == NOBODYS, NOBODYS, OTHERS)


@wp.func
def own_group_at(people: PeopleArrays, pixels: PixelArrays, n: int, row: int, column: int) -> wp.uint8:
    """Group of a pixel of the window, without what is not the person's."""
    area_row, area_column = row - people.areas[n, 0], column - people.areas[n, 1]
    if area_row >= 0 and area_row < people.areas[n, 2] and area_column >= 0 and area_column < people.areas[n, 3]:
        return pixels.groups[people.first_pixels[n] + area_row * people.areas[n, 3] + area_column]
    return others_group(people, n, picture_index(people, n, 0, row), picture_index(people, n, 1, column))


@wp.func
def in_window(people: PeopleArrays, n: int, row: int, column: int) -> bool:
    return row >= 0 and row < people.windows[n, 0] and column >= 0 and column < people.windows[n, 1]


@wp.kernel
def find_missing_limbs(
    people: PeopleArrays,
    pixels: PixelArrays,
    shares: wp.array[wp.float64],  # of the ways, places that are looked at
    least: wp.float64,  # share of background from which on a limb is missing
    limbs: LimbArrays,
):
    """Fill ``missing``. One thread a limb."""
    n, k = wp.tid()
    found = int(0)
    if limbs.there[n, k] != wp.uint8(0):
        line = limbs.lines[n, k]
        for s in range(shares.shape[0]):
            column = floor_index(line[0] + shares[s] * line[2])
            row = floor_index(line[1] + shares[s] * line[3])
            if in_window(people, n, row, column):
                found += wp.where(own_group_at(people, pixels, n, row, column) == NOBODYS, 1, 0)
    limbs.missing[n, k] = wp.uint8(wp.where(wp.float64(found) / wp.float64(shares.shape[0]) >= least, 1, 0))


@wp.kernel
def count_sides(
    people: PeopleArrays,
    pixels: PixelArrays,
    shares: wp.array[wp.float64],  # of the ways, places that are looked at
    sides: wp.array2d[int],  # (L, 2) each limb's group, and that of its mirror image; 0 where they are not compared
    limbs: LimbArrays,
    counts: wp.array3d[int],  # (N, L, NUM_SIDES)  OUTPUT
):
    """Count the labels along limbs. One thread a limb."""
    n, k = wp.tid()
    own, mirrored, other = int(0), int(0), int(0)
    if limbs.there[n, k] != wp.uint8(0) and sides[k, 0] != 0:
        line = limbs.lines[n, k]
        for s in range(shares.shape[0]):
            column = floor_index(line[0] + shares[s] * line[2])
            row = floor_index(line[1] + shares[s] * line[3])
            if in_window(people, n, row, column):
                group = own_group_at(people, pixels, n, row, column)
                if int(group) == sides[k, 0]:
                    own += 1
                elif int(group) == sides[k, 1]:
                    mirrored += 1
                elif shows_part(group):
                    other += 1
    counts[n, k, 0] = own
    counts[n, k, 1] = mirrored
    counts[n, k, 2] = other


@wp.func
def along_missing_limb(limbs: LimbArrays, n: int, row: int, column: int) -> bool:
    x, y = float(column) + 0.5, float(row) + 0.5
    for k in range(limbs.missing.shape[1]):
        if limbs.missing[n, k] != wp.uint8(0):
            bone = limbs.around[n, k]
            if squared_distance(x - bone[0], y - bone[1], bone[2], bone[3], bone[4]) <= bone[5]:
                return True
    return False


@wp.func
def limits_of_missing(limbs: LimbArrays, n: int, row: int):
    """First and last column of a row of the window that may lie along missing limbs."""
    y, left, right = float(row) + 0.5, float(wp.inf), float(-wp.inf)
    for k in range(limbs.missing.shape[1]):
        if limbs.missing[n, k] != wp.uint8(0):
            bone = limbs.around[n, k]
            reach = wp.sqrt(bone[5]) + 1.0
            if y >= wp.min(bone[1], bone[1] + bone[3]) - reach and y <= wp.max(bone[1], bone[1] + bone[3]) + reach:
                left = wp.min(left, wp.min(bone[0], bone[0] + bone[2]) - reach)
                right = wp.max(right, wp.max(bone[0], bone[0] + bone[2]) + reach)
    return int(wp.max(left, -1.0e9)), int(wp.min(right, 1.0e9))


@wp.func
def row_begin(people: PeopleArrays, n: int, row: int) -> int:
    """First pixel of a row of a picture; -1 beyond the picture."""
    if row < 0 or row >= people.pictures[n, 1]:
        return -1
    return people.pictures[n, 0] + row * people.pictures[n, 2]


@wp.kernel
def find_crop_columns(
    people: PeopleArrays,
    crops: wp.array2d[wp.float64],  # (N, 4) top and left in the picture, height and width of a crop's pixel
    zooms: wp.array[wp.float64],  # (N,) pixels of the window a pixel of the picture
    every: int,  # so many-th pixel of the crops alone is drawn, the middle one of as many
    columns: wp.array2d[wp.vec4i],  # (N, W)  OUTPUT
):
    """Columns under each of a crop's: of the area, of the window, of the picture there, and of the picture beyond it.

    -1 where there is none.
    """
    n, column = wp.tid()
    place = crops[n, 1] + (wp.float64(every // 2 + column * every) + wp.float64(0.5)) * crops[n, 3]
    in_picture, in_area, source = floor_index(place), int(-1), int(-1)
    in_window = floor_index((place - people.boxes[n, 1]) * zooms[n])
    if in_window >= 0 and in_window < people.windows[n, 1]:
        source = picture_index(people, n, 1, in_window)
        if in_window >= people.areas[n, 1] and in_window < people.areas[n, 1] + people.areas[n, 3]:
            in_area = in_window - people.areas[n, 1]
        if source >= people.pictures[n, 2]:
            source = -1
    else:
        in_window = -1
    if in_picture < 0 or in_picture >= people.pictures[n, 2]:
        in_picture = -1
    columns[n, column] = wp.vec4i(in_area, in_window, source, in_picture)


@wp.kernel
def draw_targets(
    people: PeopleArrays,
    pixels: PixelArrays,
    limbs: LimbArrays,
    crops: wp.array2d[wp.float64],  # as of ``find_crop_columns``
    zooms: wp.array[wp.float64],
    every: int,
    columns: wp.array2d[wp.vec4i],
    first: int,  # person of the first thread
    lanes: int,
    targets: wp.array3d[wp.uint32],  # (N, H, W / 4), four pixels in each, the first lowest  OUTPUT
):
    """Groups in the crops; in the window without what is not the person's and along missing limbs.

    One thread a row, or some of its columns.
    """
    part, row, lane = wp.tid()
    n = first + part
    place = crops[n, 0] + (wp.float64(every // 2 + row * every) + wp.float64(0.5)) * crops[n, 2]
    picture_row = floor_index(place)
    window_row = floor_index((place - people.boxes[n, 0]) * zooms[n])
    in_window = window_row >= 0 and window_row < people.windows[n, 0]
    area_row = window_row - people.areas[n, 0]
    in_area = in_window and area_row >= 0 and area_row < people.areas[n, 2]
    source_row = picture_index(people, n, 0, window_row)
    begin, number = people.first_pixels[n] + area_row * people.areas[n, 3], int(people.pictures[n, 3])
    beyond = row_begin(people, n, picture_row)
    source = row_begin(people, n, source_row)
    left, right = limits_of_missing(limbs, n, window_row)
    if not in_window:
        left = int(wp.max(right, 0)) + 1
    for quad in range(lane, targets.shape[2], lanes):
        word = wp.uint32(0)
        for k in range(4):
            under = columns[n, 4 * quad + k]
            group = OTHERS
            if in_area and under[0] >= 0:
                group = pixels.groups[begin + under[0]]
            elif in_window and under[1] >= 0:
                if source >= 0 and under[2] >= 0 and group_of(people, number, source + under[2]) == NOBODYS:
                    group = NOBODYS
            elif beyond >= 0 and under[3] >= 0 and group_of(people, number, beyond + under[3]) == NOBODYS:
                group = NOBODYS
            if group == NOBODYS and under[1] >= left and under[1] <= right:
                if along_missing_limb(limbs, n, window_row, under[1]):
                    group = OTHERS
            word = word | (wp.uint32(group) << wp.uint32(8 * k))
        targets[n, row, quad] = word


def launch_targets(
    people: Any,
    pixels: Any,
    limbs: Any,
    crops: Sequence[wp.array],
    every: int,
    columns: wp.array,
    targets: wp.array,
    part: slice,
) -> None:
    """Fill targets of some of the people, whose columns ``launch_crop_columns`` found."""
    lanes = num_lanes(targets.device)
    inputs = [people, pixels, limbs, *crops, every, columns, part.start, lanes, targets]
    wp.launch(draw_targets, (part.stop - part.start, *targets.shape[1:2], lanes), inputs, device=targets.device)


def launch_crop_columns(people: Any, crops: Sequence[wp.array], every: int, columns: wp.array) -> None:
    """Find the columns under those of crops."""
    wp.launch(find_crop_columns, columns.shape, [people, *crops, every, columns], device=columns.device)


def launch_limbs(people: Any, pixels: Any, limbs: Any, shares: wp.array, least: float) -> None:
    """Fill ``limbs.missing``."""
    inputs = [people, pixels, shares, wp.float64(least), limbs]
    wp.launch(find_missing_limbs, limbs.missing.shape, inputs, device=shares.device)


def launch_sides(people: Any, pixels: Any, limbs: Any, shares: wp.array, sides: wp.array, counts: wp.array) -> None:
    """Fill counts of the labels along limbs."""
    inputs = [people, pixels, shares, sides, limbs, counts]
    wp.launch(count_sides, counts.shape[:2], inputs, device=shares.device)
