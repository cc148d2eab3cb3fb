"""Forward kinematics of EllipBody and its adjoint, written by hand: one thread a body, so nothing is added atomically.

``R_k = R_parent r_k``, ``end_k = start_k + l_k R_k O_k`` (paper, eq. 15, with O as a unit direction), the ellipsoid
sits on the bone's midpoint with axes ``A_k = R_k Q_k`` (bone, first thickness, second thickness). Every kernel exists
in float32 and float64; the second one is for tests by finite differences and for users who ask for it.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def pose_bones(
    parents: wp.array[int],  # (P,) parent bone, -1 = root
    shape_indices: wp.array[wp.vec3i],  # (P,) which length, first and second thickness a part uses
    rest_directions: wp.array[Any],  # (P,) vec3, unit
    rest_axes: wp.array[Any],  # (P,) mat33, columns: bone, first thickness, second thickness
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
    """Walk the tree from the root; parents come before their children in the part order."""
    b = wp.tid()
    joints[b, 0] = translation[b]
    for k in range(parents.shape[0]):
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


@wp.kernel
def pose_bones_adjoint(
    parents: wp.array[int],
    shape_indices: wp.array[wp.vec3i],
    rest_directions: wp.array[Any],
    rest_axes: wp.array[Any],
    global_orient: wp.array[Any],
    local_rotations: wp.array2d[Any],
    lengths: wp.array2d[Any],
    rotations: wp.array2d[Any],  # (B, P) mat33, global, from the forward pass
    adj_joints: wp.array2d[Any],  # (B, P + 1) vec3  MODIFIED: gathers what children send
    adj_rotations: wp.array2d[Any],  # (B, P) mat33  MODIFIED: likewise
    adj_centres: wp.array2d[Any],  # (B, P) vec3
    adj_axes: wp.array2d[Any],  # (B, P) mat33
    adj_semi_axes: wp.array2d[Any],  # (B, P) vec3
    grad_global_orient: wp.array[Any],  # (B,) mat33, zeroed  OUTPUT
    grad_translation: wp.array[Any],  # (B,) vec3  OUTPUT
    grad_local_rotations: wp.array2d[Any],  # (B, P) mat33  OUTPUT
    grad_lengths: wp.array2d[Any],  # (B, 12), zeroed  OUTPUT
    grad_thicknesses: wp.array2d[Any],  # (B, 15), zeroed  OUTPUT
):
    """Walk the tree from the leaves to the root, the transpose of ``pose_bones`` line by line."""
    b = wp.tid()
    for i in range(parents.shape[0]):
        k = parents.shape[0] - 1 - i
        parent = parents[k]
        shape = shape_indices[k]
        length = lengths[b, shape[0]]
        half = length.dtype(0.5)
        direction = rest_directions[k]
        rotation = rotations[b, k]

        adj_half_centre = adj_centres[b, k] * half
        adj_end = adj_joints[b, k + 1] + adj_half_centre
        adj_joints[b, parent + 1] = adj_joints[b, parent + 1] + adj_end + adj_half_centre

        adj_size = adj_semi_axes[b, k] * half
        grad_lengths[b, shape[0]] = grad_lengths[b, shape[0]] + wp.dot(adj_end, rotation * direction) + adj_size[0]
        grad_thicknesses[b, shape[1]] = grad_thicknesses[b, shape[1]] + adj_size[1]
        grad_thicknesses[b, shape[2]] = grad_thicknesses[b, shape[2]] + adj_size[2]

        adj_rotation = (
            adj_rotations[b, k] + wp.outer(adj_end, direction) * length + adj_axes[b, k] * wp.transpose(rest_axes[k])
        )
        to_parent = adj_rotation * wp.transpose(local_rotations[b, k])
        if parent >= 0:
            grad_local_rotations[b, k] = wp.transpose(rotations[b, parent]) * adj_rotation
            adj_rotations[b, parent] = adj_rotations[b, parent] + to_parent
        else:
            grad_local_rotations[b, k] = wp.transpose(global_orient[b]) * adj_rotation
            grad_global_orient[b] = grad_global_orient[b] + to_parent
    grad_translation[b] = adj_joints[b, 0]


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
    constants = [wp.array[int], wp.array[wp.vec3i], wp.array[vec], wp.array[mat]]
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
        bones: The first four arguments of ``pose_bones``.
        unit_vertices: The unit sphere's mesh, shape (N,), vec3.
    """

    bones: Sequence[wp.array]
    unit_vertices: wp.array


def launch_pose(tree: BoneTree, parameters: Sequence[wp.array], posed: Sequence[wp.array]) -> None:
    """Fill the ``posed`` bones, outputs of ``pose_bones``, from its inputs after the constants."""
    first = parameters[0]
    wp.launch(pose_bones, first.shape[0], [*tree.bones, *parameters], [*posed], device=first.device)


def launch_pose_adjoint(
    tree: BoneTree, saved: Sequence[wp.array], adjoints: Sequence[wp.array], gradients: Sequence[wp.array]
) -> None:
    """Fill zeroed ``gradients``; ``adjoints`` of joints and rotations are overwritten on the way."""
    first, inputs = saved[0], [*tree.bones, *saved, *adjoints]
    wp.launch(pose_bones_adjoint, first.shape[0], inputs, [*gradients], device=first.device)


def launch_vertices(tree: BoneTree, ellipsoids: Sequence[wp.array], vertices: wp.array) -> None:
    """Fill the mesh vertices of every ellipsoid from centres, axes and semi-axes."""
    wp.launch(place_vertices, vertices.shape, [tree.unit_vertices, *ellipsoids], [vertices], device=vertices.device)


def launch_vertices_adjoint(tree: BoneTree, inputs: Sequence[wp.array], gradients: Sequence[wp.array]) -> None:
    """Fill the gradients of centres, axes and semi-axes; ``inputs`` are axes, semi-axes and the vertices' adjoint."""
    axes = inputs[0]
    wp.launch(place_vertices_adjoint, axes.shape, [tree.unit_vertices, *inputs], [*gradients], device=axes.device)
