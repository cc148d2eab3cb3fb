"""Labels of people's masks in the crops about them, and limbs that the masks miss.

As ``inputs.ignored_labels`` and ``inputs.observation`` make them of one person, to the bit.
"""

from collections.abc import Sequence
from typing import Any

import warp as wp

from .own_pixels import NOBODYS, OTHERS, OWN, Bone, PeopleArrays, PixelArrays, group_at, picture_index, squared_distance

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
            column = int(wp.floor(line[0] + shares[s] * line[2]))
            row = int(wp.floor(line[1] + shares[s] * line[3]))
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
def group_in_window(people: PeopleArrays, limbs: LimbArrays, pixels: PixelArrays, n: int, row: int, column: int):
    """Group of a pixel of the window: the person's own, without what is not theirs and along missing limbs."""
    area_row, area_column = row - people.areas[n, 0], column - people.areas[n, 1]
    group = OTHERS
    height, width = people.areas[n, 2], people.areas[n, 3]
    if area_row >= 0 and area_row < height and area_column >= 0 and area_column < width:
        group = pixels.groups[people.first_pixels[n] + area_row * width + area_column]
    else:
        group = group_at(people, n, picture_index(people, n, 0, row), picture_index(people, n, 1, column))
        group = wp.where(group == OWN, OTHERS, group)
    if group == NOBODYS and along_missing_limb(limbs, n, row, column):
        return OTHERS
    return group


@wp.kernel
def draw_targets(
    people: PeopleArrays,
    limbs: LimbArrays,
    pixels: PixelArrays,
    crops: wp.array2d[wp.float64],  # (N, 4) top and left in the picture, height and width of a crop's pixel
    zooms: wp.array[wp.float64],  # (N,) pixels of the window a pixel of the picture
    first: int,  # person of the first thread
    targets: wp.array3d[wp.uint8],  # (N, S, S)  OUTPUT
):
    """Groups in the crops. One thread a row."""
    part, row = wp.tid()
    n = first + part
    half = wp.float64(0.5)
    place = crops[n, 0] + (wp.float64(row) + half) * crops[n, 2]
    picture_row = int(wp.floor(place))
    window_row = int(wp.floor((place - people.boxes[n, 0]) * zooms[n]))
    row_inside = window_row >= 0 and window_row < people.windows[n, 0]
    for column in range(targets.shape[2]):
        place = crops[n, 1] + (wp.float64(column) + half) * crops[n, 3]
        window_column = int(wp.floor((place - people.boxes[n, 1]) * zooms[n]))
        if row_inside and window_column >= 0 and window_column < people.windows[n, 1]:
            targets[n, row, column] = group_in_window(people, limbs, pixels, n, window_row, window_column)
        else:
            group = group_at(people, n, picture_row, int(wp.floor(place)))
            targets[n, row, column] = wp.where(group == OWN, OTHERS, group)


def launch_targets(
    people: Any, limbs: Any, pixels: Any, crops: Sequence[wp.array], targets: wp.array, part: slice
) -> None:
    """Fill targets of some of the people from crops and zooms."""
    inputs = [people, limbs, pixels, *crops, part.start, targets]
    wp.launch(draw_targets, (part.stop - part.start, targets.shape[1]), inputs, device=targets.device)


def launch_limbs(people: Any, shares: wp.array, least: float, limbs: Any) -> None:
    """Fill ``limbs.missing``."""
    wp.launch(find_missing_limbs, limbs.lines.shape, [people, shares, wp.float64(least), limbs], device=shares.device)
