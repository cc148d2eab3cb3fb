"""What each part costs: keypoints, joint limits, sizes, depth and the renderer's share, and the forces that follow.

Whatever pulls on a part ends as a force, a torque about its centre and a gradient of its semi-axes.
"""

import warp as wp

from ..ellipsoids.forces import SurfaceForces, add_force, add_shares
from .state import (
    DEPTH,
    LENGTH,
    LIMITS,
    PROJ,
    SEG,
    THICKNESS,
    Drawn,
    Ellipsoids,
    Landmark,
    Problem,
    Pull,
    State,
    Terms,
    Wrench,
    has_bit,
)

_MILLIMETRES = wp.constant(1000.0)


@wp.func
def surface_point(ellipsoids: Ellipsoids, b: int, k: int, normalised: wp.vec3):
    """A point of part k in the camera frame [m]."""
    return ellipsoids.centres[b, k] + ellipsoids.axes[b, k] * wp.cw_mul(ellipsoids.semi_axes[b, k], normalised)


@wp.func
def landmark_position(landmark: Landmark, ellipsoids: Ellipsoids, b: int):
    """Camera frame [m]."""
    first = surface_point(ellipsoids, b, landmark.parts[0], landmark.first)
    second = surface_point(ellipsoids, b, landmark.parts[1], landmark.second)
    return landmark.shares[0] * first + landmark.shares[1] * second


@wp.func
def slope_of_abs(x: float):
    """0 at 0, unlike ``wp.sign``."""
    return wp.where(x > 0.0, 1.0, wp.where(x < 0.0, -1.0, 0.0))


@wp.func
def pull_landmark(problem: Problem, state: State, b: int, index: int):
    """How a landmark is drawn to where it is seen."""
    pull = Pull()
    row = b % problem.landmarks.votes.shape[0]
    vote = problem.weights.proj * problem.landmarks.votes[row, index]
    if vote > 0.0:
        scale = wp.exp(state.bodies.log_scale[b])
        position = landmark_position(problem.landmarks.landmarks[index], state.ellipsoids, b)
        flat = wp.vec2(position[0], position[1])
        miss = scale * flat + state.bodies.shift[b] - problem.landmarks.points[row, index]
        slope = vote * wp.vec2(slope_of_abs(miss[0]), slope_of_abs(miss[1]))
        pull.cost = vote * (wp.abs(miss[0]) + wp.abs(miss[1]))
        pull.force = scale * wp.vec3(slope[0], slope[1], 0.0)
        pull.camera = wp.vec3(scale * wp.dot(slope, flat), slope[0], slope[1])
    state.pulls[b, index] = pull


@wp.func
def depth_deviation(problem: Problem, state: State, b: int, k: int):
    """How much farther away than it should be part k is [mm]."""
    row = b % problem.rules.depths.shape[0]
    return (state.ellipsoids.centres[b, k][2] - problem.rules.depths[row, k]) * _MILLIMETRES


@wp.func
def cost_rules(problem: Problem, state: State, drawn: Drawn, b: int, k: int):
    """What part k, length k and thickness k cost wherever they are, its share of L_seg, and these rules' gradient."""
    weights = problem.weights
    cost = Terms()
    for i in range(k, drawn.loss.shape[1], state.costs.shape[1]):
        cost[SEG] += weights.seg * drawn.loss[b, i]
    excess = wp.vec3(0.0)
    if not has_bit(problem.skeleton.locked, k):
        v = state.bodies.rotations[b, k]
        lower, upper = problem.rules.lower_limits[k], problem.rules.upper_limits[k]
        excess = wp.max(v - upper, wp.vec3(0.0)) - wp.max(lower - v, wp.vec3(0.0))
    cost[LIMITS] = weights.limits * wp.dot(excess, excess)
    state.gradient.rotations[b, k] = 2.0 * weights.limits * excess
    row = b % problem.rules.usual_lengths.shape[0]
    if k < state.bodies.lengths.shape[1]:
        deviation = (state.bodies.lengths[b, k] - problem.rules.usual_lengths[row, k]) * _MILLIMETRES
        cost[LENGTH] = weights.length * deviation * deviation
        state.gradient.lengths[b, k] = 2.0 * weights.length * deviation * _MILLIMETRES
    if k < state.bodies.thicknesses.shape[1]:
        deviation = (state.bodies.thicknesses[b, k] - problem.rules.usual_thicknesses[row, k]) * _MILLIMETRES
        cost[THICKNESS] = weights.thickness * deviation * deviation
        state.gradient.thicknesses[b, k] = 2.0 * weights.thickness * deviation * _MILLIMETRES
    off = depth_deviation(problem, state, b, k)
    cost[DEPTH] = weights.depth * off * off
    state.costs[b, k] = cost


@wp.func
def add_drawn(problem: Problem, state: State, drawn: Drawn, b: int, i: int):
    """One of the numbers that make up the renderer's forces on the parts."""
    k = i // state.drawn.shape[2]
    number = i - k * state.drawn.shape[2]
    state.drawn[b, k, number] = problem.weights.seg * add_shares(drawn.forces, b, k, number)


@wp.func
def sum_forces(problem: Problem, state: State, b: int, k: int):
    """The renderer's, the landmarks' and the depth's forces on part k, and what the landmarks cost."""
    scale = wp.exp(state.bodies.log_scale[b])
    camera = state.ellipsoids.camera[b]
    half_size = camera[0] / scale
    seen = state.drawn[b, k]
    sums = SurfaceForces()
    for i in range(3):
        sums.force[i] = seen[i]
        for j in range(3):
            sums.moment[i, j] = seen[3 + 3 * i + j]
    to_camera = half_size * wp.vec3((seen[12] + seen[13]) * scale, seen[14], seen[15])
    cost = float(0.0)
    for i in range(problem.landmarks.first_touch[k], problem.landmarks.first_touch[k + 1]):
        touch = problem.landmarks.touches[i]
        pull = state.pulls[b, touch.landmark]
        sums = add_force(sums, touch.share * pull.force, touch.normalised)
        if touch.counts == 1:
            cost += pull.cost
            to_camera += pull.camera
    state.costs[b, k][PROJ] = cost
    sums.force[2] += 2.0 * problem.weights.depth * depth_deviation(problem, state, b, k) * _MILLIMETRES

    axes = state.ellipsoids.axes[b, k]
    turning = sums.moment * wp.diag(state.ellipsoids.semi_axes[b, k]) * wp.transpose(axes)  # sum of F (X - c)^T
    wrench = Wrench()
    wrench.force = sums.force
    wrench.torque = wp.vec3(turning[2, 1] - turning[1, 2], turning[0, 2] - turning[2, 0], turning[1, 0] - turning[0, 1])
    wrench.semi_axes = wp.get_diag(wp.transpose(axes) * sums.moment)
    wrench.camera = to_camera
    state.wrenches[b, k] = wrench
