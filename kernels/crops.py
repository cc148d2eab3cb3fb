"""Crops cut out of pictures of any sizes, which may be turned, in one launch."""

from typing import Any

import warp as wp

from .lanes import num_lanes

wp.set_module_options({"enable_backward": False})


@wp.struct
class SourceArrays:
    """Pictures that N crops are cut from, and where the crops lie in them."""

    pointers: wp.array[wp.int64]  # (N,) to pictures (H, W, 3), float
    sizes: wp.array2d[int]  # (N, 2) height and width
    places: wp.array2d[wp.vec2]  # (N, 3) the crop's first pixel in the picture [px]; steps across and down


@wp.kernel
def cut_out(
    sources: SourceArrays,
    black_beyond: bool,  # else the border goes on
    lanes: int,
    crops: wp.array4d[float],  # (N, 3, h, w)  OUTPUT
):
    """Each pixel between the four nearest of the picture. One thread a row, or some of its columns."""
    n, row, lane = wp.tid()
    height, width = int(sources.sizes[n, 0]), int(sources.sizes[n, 1])
    picture = wp.array(ptr=wp.uint64(sources.pointers[n]), shape=(height * width,), dtype=wp.vec3)
    # A copy: whatever stands in an array would be read again for each pixel.
    across = wp.vec2(sources.places[n, 1][0], sources.places[n, 1][1])
    start = sources.places[n, 0] + float(row) * sources.places[n, 2]
    for column in range(lane, crops.shape[3], lanes):
        place = start + float(column) * across
        x = wp.clamp(place[0] - 0.5, -1.0, float(width))  # from the first pixel's centre; farther out, all is alike
        y = wp.clamp(place[1] - 0.5, -1.0, float(height))
        left, top = int(wp.floor(x)), int(wp.floor(y))
        u, v = x - float(left), y - float(top)
        first, second, above, below = 1.0 - u, u, 1.0 - v, v
        if black_beyond:
            first = wp.where(left < 0 or left >= width, 0.0, first)
            second = wp.where(left + 1 >= width, 0.0, second)
            above = wp.where(top < 0 or top >= height, 0.0, above)
            below = wp.where(top + 1 >= height, 0.0, below)
        right, bottom = wp.min(left + 1, width - 1), wp.min(top + 1, height - 1) * width
        left, top = wp.clamp(left, 0, width - 1), wp.clamp(top, 0, height - 1) * width
        colour = above * (first * picture[top + left] + second * picture[top + right])
        colour += below * (first * picture[bottom + left] + second * picture[bottom + right])
        for channel in range(3):
            crops[n, channel, row, column] = colour[channel]


def launch_crops(sources: list[wp.array], black_beyond: bool, crops: wp.array) -> None:
    """Fill ``crops`` from arrays in the order of ``SourceArrays``."""
    given: Any = SourceArrays()
    given.pointers, given.sizes, given.places = sources
    lanes = num_lanes(crops.device)
    shape = (crops.shape[0], crops.shape[2], lanes)
    wp.launch(cut_out, shape, [given, black_beyond, lanes, crops], device=crops.device)
