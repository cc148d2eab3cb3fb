"""Forward kinematics of EllipBody and its adjoint, written by hand: a bone gathers, so nothing is added atomically.

On CUDA a warp works on a body, its threads on the bones of one level of the tree after the other.

``R_k = R_parent r_k``, ``end_k = start_k + l_k R_k O_k`` (paper, eq. 15, with O as a unit direction), the ellipsoid
sits on the bone's midpoint with axes ``A_k = R_k Q_k`` (bone, first thickness, second thickness). Every kernel exists
in float32 and float64; the second one is for tests by finite differences and for users who ask for it.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import warp as wp

from .lanes import num_lanes, wait_for_block

wp.set_module_options({"enable_backward": False})


@wp.kernel(grid_stride=False)
def pose_bones(
    parents: wp.array[int],  # (P,) parent bone, -1 = root
    levels: wp.array[int],  # (P,) number of bones above
    shape_indices: wp.array[wp.vec3i],  # (P,) which length, first and second thickness a part uses
    rest_directions: wp.array[Any],  # (P,) vec3, unit
    rest_axes: wp.array[Any],  # (P,) mat33, columns: bone, first thickness, second thickness
    num_levels: int,
    global_orient: wp.array[Any],  # (B,) mat33
    translation: wp.array[Any],  # (B,) vec3 [m]
    local_rotations: wp.array2d[Any],  # (B, P) mat33
    lengths: wp.array2d[Any],  # (B, 12) [m]
    thicknesses: wp.array2d[Any],  # (B, 15) [m]
    joints: wp.array2d[Any],  # (B, P + 1) vec3 [m]  OUTPUT
    rotations: wp.array2d[Any],  # (B, P) mat33, global  OUTPUT
    centres: wp.array2d[Any],  # (B, P) vec3 [m]  OUTPUT
    axes: wp.array2d[Any],  # (B, P) mat33, columns  OUTPUT
    semi_axes: wp.array2d[Any],  # (B, P) vec3 [m]  OUTPUT
):
    """Walk the tree from the root, level by level."""
    thread = wp.tid()
    b = thread // wp.block_dim()
    lane = thread - b * wp.block_dim()
    if lane == 0:
        joints[b, 0] = translation[b]
    for level in range(num_levels):
        wait_for_block()
        for k in range(lane, parents.shape[0], wp.block_dim()):
            if levels[k] == level:
                parent = parents[k]
                parent_rotation = global_orient[b]
                if parent >= 0:
                    parent_rotation = rotations[b, parent]
                rotation = parent_rotation * local_rotations[b, k]
                shape = shape_indices[k]
                length = lengths[b, shape[0]]
                half = length.dtype(0.5)
                start = joints[b, parent + 1]
                end = start + (rotation * rest_directions[k]) * length
                joints[b, k + 1] = end
                rotations[b, k] = rotation
                centres[b, k] = (start + end) * half
                axes[b, k] = rotation * rest_axes[k]
                size = joints.dtype(length, thicknesses[b, shape[1]], thicknesses[b, shape[2]])
                semi_axes[b, k] = size * half


@wp.kernel(grid_stride=False)
def pose_bones_adjoint(
    parents: wp.array[int],
    levels: wp.array[int],
    shape_indices: wp.array[wp.vec3i],
    rest_directions: wp.array[Any],
    rest_axes: wp.array[Any],
    num_levels: int,
    global_orient: wp.array[Any],
    local_rotations: wp.array2d[Any],
    lengths: wp.array2d[Any],
    rotations: wp.array2d[Any],  # (B, P) mat33, global, from the forward pass
    adj_joints: wp.array2d[Any],  # (B, P + 1) vec3  MODIFIED: [b, k + 1] becomes the adjoint of bone k's end
    adj_rotations: wp.array2d[Any],  # (B, P) mat33  MODIFIED: becomes what a bone sends to its parent
    adj_centres: wp.array2d[Any],  # (B, P) vec3
    adj_axes: wp.array2d[Any],  # (B, P) mat33
    adj_semi_axes: wp.array2d[Any],  # (B, P) vec3
    grad_global_orient: wp.array[Any],  # (B,) mat33  OUTPUT
    grad_translation: wp.array[Any],  # (B,) vec3  OUTPUT
    grad_local_rotations: wp.array2d[Any],  # (B, P) mat33  OUTPUT
    grad_lengths: wp.array2d[Any],  # (B, 12)  OUTPUT
    grad_thicknesses: wp.array2d[Any],  # (B, 15)  OUTPUT
):
    """Walk the tree from the leaves to the root, the transpose of ``pose_bones``; a bone gathers from its children."""
    thread = wp.tid()
    b = thread // wp.block_dim()
    lane = thread - b * wp.block_dim()
    num_parts = parents.shape[0]
    half = lengths.dtype(0.5)
    for i in range(num_levels + 1):
        wait_for_block()
        level = num_levels - 1 - i  # -1: the root
        for k in range(lane - 1, num_parts, wp.block_dim()):
            if (k < 0 and level < 0) or (k >= 0 and levels[wp.max(k, 0)] == level):
                adj_end = adj_joints[b, k + 1]
                adj_rotation = global_orient[b] * lengths.dtype(0.0)
                if k >= 0:
                    adj_rotation = adj_rotations[b, k]
                for n in range(num_parts):
                    child = num_parts - 1 - n
                    if parents[child] == k:
                        adj_end = adj_end + adj_joints[b, child + 1] + adj_centres[b, child] * half
                        adj_rotation = adj_rotation + adj_rotations[b, child]
                if k < 0:
                    grad_translation[b] = adj_end
                    grad_global_orient[b] = adj_rotation
                else:
                    adj_end = adj_end + adj_centres[b, k] * half
                    length = lengths[b, shape_indices[k][0]]
                    adj_rotation = (
                        adj_rotation
                        + wp.outer(adj_end, rest_directions[k]) * length
                        + adj_axes[b, k] * wp.transpose(rest_axes[k])
                    )
                    parent_rotation = global_orient[b]
                    if parents[k] >= 0:
                        parent_rotation = rotations[b, parents[k]]
                    grad_local_rotations[b, k] = wp.transpose(parent_rotation) * adj_rotation
                    adj_joints[b, k + 1] = adj_end
                    adj_rotations[b, k] = adj_rotation * wp.transpose(local_rotations[b, k])
    for i in range(lane, grad_lengths.shape[1], wp.block_dim()):
        total = lengths.dtype(0.0)
        for n in range(num_parts):
            k = num_parts - 1 - n
            if shape_indices[k][0] == i:
                along = rotations[b, k] * rest_directions[k]
                total = total + wp.dot(adj_joints[b, k + 1], along) + adj_semi_axes[b, k][0] * half
        grad_lengths[b, i] = total
    for i in range(lane, grad_thicknesses.shape[1], wp.block_dim()):
        total = lengths.dtype(0.0)
        for n in range(num_parts):
            k = num_parts - 1 - n
            if shape_indices[k][1] == i:
                total = total + adj_semi_axes[b, k][1] * half
            if shape_indices[k][2] == i:
                total = total + adj_semi_axes[b, k][2] * half
        grad_thicknesses[b, i] = total


@wp.kernel
def place_vertices(
    unit_vertices: wp.array[Any],  # (N,) vec3 on the unit sphere
    centres: wp.array2d[Any],  # (B, P) vec3 [m]
    axes: wp.array2d[Any],  # (B, P) mat33
    semi_axes: wp.array2d[Any],  # (B, P) vec3 [m]
    vertices: wp.array3d[Any],  # (B, P, N) vec3 [m]  OUTPUT
):
    """Deform the unit sphere's mesh into each ellipsoid (the paper's E, eq. 14)."""
    b, k, n = wp.tid()
    vertices[b, k, n] = centres[b, k] + axes[b, k] * wp.cw_mul(semi_axes[b, k], unit_vertices[n])


@wp.kernel
def place_vertices_adjoint(
    unit_vertices: wp.array[Any],
    axes: wp.array2d[Any],
    semi_axes: wp.array2d[Any],
    adj_vertices: wp.array3d[Any],  # (B, P, N) vec3
    grad_centres: wp.array2d[Any],  # (B, P) vec3  OUTPUT
    grad_axes: wp.array2d[Any],  # (B, P) mat33  OUTPUT
    grad_semi_axes: wp.array2d[Any],  # (B, P) vec3  OUTPUT
):
    """Adjoint of ``place_vertices``: one thread an ellipsoid sums over its own vertices, in a fixed order."""
    b, k = wp.tid()
    size = semi_axes[b, k]
    unrotate = wp.transpose(axes[b, k])
    sum_centre = size * size.dtype(0.0)
    sum_axes = unrotate * size.dtype(0.0)
    sum_size = size * size.dtype(0.0)
    for n in range(unit_vertices.shape[0]):
        unit = unit_vertices[n]
        adj = adj_vertices[b, k, n]
        sum_centre += adj
        sum_axes += wp.outer(adj, wp.cw_mul(size, unit))
        sum_size += wp.cw_mul(unrotate * adj, unit)
    grad_centres[b, k] = sum_centre
    grad_axes[b, k] = sum_axes
    grad_semi_axes[b, k] = sum_size


def _register(vec: type, mat: type, scalar: type) -> None:
    """Register one precision up front: an overload that appears later would compile the module again."""
    constants = [wp.array[int], wp.array[int], wp.array[wp.vec3i], wp.array[vec], wp.array[mat], int]
    v1, m1, v2, m2, s2 = wp.array[vec], wp.array[mat], wp.array2d[vec], wp.array2d[mat], wp.array2d[scalar]
    wp.overload(pose_bones, [*constants, m1, v1, m2, s2, s2, v2, m2, v2, m2, v2])
    wp.overload(pose_bones_adjoint, [*constants, m1, m2, s2, m2, v2, m2, v2, m2, v2, m1, v1, m2, s2, s2])
    wp.overload(place_vertices, [v1, v2, m2, v2, wp.array3d[vec]])
    wp.overload(place_vertices_adjoint, [v1, m2, v2, wp.array3d[vec], v2, m2, v2])


_register(wp.vec3f, wp.mat33f, wp.float32)
_register(wp.vec3d, wp.mat33d, wp.float64)


class BoneTree(NamedTuple):
    """Constant arrays that the kernels read, on one device and in one precision.

    Attributes:
        bones: The first six arguments of ``pose_bones``.
        unit_vertices: The unit sphere's mesh, shape (N,), vec3.
    """

    bones: Sequence[Any]
    unit_vertices: wp.array


def launch_pose(tree: BoneTree, parameters: Sequence[wp.array], posed: Sequence[wp.array]) -> None:
    """Fill the ``posed`` bones, outputs of ``pose_bones``, from its inputs after the constants."""
    _launch(pose_bones, [*tree.bones, *parameters], posed)


def launch_pose_adjoint(
    tree: BoneTree, saved: Sequence[wp.array], adjoints: Sequence[wp.array], gradients: Sequence[wp.array]
) -> None:
    """Fill ``gradients``; ``adjoints`` of joints and rotations are overwritten on the way."""
    _launch(pose_bones_adjoint, [*tree.bones, *saved, *adjoints], gradients)


def _launch(kernel: wp.Kernel, inputs: Sequence[Any], outputs: Sequence[wp.array]) -> None:
    batch, device = outputs[0].shape[0], outputs[0].device
    lanes = num_lanes(device)
    wp.launch(kernel, batch * lanes, inputs, outputs, device=device, block_dim=lanes)


def launch_vertices(tree: BoneTree, ellipsoids: Sequence[wp.array], vertices: wp.array) -> None:
    """Fill the mesh vertices of every ellipsoid from centres, axes and semi-axes."""
    wp.launch(place_vertices, vertices.shape, [tree.unit_vertices, *ellipsoids], [vertices], device=vertices.device)


def launch_vertices_adjoint(tree: BoneTree, inputs: Sequence[wp.array], gradients: Sequence[wp.array]) -> None:
    """Fill the gradients of centres, axes and semi-axes; ``inputs`` are axes, semi-axes and the vertices' adjoint."""
    axes = inputs[0]
    wp.launch(place_vertices_adjoint, axes.shape, [tree.unit_vertices, *inputs], [*gradients], device=axes.device)
