"""Labels of people's masks in the crops about them, and limbs that the masks miss.

As ``inputs.ignored_labels`` and ``inputs.observation`` make them of one person, to the bit.
"""

from collections.abc import Sequence
from typing import Any

import warp as wp

from .lanes import num_lanes
from .own_pixels import (
    NOBODYS,
    OTHERS,
    OWN,
    Bone,
    PeopleArrays,
    PixelArrays,
    floor_index,
    group_at,
    picture_index,
    squared_distance,
)

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

Line: Any = wp.types.vector(length=4, dtype=wp.float64)  # start (x, y) and way to the end


@wp.struct
class LimbArrays:
    """Bones of limbs of N people that may be missing in the mask."""

    lines: wp.array2d[Line]  # (N, L)
    around: wp.array2d[Bone]  # (N, L) and what is ignored about them, the hands' places with the forearms
    num_limbs: wp.array[int]  # (N,) that are there
    missing: wp.array2d[wp.uint8]  # (N, L) 1 of those that are missing


@wp.kernel
def find_missing_limbs(
    people: PeopleArrays,
    shares: wp.array[wp.float64],  # of the ways, places that are looked at
    least: wp.float64,  # share of background from which on a limb is missing
    limbs: LimbArrays,
):
    """Fill ``missing``. One thread a limb."""
    n, k = wp.tid()
    found = int(0)
    if k < limbs.num_limbs[n]:
        line = limbs.lines[n, k]
        for s in range(shares.shape[0]):
            column = floor_index(line[0] + shares[s] * line[2])
            row = floor_index(line[1] + shares[s] * line[3])
            if row >= 0 and row < people.windows[n, 0] and column >= 0 and column < people.windows[n, 1]:
                group = group_at(people, n, picture_index(people, n, 0, row), picture_index(people, n, 1, column))
                found += wp.where(group == NOBODYS, 1, 0)
    limbs.missing[n, k] = wp.uint8(wp.where(wp.float64(found) / wp.float64(shares.shape[0]) >= least, 1, 0))


@wp.func
def along_missing_limb(limbs: LimbArrays, n: int, row: int, column: int) -> bool:
    x, y = float(column) + 0.5, float(row) + 0.5
    for k in range(limbs.num_limbs[n]):
        if limbs.missing[n, k] != wp.uint8(0):
            bone = limbs.around[n, k]
            if squared_distance(x - bone[0], y - bone[1], bone[2], bone[3], bone[4]) <= bone[5]:
                return True
    return False


@wp.func
def others_group(people: PeopleArrays, n: int, row: int, column: int) -> wp.uint8:
    """Group of a pixel of a picture that can't be the person's."""
    group = group_at(people, n, row, column)
    return wp.where(group == OWN, OTHERS, group)


@wp.kernel
def draw_targets(
    people: PeopleArrays,
    limbs: LimbArrays,
    pixels: PixelArrays,
    crops: wp.array2d[wp.float64],  # (N, 4) top and left in the picture, height and width of a crop's pixel
    zooms: wp.array[wp.float64],  # (N,) pixels of the window a pixel of the picture
    first: int,  # person of the first thread
    lanes: int,
    targets: wp.array3d[wp.uint8],  # (N, S, S)  OUTPUT
):
    """Groups in the crops; in the window without what is not the person's and along missing limbs.

    One thread a row, or some of its columns.
    """
    part, row, lane = wp.tid()
    n = first + part
    half = wp.float64(0.5)
    # Copies: whatever stands in an array would be read again for each pixel.
    zoom, window_left = wp.float64(zooms[n]), wp.float64(people.boxes[n, 1])
    left, step = wp.float64(crops[n, 1]), wp.float64(crops[n, 3])
    place = crops[n, 0] + (wp.float64(row) + half) * crops[n, 2]
    picture_row = floor_index(place)
    window_row, window_width = floor_index((place - people.boxes[n, 0]) * zoom), int(people.windows[n, 1])
    area_row, area_left, area_width = window_row - people.areas[n, 0], int(people.areas[n, 1]), int(people.areas[n, 3])
    begin = people.first_pixels[n] + area_row * area_width - area_left
    if area_row < 0 or area_row >= people.areas[n, 2]:
        area_width = 0
    if window_row < 0 or window_row >= people.windows[n, 0]:
        window_width = 0
    some_missing = int(0)
    for k in range(limbs.num_limbs[n]):
        some_missing += int(limbs.missing[n, k])
    for column in range(lane, targets.shape[2], lanes):
        place = left + (wp.float64(column) + half) * step
        window_column = floor_index((place - window_left) * zoom)
        group = OTHERS
        if window_column >= 0 and window_column < window_width:
            if window_column >= area_left and window_column < area_left + area_width:
                group = pixels.groups[begin + window_column]
            else:
                source_row = picture_index(people, n, 0, window_row)
                group = others_group(people, n, source_row, picture_index(people, n, 1, window_column))
            if some_missing > 0 and group == NOBODYS and along_missing_limb(limbs, n, window_row, window_column):
                group = OTHERS
        else:
            group = others_group(people, n, picture_row, floor_index(place))
        targets[n, row, column] = group


def launch_targets(
    people: Any, limbs: Any, pixels: Any, crops: Sequence[wp.array], targets: wp.array, part: slice
) -> None:
    """Fill targets of some of the people from crops and zooms."""
    lanes = num_lanes(targets.device)
    inputs = [people, limbs, pixels, *crops, part.start, lanes, targets]
    wp.launch(draw_targets, (part.stop - part.start, targets.shape[1], lanes), inputs, device=targets.device)


def launch_limbs(people: Any, shares: wp.array, least: float, limbs: Any) -> None:
    """Fill ``limbs.missing``."""
    wp.launch(find_missing_limbs, limbs.lines.shape, [people, shares, wp.float64(least), limbs], device=shares.device)
