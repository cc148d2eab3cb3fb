"""Kernels from joints at rest to bones, and from posed joints to the maps that carry skin, with their adjoints.

All exist in single and in double precision.

A joint's map is ``[R | p - R c]``: it carries the joint's place ``c`` at rest to its place ``p``.
"""

from collections.abc import Sequence
from typing import Any

import warp as wp

from .joint_chain import DOUBLE, SINGLE, JointTree, JointTypes

wp.set_module_options({"enable_backward": False})


@wp.kernel
def find_bones(
    tree: JointTree,
    translation: wp.array[Any],  # (B,) vec3, of the root
    rest: wp.array2d[Any],  # (B, J) vec3, joints at rest
    bones: wp.array2d[Any],  # (B, J) vec3, from the parent; of the root, its place  OUTPUT
):
    """One thread a joint of a body."""
    b, k = wp.tid()
    above = tree.parents[k]
    bone = translation[b]
    if above >= 0:
        bone = rest[b, k] - rest[b, above]
    bones[b, k] = bone


@wp.kernel
def find_bones_adjoint(
    tree: JointTree,
    adj_bones: wp.array2d[Any],  # (B, J) vec3
    grad_translation: wp.array[Any],  # (B,) vec3  OUTPUT
    grad_rest: wp.array2d[Any],  # (B, J) vec3  MODIFIED: added to
):
    """One thread a joint of a body."""
    b, k = wp.tid()
    pull = adj_bones[b, k]
    gradient = grad_rest[b, k]
    if tree.parents[k] >= 0:
        gradient = gradient + pull
    else:
        grad_translation[b] = pull
    for c in range(tree.first_child[k], tree.first_child[k + 1]):
        gradient = gradient - adj_bones[b, tree.children[c]]
    grad_rest[b, k] = gradient


@wp.kernel
def find_maps(
    transforms: wp.array2d[Any],  # (B, J) mat44
    rest: wp.array2d[Any],  # (B, J) vec3
    places: wp.array2d[Any],  # (B, J) vec3  OUTPUT
    maps: wp.array3d[Any],  # (B, 12, J) rows of each joint's 3 x 4 matrix, joints last  OUTPUT
):
    """One thread a joint of a body."""
    b, k = wp.tid()
    frame, start = transforms[b, k], rest[b, k]
    place = places.dtype(frame[0, 3], frame[1, 3], frame[2, 3])
    for i in range(3):
        for c in range(3):
            maps[b, 4 * i + c, k] = frame[i, c]
        maps[b, 4 * i + 3, k] = place[i] - (frame[i, 0] * start[0] + frame[i, 1] * start[1] + frame[i, 2] * start[2])
    places[b, k] = place


@wp.kernel
def find_maps_adjoint(
    transforms: wp.array2d[Any],
    rest: wp.array2d[Any],
    adj_transforms: wp.array2d[Any],  # (B, J) mat44
    adj_places: wp.array2d[Any],  # (B, J) vec3
    adj_maps: wp.array3d[Any],  # (B, 12, J)
    sums: wp.array2d[Any],  # (B, J) mat44, adjoint of the transforms with what maps and places add  OUTPUT
    grad_rest: wp.array2d[Any],  # (B, J) vec3  OUTPUT
):
    """One thread a joint of a body."""
    b, k = wp.tid()
    frame, start, pushed = transforms[b, k], rest[b, k], adj_transforms[b, k]
    gradient, total = start - start, pushed - pushed  # anew: to change what was loaded would change the array
    for i in range(3):
        pull = adj_maps[b, 4 * i + 3, k]
        total[i, 3] = pushed[i, 3] + pull + adj_places[b, k][i]
        for c in range(3):
            total[i, c] = pushed[i, c] + adj_maps[b, 4 * i + c, k] - pull * start[c]
            gradient[c] = gradient[c] - frame[i, c] * pull
    sums[b, k] = total
    grad_rest[b, k] = gradient


def _register(types: JointTypes) -> None:
    """Register one precision up front: an overload that appears later would compile the module again."""
    v, f, rows = wp.array2d[types.vec], wp.array2d[types.frame], wp.array3d[types.scalar]
    wp.overload(find_bones, [JointTree, wp.array[types.vec], v, v])
    wp.overload(find_bones_adjoint, [JointTree, v, wp.array[types.vec], v])
    wp.overload(find_maps, [f, v, v, rows])
    wp.overload(find_maps_adjoint, [f, v, f, v, rows, f, v])


_register(SINGLE)
_register(DOUBLE)


def launch_bones(tree: Any, translation: wp.array, rest: wp.array, bones: wp.array) -> None:
    """Fill ``bones``, which ``launch_chain`` takes."""
    wp.launch(find_bones, rest.shape, [tree, translation, rest, bones], device=rest.device)


def launch_bones_adjoint(tree: Any, adjoint: wp.array, grad_translation: wp.array, grad_rest: wp.array) -> None:
    """Fill ``grad_translation`` and add to ``grad_rest``, from the ``adjoint`` of the bones."""
    wp.launch(find_bones_adjoint, adjoint.shape, [tree, adjoint, grad_translation, grad_rest], device=adjoint.device)


def launch_maps(transforms: wp.array, rest: wp.array, places: wp.array, maps: wp.array) -> None:
    """Fill ``places`` and ``maps``."""
    wp.launch(find_maps, rest.shape, [transforms, rest, places, maps], device=rest.device)


def launch_maps_adjoint(
    transforms: wp.array, rest: wp.array, adjoints: Sequence[wp.array], sums: wp.array, grad_rest: wp.array
) -> None:
    """Fill ``sums``, which ``launch_chain_adjoint`` takes, and ``grad_rest``.

    ``adjoints`` are of transforms, places and maps.
    """
    inputs = [transforms, rest, *adjoints, sums, grad_rest]
    wp.launch(find_maps_adjoint, rest.shape, inputs, device=rest.device)
