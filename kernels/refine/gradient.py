"""Gradient of every parameter from the forces on the parts.

The gradient of a bone's rotation is the torque of its subtree about the bone's start. A body's root counts as one more
bone, which turns the whole body.
"""

import warp as wp

from ..rotations import axis_angle_gradient, column, columns_gradient
from .prior import mixture_gradient
from .state import PRIOR, Load, Problem, State, has_bit

_DOWN = wp.constant(wp.vec3(0.0, 1.0, 0.0))  # camera frame


@wp.func
def sum_subtree(problem: Problem, state: State, b: int, bone: int):
    """Sum the forces on all that a bone moves."""
    num_parts = state.wrenches.shape[1]
    pivot = state.roots[b]
    if bone < num_parts:
        along = column(state.ellipsoids.axes[b, bone], 0)
        pivot = state.ellipsoids.centres[b, bone] - state.ellipsoids.semi_axes[b, bone][0] * along
    subtree = problem.bones[bone].subtree
    load = Load()
    for k in range(num_parts):
        wrench = state.wrenches[b, k]
        torque = wrench.torque + wp.cross(state.ellipsoids.centres[b, k] - pivot, wrench.force)
        # Selects, not branches, so that CUDA loads the next parts meanwhile.
        load.force += wp.where(has_bit(subtree, k), wrench.force, wp.vec3(0.0))
        load.torque += wp.where(has_bit(subtree, k), torque, wp.vec3(0.0))
    state.loads[b, bone] = load


@wp.func
def gather_rotation(problem: Problem, state: State, b: int, k: int):
    if not has_bit(problem.locked, k):
        # The global rotation is axes * rest_axes^T.
        torque = wp.transpose(state.ellipsoids.axes[b, k]) * state.loads[b, k].torque
        own = problem.bones[k].rest_axes * torque
        total = state.gradient.rotations[b, k] + axis_angle_gradient(state.bodies.rotations[b, k], own)
        slot = problem.mixture.slots[k]
        if slot >= 0:
            total += problem.weights[PRIOR] * mixture_gradient(state.likelihood, b, slot)
        state.gradient.rotations[b, k] = total


@wp.func
def gather_length(problem: Problem, state: State, b: int, i: int):
    """Gradient of length i, of one part or of two."""
    length = state.gradient.lengths[b, i]
    for part in range(state.wrenches.shape[1]):
        wrench = state.wrenches[b, part]
        # A longer bone moves its subtree by as much, and its own centre by half.
        carried = state.loads[b, part].force - 0.5 * wrench.force
        amount = wp.dot(carried, column(state.ellipsoids.axes[b, part], 0)) + 0.5 * wrench.semi_axes[0]
        length += wp.where(problem.bones[part].shape[0] == i, amount, 0.0)  # see ``sum_subtree``
    state.gradient.lengths[b, i] = length


@wp.func
def gather_thickness(problem: Problem, state: State, b: int, i: int):
    thickness = state.gradient.thicknesses[b, i]
    for part in range(state.wrenches.shape[1]):
        shape = problem.bones[part].shape
        semi_axes = state.wrenches[b, part].semi_axes
        thickness += wp.where(shape[1] == i, 0.5 * semi_axes[1], 0.0) + wp.where(shape[2] == i, 0.5 * semi_axes[2], 0.0)
    state.gradient.thicknesses[b, i] = thickness


@wp.func
def gather_orientation(problem: Problem, state: State, b: int):
    root = state.wrenches.shape[1]
    torque = state.loads[b, root].torque
    orientation = state.orientations[b]
    slot = problem.mixture.slots[root]
    if slot >= 0:
        torque += problem.weights[PRIOR] * wp.cross(_DOWN, orientation * mixture_gradient(state.likelihood, b, slot))
    columns = state.bodies.orientation[b]
    first, second = columns_gradient(columns[0], columns[1], orientation, torque)
    state.gradient.orientation[b, 0] = first
    state.gradient.orientation[b, 1] = second


@wp.func
def gather_camera(state: State, b: int):
    camera = wp.vec3(0.0)
    for k in range(state.wrenches.shape[1]):
        camera += state.wrenches[b, k].camera
    state.gradient.log_scale[b] = camera[0]
    state.gradient.shift[b] = wp.vec2(camera[1], camera[2])
