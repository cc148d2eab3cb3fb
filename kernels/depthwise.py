"""Convolutions of each channel by itself: four channels, which lie side by side in memory, a thread.

Libraries' own leave memory idle here, and add biases and cut values off in launches of their own.
"""

from typing import Any

import warp as wp

wp.set_module_options({"enable_backward": False})

TOGETHER = 4  # channels that a thread reads at once
HALF_WORD = wp.int64  # that many channels in float16
WORD = wp.vec4  # the same in float32


@wp.struct
class DepthwiseWindows:
    """Sizes of pictures, and of the windows over them."""

    height: int
    width: int
    words: int  # of a pixel, each of ``TOGETHER`` channels
    size: int  # side of the windows [px]
    stride: int
    left: int  # zeros beside the pictures
    above: int
    input_limits: wp.vec2  # least and most of the pictures' values: what is beyond counts as these
    limits: wp.vec2  # the same of the results


@wp.func
def value_in(word: wp.int64, place: int) -> float:
    return float(wp.cast(wp.uint16((word >> wp.int64(16 * place)) & wp.int64(65535)), wp.float16))


@wp.func
def unpacked(word: wp.int64) -> wp.vec4:
    return wp.vec4(value_in(word, 0), value_in(word, 1), value_in(word, 2), value_in(word, 3))


@wp.func
def unpacked(word: wp.vec4) -> wp.vec4:
    return word


@wp.func
def packed_like(example: wp.int64, values: wp.vec4) -> wp.int64:
    word = wp.int64(0)
    for place in range(TOGETHER):
        word = word | (wp.int64(wp.cast(wp.float16(values[place]), wp.uint16)) << wp.int64(16 * place))
    return word


@wp.func
def packed_like(example: wp.vec4, values: wp.vec4) -> wp.vec4:
    return values


@wp.func
def cut_off(values: wp.vec4, limits: wp.vec2) -> wp.vec4:
    return wp.max(wp.min(values, wp.vec4(limits[1])), wp.vec4(limits[0]))


@wp.kernel
def convolve_channels(
    pictures: wp.array[Any],  # (B H W words,)
    weights: wp.array[Any],  # (size size words,)
    biases: wp.array[Any],  # (words,)
    windows: DepthwiseWindows,
    found: wp.array3d[Any],  # (B, h, w words)  OUTPUT
):
    """Sums over windows, counted in float32."""
    n, row, place = wp.tid()
    column = place // windows.words
    word = place - column * windows.words
    top, left = row * windows.stride - windows.above, column * windows.stride - windows.left
    total = unpacked(biases[word])
    for v in range(windows.size):
        y = top + v
        if y >= 0 and y < windows.height:
            for u in range(windows.size):
                x = left + u
                if x >= 0 and x < windows.width:
                    value = unpacked(pictures[((n * windows.height + y) * windows.width + x) * windows.words + word])
                    weight = unpacked(weights[(v * windows.size + u) * windows.words + word])
                    total += wp.cw_mul(cut_off(value, windows.input_limits), weight)
    found[n, row, place] = packed_like(biases[word], cut_off(total, windows.limits))


def _overload(word: Any) -> Any:
    arrays = dict.fromkeys(("pictures", "weights", "biases"), wp.array[word])
    return wp.overload(convolve_channels, {**arrays, "found": wp.array3d[word]})


# Both stand here, because a kernel that appears after the module was loaded would build it again.
_KERNELS = {word: _overload(word) for word in (HALF_WORD, WORD)}


def launch_depthwise(pictures: Any, weights: Any, biases: Any, windows: Any, found: Any) -> None:
    """Fill ``found``; arrays are of ``HALF_WORD`` or of ``WORD``, and ``windows`` are ``DepthwiseWindows``."""
    inputs = [pictures, weights, biases, windows, found]
    wp.launch(_KERNELS[found.dtype], found.shape, inputs, device=found.device)
