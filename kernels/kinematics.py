"""Forward kinematics of EllipBody and its adjoint, written by hand: a bone gathers, so nothing is added atomically.

``R_k = R_parent r_k``, ``end_k = start_k + l_k R_k O_k`` (paper, eq. 15, with O as a unit direction), the ellipsoid
sits on the bone's midpoint with axes ``A_k = R_k Q_k`` (bone, first thickness, second thickness). Every kernel exists
in float32 and float64; the second one is for tests by finite differences and for users who ask for it.

No bone waits for another one: forward each walks its own way to the root. Back, a change of ``r_k`` moves a subtree;
each part of it has walked up before, and left for every bone on its way what its own adjoint means there. That holds of
any matrices, rotations or not.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple, Self

import warp as wp

from .lanes import num_lanes, wait_for_block

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
    """Place a bone: one thread each."""
    thread = wp.tid()
    b = thread // parents.shape[0]
    k = thread - b * parents.shape[0]
    rotation = local_rotations[b, k]
    start = rest_directions[k] * lengths.dtype(0.0)
    above = parents[k]
    while above >= 0:
        turn = local_rotations[b, above]
        start = turn * (start + rest_directions[above] * lengths[b, shape_indices[above][0]])
        rotation = turn * rotation
        above = parents[above]
    rotation = global_orient[b] * rotation
    start = translation[b] + global_orient[b] * start
    shape = shape_indices[k]
    length = lengths[b, shape[0]]
    half = length.dtype(0.5)
    end = start + (rotation * rest_directions[k]) * length
    if k == 0:
        joints[b, 0] = translation[b]
    joints[b, k + 1] = end
    rotations[b, k] = rotation
    centres[b, k] = (start + end) * half
    axes[b, k] = rotation * rest_axes[k]
    size = joints.dtype(length, thicknesses[b, shape[1]], thicknesses[b, shape[2]])
    semi_axes[b, k] = size * half


@wp.kernel(grid_stride=False)
def pose_bones_adjoint(
    parents: wp.array[int],
    shape_indices: wp.array[wp.vec3i],
    rest_directions: wp.array[Any],
    rest_axes: wp.array[Any],
    levels: wp.array[int],  # (P,) number of bones above
    subtrees: wp.array[int],  # (P,) bit j: part j moves with the bone
    global_orient: wp.array[Any],
    local_rotations: wp.array2d[Any],
    lengths: wp.array2d[Any],
    rotations: wp.array2d[Any],  # (B, P) mat33, global, from the forward pass
    adj_joints: wp.array2d[Any],  # (B, P + 1) vec3
    adj_rotations: wp.array2d[Any],  # (B, P) mat33
    adj_centres: wp.array2d[Any],  # (B, P) vec3
    adj_axes: wp.array2d[Any],  # (B, P) mat33
    adj_semi_axes: wp.array2d[Any],  # (B, P) vec3
    left: wp.array3d[Any],  # (B, P, levels + 1) mat33  SCRATCH what each part leaves on its way up
    shares: wp.array2d[Any],  # (B, P) of the lengths' gradient  SCRATCH
    grad_global_orient: wp.array[Any],  # (B,) mat33  OUTPUT
    grad_translation: wp.array[Any],  # (B,) vec3  OUTPUT
    grad_local_rotations: wp.array2d[Any],  # (B, P) mat33  OUTPUT
    grad_lengths: wp.array2d[Any],  # (B, 12)  OUTPUT
    grad_thicknesses: wp.array2d[Any],  # (B, 15)  OUTPUT
):
    """Push a body: a warp on CUDA, whose threads share bones and sizes."""
    thread = wp.tid()
    b = thread // wp.block_dim()
    lane = thread - b * wp.block_dim()
    num_parts = parents.shape[0]
    half = lengths.dtype(0.5)

    for k in range(lane, num_parts, wp.block_dim()):
        # The bone's end moves all that hangs on it, and half of its own ellipsoid.
        adj_end = adj_joints[b, k + 1] + adj_centres[b, k] * half
        moved = subtrees[k] & ~(1 << k)
        for j in range(num_parts):
            pulls = adj_joints[b, j + 1] + adj_centres[b, j]
            adj_end = adj_end + pulls * wp.where((moved >> j) & 1 == 1, lengths.dtype(1.0), lengths.dtype(0.0))
        direction = rest_directions[k]
        length = lengths[b, shape_indices[k][0]]
        shares[b, k] = wp.dot(adj_end, rotations[b, k] * direction) + adj_semi_axes[b, k][0] * half
        adjoint = (
            adj_rotations[b, k] + wp.outer(adj_end, direction) * length + adj_axes[b, k] * wp.transpose(rest_axes[k])
        )
        bone = int(k)
        step = int(0)
        while bone >= 0:
            left[b, k, step] = adjoint
            adjoint = adjoint * wp.transpose(local_rotations[b, bone])
            bone = parents[bone]
            step += 1
        left[b, k, step] = adjoint
    wait_for_block()

    for k in range(lane, num_parts + 1, wp.block_dim()):
        root = k == num_parts
        mask = int(-1)
        level = int(-1)
        if not root:
            mask = subtrees[k]
            level = levels[k]
        adjoint = global_orient[b] * lengths.dtype(0.0)
        for j in range(num_parts):
            if (mask >> j) & 1 == 1:
                adjoint = adjoint + left[b, j, levels[j] - level]
        if root:
            pull = adj_joints[b, 0]
            for j in range(num_parts):
                pull = pull + adj_joints[b, j + 1] + adj_centres[b, j]
            grad_translation[b] = pull
            grad_global_orient[b] = adjoint
        else:
            above = global_orient[b]
            if parents[k] >= 0:
                above = rotations[b, parents[k]]
            grad_local_rotations[b, k] = wp.transpose(above) * adjoint
    for i in range(lane, grad_lengths.shape[1], wp.block_dim()):
        total = lengths.dtype(0.0)
        for k in range(num_parts):
            if shape_indices[k][0] == i:
                total = total + shares[b, k]
        grad_lengths[b, i] = total
    for i in range(lane, grad_thicknesses.shape[1], wp.block_dim()):
        total = lengths.dtype(0.0)
        for k in range(num_parts):
            shape = shape_indices[k]
            if shape[1] == i:
                total = total + adj_semi_axes[b, k][1] * half
            if shape[2] == i:
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
    """Deform the unit sphere's mesh into each ellipsoid (the paper's E, eq. 14); NaN if a size is 0 or less."""
    b, k, n = wp.tid()
    size = semi_axes[b, k]
    zero = size.dtype(0.0)
    if not (size[0] > zero and size[1] > zero and size[2] > zero):
        size = size * size.dtype(wp.nan)
    vertices[b, k, n] = centres[b, k] + axes[b, k] * wp.cw_mul(size, unit_vertices[n])


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
    trees = [*constants, wp.array[int], wp.array[int]]
    v1, m1, v2, m2, s2 = wp.array[vec], wp.array[mat], wp.array2d[vec], wp.array2d[mat], wp.array2d[scalar]
    wp.overload(pose_bones, [*constants, m1, v1, m2, s2, s2, v2, m2, v2, m2, v2])
    scratch = [wp.array3d[mat], s2]
    wp.overload(pose_bones_adjoint, [*trees, m1, m2, s2, m2, v2, m2, v2, m2, v2, *scratch, m1, v1, m2, s2, s2])
    wp.overload(place_vertices, [v1, v2, m2, v2, wp.array3d[vec]])
    wp.overload(place_vertices_adjoint, [v1, m2, v2, wp.array3d[vec], v2, m2, v2])


_register(wp.vec3f, wp.mat33f, wp.float32)
_register(wp.vec3d, wp.mat33d, wp.float64)


_FEW = 32  # threads a block where a launch has few: more blocks, so more of the GPU, share them


class BoneTree(NamedTuple):
    """Constant arrays that the kernels read, on one device and in one precision.

    Attributes:
        bones: The first six arguments of ``pose_bones_adjoint``, of which ``pose_bones`` takes four.
        num_levels: Bones in the longest chain.
        unit_vertices: The unit sphere's mesh, shape (N,), vec3.
    """

    bones: Sequence[wp.array]
    num_levels: int
    unit_vertices: wp.array


def launch_pose(tree: BoneTree, parameters: Sequence[wp.array], posed: Sequence[wp.array]) -> None:
    """Fill the ``posed`` bones, outputs of ``pose_bones``, from its inputs after the constants."""
    rotations = parameters[2]
    inputs = [*tree.bones[:4], *parameters]
    wp.launch(pose_bones, rotations.size, inputs, [*posed], device=rotations.device, block_dim=_FEW)


class PoseScratch(NamedTuple):
    """Scratch of ``pose_bones_adjoint``."""

    left: wp.array
    shares: wp.array

    @classmethod
    def empty(cls, tree: BoneTree, batch: int) -> Self:
        """Allocate for B bodies."""
        parents, axes, device = tree.bones[0], tree.bones[3], tree.bones[0].device
        shape = batch, parents.shape[0]
        left = wp.empty((*shape, tree.num_levels + 1), dtype=axes.dtype, device=device)
        return cls(left, wp.empty(shape, dtype=axes.dtype._wp_scalar_type_, device=device))


def launch_pose_adjoint(
    tree: BoneTree,
    saved: Sequence[wp.array],
    adjoints: Sequence[wp.array],
    gradients: Sequence[wp.array],
    scratch: PoseScratch,
) -> None:
    """Fill ``gradients`` from the adjoints of what ``launch_pose`` filled."""
    batch, device = gradients[0].shape[0], gradients[0].device
    lanes = num_lanes(device)
    inputs = [*tree.bones, *saved, *adjoints, *scratch]
    wp.launch(pose_bones_adjoint, batch * lanes, inputs, [*gradients], device=device, block_dim=lanes)


def launch_vertices(tree: BoneTree, ellipsoids: Sequence[wp.array], vertices: wp.array) -> None:
    """Fill the mesh vertices of every ellipsoid from centres, axes and semi-axes."""
    wp.launch(place_vertices, vertices.shape, [tree.unit_vertices, *ellipsoids], [vertices], device=vertices.device)


def launch_vertices_adjoint(tree: BoneTree, inputs: Sequence[wp.array], gradients: Sequence[wp.array]) -> None:
    """Fill the gradients of centres, axes and semi-axes; ``inputs`` are axes, semi-axes and the vertices' adjoint."""
    axes = inputs[0]
    wp.launch(place_vertices_adjoint, axes.shape, [tree.unit_vertices, *inputs], [*gradients], device=axes.device)
