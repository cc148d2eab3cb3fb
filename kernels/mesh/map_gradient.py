"""Gradient g of a loss with respect to the part maps, as the mesh renderer's backward pass reads it.

g comes in two forms: dense maps (B, K, H, W), or a target label image, from which L_seg's gradient at a pixel follows
from two labels: 2 w (shown) where a part is wrong and -2 w (target) where one is missing.
"""

from typing import Any

import warp as wp

from ..labels import IGNORE, DenseGradient, LabelTarget, flat, map_weight
from .rasterize import MISSING, SURPLUS


@wp.func
def pixels_of(g: LabelTarget, b: int, label: int):
    """Pixels that ``pixel_gradient`` reads for a label: the target's."""
    return flat(g.target[b])


@wp.func
def pixels_of(g: DenseGradient, b: int, label: int):
    """Pixels that ``pixel_gradient`` reads for a label: its map's."""
    return flat(g.maps[b, label - 1])


@wp.func
def pixel_gradient(target: wp.array[wp.uint8], at: int, label: int, shows_it: bool):
    """dL/dA of map ``label`` at a pixel that shows this label or another, but for the factor ``weight_of``."""
    expected = int(target[at])
    if shows_it:
        return wp.where(expected == label or expected == IGNORE, 0.0, 2.0)
    return wp.where(expected == label, -2.0, 0.0)


@wp.func
def pixel_gradient(map: wp.array[float], at: int, label: int, shows_it: bool):
    """dL/dA of map ``label`` at a pixel."""
    return map[at]


@wp.func
def weight_of(g: LabelTarget, b: int, label: int):
    """Factor of ``pixel_gradient`` for a label."""
    return map_weight(label) * g.scale[b]


@wp.func
def weight_of(g: DenseGradient, b: int, label: int):
    """Factor 1: dense maps are weighted already."""
    return 1.0


@wp.func
def target_label_at(g: LabelTarget, b: int, at: int):
    """Label that may come forward at a pixel: the target's."""
    return int(flat(g.target[b])[at])


@wp.func
def target_label_at(g: DenseGradient, b: int, at: int):
    """Label that may come forward at a pixel: the one whose turn it is, by the gradient of its map."""
    return g.label


@wp.func
def extent(g: LabelTarget, b: int, kind: int, label: int):
    """First and last row and column of a label's wrong pixels of this kind; last < first if there are none."""
    if label >= g.extents.shape[2]:
        return wp.vec4i(0, -1, 0, -1)
    reach = g.extents[b, kind, label]
    return wp.vec4i(g.target.shape[1] - reach[0], reach[1] - 1, g.target.shape[2] - reach[2], reach[3] - 1)


@wp.func
def extent(g: DenseGradient, b: int, kind: int, label: int):
    """First and last row and column of the picture, for any pixel can have a gradient."""
    if label > g.maps.shape[1]:
        return wp.vec4i(0, -1, 0, -1)
    return wp.vec4i(0, g.maps.shape[2] - 1, 0, g.maps.shape[3] - 1)


@wp.func
def all_wrong(gradient: Any, b: int, label: int):
    """Union of the ``extent`` of pixels that miss a label and of those that show it wrongly."""
    missing = extent(gradient, b, MISSING, label)
    surplus = extent(gradient, b, SURPLUS, label)
    return wp.vec4i(
        wp.min(missing[0], surplus[0]),
        wp.max(missing[1], surplus[1]),
        wp.min(missing[2], surplus[2]),
        wp.max(missing[3], surplus[3]),
    )
