"""Masks of people, which lie in turned crops, brought into their pictures: whom each pixel shows.

Pictures, and rows of pictures, lie one after another in memory, of whatever sizes. A thread has a row.
"""

from collections.abc import Sequence
from typing import Any

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.struct
class MaskArrays:
    """Masks of N people, in the order of their pictures, and where they lie in these."""

    maps: wp.array3d[float]  # (N, S, S) probability that a pixel of the crop shows the person
    windows: wp.array2d[int]  # (N, 4) rows of the picture that the crop meets, and columns: first and last + 1 each
    places: wp.array2d[wp.vec2]  # (N, 3) the window's first pixel in the crop, from -1 to 1; steps across and down


@wp.struct
class PictureArrays:
    """P pictures, one after another."""

    first_rows: wp.array[int]  # (P + 1,) number of rows before each, and in all
    first_pixels: wp.array[int]  # (P,) number of pixels before each
    widths: wp.array[int]  # (P,)
    first_people: wp.array[int]  # (P + 1,) number of people before each, and in all


@wp.func
def slot_of(starts: wp.array[int], index: int) -> int:
    """The last of the slots that starts at an index or before it."""
    return wp.lower_bound(starts, index + 1) - 1


@wp.func
def between_four(image: wp.array[float], side: int, place: wp.vec2) -> float:
    """A square image at a place from -1 to 1, between its four nearest pixels; the border goes on."""
    end = float(side - 1)
    x = wp.clamp(((place[0] + 1.0) * float(side) - 1.0) * 0.5, 0.0, end)
    y = wp.clamp(((place[1] + 1.0) * float(side) - 1.0) * 0.5, 0.0, end)
    left, top = int(x), int(y)
    upper = top * side + left
    right, lower = wp.where(left + 1 < side, 1, 0), wp.where(top + 1 < side, side, 0)
    u, v = x - float(left), y - float(top)
    above = image[upper] * (1.0 - u) + image[upper + right] * u
    below = image[upper + lower] * (1.0 - u) + image[upper + lower + right] * u
    return above * (1.0 - v) + below * v


@wp.kernel
def draw_owners(
    masks: MaskArrays,
    pictures: PictureArrays,
    threshold: float,  # probability that is no person's yet
    first: int,  # row of the first thread
    strongest: wp.array[float],  # probability that it is that person's  OUTPUT
    owners: wp.array[int],  # number of a pixel's person in the picture, from 1 on; 0: nobody's  OUTPUT
):
    """Find whom each pixel of a row shows: the person whose mask is strongest there, or the first of equal ones."""
    row = first + wp.tid()
    picture = slot_of(pictures.first_rows, row)
    row -= pictures.first_rows[picture]
    width = pictures.widths[picture]
    begin = pictures.first_pixels[picture] + row * width
    for i in range(begin, begin + width):
        owners[i] = 0
        strongest[i] = threshold
    side = masks.maps.shape[1]
    before = pictures.first_people[picture]
    for n in range(before, pictures.first_people[picture + 1]):
        down = row - masks.windows[n, 0]
        if down >= 0 and row < masks.windows[n, 1]:
            image = wp.array(ptr=masks.maps[n].ptr, shape=(side * side,), dtype=float)
            left, right = int(masks.windows[n, 2]), int(masks.windows[n, 3])
            # A copy: whatever stands in an array would be read again for each pixel.
            across = wp.vec2(masks.places[n, 1][0], masks.places[n, 1][1])
            start = masks.places[n, 0] + float(down) * masks.places[n, 2]
            for column in range(left, right):
                place = start + float(column - left) * across
                if wp.abs(place[0]) <= 1.0 and wp.abs(place[1]) <= 1.0:
                    strength = between_four(image, side, place)
                    if strength > strongest[begin + column]:
                        strongest[begin + column] = strength
                        owners[begin + column] = n - before + 1


def launch_owners(
    masks: Sequence[wp.array], pictures: Sequence[wp.array], threshold: float, filled: Sequence[wp.array], rows: slice
) -> None:
    """Fill strengths and owners in some of the rows, from arrays in the order of the structures."""
    given = [_gathered(MaskArrays, masks), _gathered(PictureArrays, pictures)]
    count = rows.stop - rows.start
    wp.launch(draw_owners, count, [*given, threshold, rows.start, *filled], device=filled[0].device)


def _gathered(struct: Any, arrays: Sequence[wp.array]) -> Any:
    found = struct()
    for name, array in zip(struct.vars, arrays, strict=True):
        setattr(found, name, array)
    return found
