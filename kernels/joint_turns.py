"""Joints that are turned further by rotation vectors: ``R exp(v)``, and the gradient with respect to ``v``."""

from collections.abc import Sequence

import warp as wp

from .rotations import axis_angle_gradient, column, matrix_from_axis_angle

wp.set_module_options({"enable_backward": False})


@wp.kernel
def turn_free_joints(
    rotations: wp.array2d[wp.mat33],  # (B, J) local
    joints: wp.array[wp.int64],  # (N,) those that turn
    turns: wp.array2d[wp.vec3],  # (B, N) rotation vectors [rad]
    turned: wp.array2d[wp.mat33],  # (B, J)  OUTPUT
):
    """One thread a joint of a body."""
    b, k = wp.tid()
    rotation = rotations[b, k]
    for n in range(joints.shape[0]):
        if int(joints[n]) == k:
            rotation = rotation * matrix_from_axis_angle(turns[b, n])
    turned[b, k] = rotation


@wp.kernel
def turn_free_joints_adjoint(
    rotations: wp.array2d[wp.mat33],
    joints: wp.array[wp.int64],
    turns: wp.array2d[wp.vec3],
    adj_turned: wp.array2d[wp.mat33],  # (B, J)
    grad_turns: wp.array2d[wp.vec3],  # (B, N)  OUTPUT
):
    """One thread a turn of a body."""
    b, n = wp.tid()
    k = int(joints[n])
    turn = matrix_from_axis_angle(turns[b, n])
    adjoint = wp.transpose(rotations[b, k]) * adj_turned[b, k]
    torque = wp.vec3()
    for i in range(3):
        torque += wp.cross(column(turn, i), column(adjoint, i))
    grad_turns[b, n] = axis_angle_gradient(turns[b, n], wp.transpose(turn) * torque)


def launch_joint_turns(inputs: Sequence[wp.array], turned: wp.array) -> None:
    """Fill ``turned`` from rotations, joints and turns."""
    wp.launch(turn_free_joints, turned.shape, [*inputs, turned], device=turned.device)


def launch_joint_turns_adjoint(inputs: Sequence[wp.array], adjoint: wp.array, gradient: wp.array) -> None:
    """Fill the ``gradient`` with respect to the turns from the ``adjoint`` of what ``launch_joint_turns`` filled."""
    wp.launch(turn_free_joints_adjoint, gradient.shape, [*inputs, adjoint, gradient], device=gradient.device)
