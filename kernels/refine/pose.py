"""Forward kinematics with one task a part: each walks its own ancestors up to the root, independent of all others."""

import warp as wp

from ..rotations import column, matrix_from_6d, matrix_from_axis_angle
from .state import Problem, State, has_bit, lens_of


@wp.func
def turn_part(problem: Problem, state: State, b: int, k: int):
    """Local rotation of part k, also as the prior's variable."""
    v = state.bodies.rotations[b, k]
    turn = (1.0 + 0.0 * (v[0] + v[1] + v[2])) * wp.identity(n=3, dtype=float)  # NaN of a locked part shows, too
    if not has_bit(problem.locked, k):
        turn = matrix_from_axis_angle(v)
    state.turns[b, k] = turn
    slot = problem.mixture.slots[k]
    if slot >= 0:
        state.likelihood.directions[b, slot] = v


@wp.func
def turn_body(problem: Problem, state: State, b: int):
    """Orientation of the body, also as the prior's variable, and its camera."""
    orientation = matrix_from_6d(state.bodies.orientation[b, 0], state.bodies.orientation[b, 1])
    state.orientations[b] = orientation
    up = problem.mixture.slots[problem.mixture.slots.shape[0] - 1]
    if up >= 0:
        # The camera's y is down.
        state.likelihood.directions[b, up] = -orientation[1]
    scale = wp.exp(state.bodies.log_scale[b])
    shift = state.bodies.shift[b]
    lens = lens_of(problem, b)
    root = wp.vec3(0.0)
    focal = scale
    centre = shift
    if lens[0] > 0.0:
        focal = lens[0]
        centre = wp.vec2(lens[1], lens[2])
        root = wp.vec3(shift[0] - centre[0], shift[1] - centre[1], focal) / scale
    state.roots[b] = root
    half_size = problem.half_size
    state.ellipsoids.camera[b] = half_size * wp.vec4(focal, focal, centre[0] + 1.0, centre[1] + 1.0)


@wp.func
def place_part(problem: Problem, state: State, b: int, k: int):
    """Ellipsoid of part k from the local rotations, as ``pose_bones`` has it."""
    rotation = state.turns[b, k]
    start = wp.vec3(0.0)  # from the pelvis
    above = problem.bones[k].parent
    while above >= 0:
        turn = state.turns[b, above]
        length = state.bodies.lengths[b, problem.bones[above].shape[0]]
        start = turn * (start + column(problem.bones[above].rest_axes, 0) * length)
        rotation = turn * rotation
        above = problem.bones[above].parent
    orientation = state.orientations[b]
    shape = problem.bones[k].shape
    thicknesses = state.bodies.thicknesses[b]
    semi_axes = 0.5 * wp.vec3(state.bodies.lengths[b, shape[0]], thicknesses[shape[1]], thicknesses[shape[2]])
    axes = orientation * rotation * problem.bones[k].rest_axes
    state.ellipsoids.axes[b, k] = axes
    state.ellipsoids.semi_axes[b, k] = semi_axes
    state.ellipsoids.centres[b, k] = state.roots[b] + orientation * start + semi_axes[0] * column(axes, 0)
