"""Convolutions of each channel by itself, in float16: four channels, which lie side by side in memory, a thread.

Libraries' own leave memory idle here, and add biases and cut values off in launches of their own.
"""

from collections.abc import Sequence
from typing import Any

import warp as wp

wp.set_module_options({"enable_backward": False})

TOGETHER = 4  # channels that a thread reads at once


@wp.struct
class DepthwiseArrays:
    """A batch of pictures, and what they are convolved with; words hold ``TOGETHER`` channels, float16."""

    pictures: wp.array[wp.int64]  # (B H W words,)
    weights: wp.array[wp.int64]  # (size size words,)
    biases: wp.array[wp.int64]  # (words,)
    height: int
    width: int
    words: int  # of a pixel
    size: int  # side of the windows [px]
    stride: int
    left: int  # zeros beside the pictures
    above: int


@wp.func
def value_in(word: wp.int64, place: int) -> float:
    return float(wp.cast(wp.uint16((word >> wp.int64(16 * place)) & wp.int64(65535)), wp.float16))


@wp.func
def unpacked(word: wp.int64) -> wp.vec4:
    return wp.vec4(value_in(word, 0), value_in(word, 1), value_in(word, 2), value_in(word, 3))


@wp.func
def packed(values: wp.vec4) -> wp.int64:
    word = wp.int64(0)
    for place in range(TOGETHER):
        word = word | (wp.int64(wp.cast(wp.float16(values[place]), wp.uint16)) << wp.int64(16 * place))
    return word


@wp.func
def cut_off(values: wp.vec4, least: float, most: float) -> wp.vec4:
    return wp.max(wp.min(values, wp.vec4(most)), wp.vec4(least))


@wp.kernel
def convolve_channels(
    arrays: DepthwiseArrays,
    input_limits: wp.vec2,  # least and most of the pictures' values: what is beyond counts as these
    limits: wp.vec2,  # the same of the results
    found: wp.array3d[wp.int64],  # (B, h, w words)  OUTPUT
):
    """Sums over windows, counted in float32."""
    n, row, place = wp.tid()
    column = place // arrays.words
    word = place - column * arrays.words
    top, left = row * arrays.stride - arrays.above, column * arrays.stride - arrays.left
    total = unpacked(arrays.biases[word])
    for v in range(arrays.size):
        y = top + v
        if y >= 0 and y < arrays.height:
            for u in range(arrays.size):
                x = left + u
                if x >= 0 and x < arrays.width:
                    value = unpacked(
                        arrays.pictures[((n * arrays.height + y) * arrays.width + x) * arrays.words + word]
                    )
                    weight = unpacked(arrays.weights[(v * arrays.size + u) * arrays.words + word])
                    total += wp.cw_mul(cut_off(value, input_limits[0], input_limits[1]), weight)
    found[n, row, place] = packed(cut_off(total, limits[0], limits[1]))


def launch_depthwise(
    words: Sequence[wp.array],
    numbers: Sequence[int],
    limits: tuple[tuple[float, float], tuple[float, float]],
    found: Any,
) -> None:
    """Fill ``found`` from arrays and numbers in the order of ``DepthwiseArrays``, and limits of input and results."""
    given: Any = DepthwiseArrays()
    given.pictures, given.weights, given.biases = words
    given.height, given.width, given.words, given.size, given.stride, given.left, given.above = numbers
    inputs = [given, wp.vec2(*limits[0]), wp.vec2(*limits[1]), found]
    wp.launch(convolve_channels, found.shape, inputs, device=found.device)
