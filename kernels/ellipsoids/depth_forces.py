"""Forces of PartDR in z (paper, eq. 12).

Where a label is hidden that should show, its ellipsoid comes forward, and the one that hides it goes back.
"""

from typing import Any

import warp as wp

from ..labels import (
    EACH_BYTE,
    IGNORED,
    DenseGradient,
    LabelTarget,
    hidden_gradient,
    may_have_gradient,
    target_label_at,
    unequal_bytes,
)
from ..lanes import lowest_bit
from ..mesh.push_z import MIN_DELTA_Z
from .borders import front_at
from .forces import EllipsoidView
from .picture_forces import PictureForces, add_depth_force
from .silhouette import Silhouette, depth_of, in_box, inside_at


@wp.func
def is_nearest_of_label(silhouettes: wp.array[Silhouette], k: int, nearness: float, x: float, y: float):
    """True if no other ellipsoid of k's label is nearer there; of equal ones the lower index is."""
    label = silhouettes[k].label
    for j in range(silhouettes.shape[0]):
        if j != k and silhouettes[j].label == label and in_box(silhouettes[j], x, y):
            if inside_at(silhouettes[j], x, y) > 0.0:
                there = front_at(silhouettes[j], x, y)
                if there > nearness or (there == nearness and j < k):
                    return False
    return True


@wp.func
def depth_between(front: float, back: float, perspective: bool):
    """Distance in depth of two nearnesses [m], never 0."""
    return wp.max(depth_of(back, perspective) - depth_of(front, perspective), MIN_DELTA_Z)


@wp.func
def may_push_depths(g: LabelTarget, own: wp.uint32, shown: wp.uint32, expected: wp.uint32, label: int):
    """Highest bit of each of four pixels where a depth may matter: the ellipsoid hides the target, or is it and hidden.

    ``own`` are the bits of pixels that show the ellipsoid, ``shown`` the parts that pixels show.
    """
    wanted = unequal_bytes(expected, wp.uint32(label) * EACH_BYTE)
    some = unequal_bytes(expected, wp.uint32(0)) & unequal_bytes(expected, IGNORED)
    return (own & wanted & some) | (~own & ~wanted & unequal_bytes(shown, wp.uint32(0)))


@wp.func
def may_push_depths(g: DenseGradient, own: wp.uint32, shown: wp.uint32, expected: wp.uint32, label: int):
    """Highest bit of each of four pixels that show a part."""
    return unequal_bytes(shown, wp.uint32(0))


@wp.func
def first_with(silhouettes: wp.array[Silhouette], label: int):
    """Index of the first ellipsoid that shows a label, usually the label less 1; -1 if there is none."""
    count = silhouettes.shape[0]
    if label > 0 and label <= count:
        if silhouettes[label - 1].label == label:
            return label - 1
    for j in range(count):
        if silhouettes[j].label == label:
            return j
    return -1


@wp.func
def push_back(
    forces: PictureForces, view: EllipsoidView, j: int, at: int, x: float, y: float, depth_weight: float, gradient: Any
):
    """Force back where the ellipsoid shows at a pixel and hides ellipsoid j."""
    hidden = view.silhouettes[j]
    g = hidden_gradient(gradient, view.target, hidden.label, at)
    if g != 0.0:
        front = front_at(view.own, x, y)
        between = depth_between(front, front_at(hidden, x, y), view.scene.perspective)
        amount = depth_weight * g * wp.log(1.0 / between + 1.0)
        forces = add_depth_force(forces, view, x, y, front, amount)
    return forces


@wp.func
def push_behind(
    forces: PictureForces,
    view: EllipsoidView,
    row: int,
    column: int,
    depth_weight: float,
    distinct: bool,
    gradient: Any,
):
    """Force back where the ellipsoid, which shows at a pixel, hides another that should."""
    silhouettes = view.silhouettes
    at = row * view.width + column
    x = float(column) + 0.5
    y = float(row) + 0.5
    if distinct:
        j = first_with(silhouettes, target_label_at(gradient, view.target, at))
        if j >= 0 and j != view.k:
            if in_box(silhouettes[j], x, y) and inside_at(silhouettes[j], x, y) > 0.0:
                forces = push_back(forces, view, j, at, x, y, depth_weight, gradient)
        return forces
    for word in range((silhouettes.shape[0] + 31) // 32):
        # First find the hidden ones: for each thread they are others, but few, so that all push together.
        hidden = wp.uint32(0)
        for bit in range(wp.min(32, silhouettes.shape[0] - 32 * word)):
            j = 32 * word + bit
            other = silhouettes[j].label
            if (
                other != view.own.label
                and may_have_gradient(gradient, view.target, other, at)
                and in_box(silhouettes[j], x, y)
            ):
                if inside_at(silhouettes[j], x, y) > 0.0:
                    hidden |= wp.uint32(1) << wp.uint32(bit)
        while hidden != wp.uint32(0):
            j = 32 * word + lowest_bit(hidden)
            hidden &= hidden - wp.uint32(1)
            if is_nearest_of_label(silhouettes, j, front_at(silhouettes[j], x, y), x, y):
                forces = push_back(forces, view, j, at, x, y, depth_weight, gradient)
    return forces


@wp.func
def pull_forward(
    forces: PictureForces,
    view: EllipsoidView,
    row: int,
    column: int,
    depth_weight: float,
    distinct: bool,
    gradient: Any,
):
    """Force forward where the ellipsoid is hidden at a pixel that another shows."""
    s = view.own
    at = row * view.width + column
    front = view.silhouettes[int(view.parts[at]) - 1]
    x = float(column) + 0.5
    y = float(row) + 0.5
    if front.label != s.label and inside_at(s, x, y) > 0.0:
        g = hidden_gradient(gradient, view.target, s.label, at)
        if g != 0.0:
            back = front_at(s, x, y)
            if distinct or is_nearest_of_label(view.silhouettes, view.k, back, x, y):
                between = depth_between(front_at(front, x, y), back, view.scene.perspective)
                amount = -depth_weight * g * wp.log(1.0 / between + 1.0)
                forces = add_depth_force(forces, view, x, y, back, amount)
    return forces
