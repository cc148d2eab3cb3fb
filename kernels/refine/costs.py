"""Costs of each part: keypoints, rules and the renderer's share, and the forces that follow.

The forces on a part are summed to a force, a torque about its centre and a gradient of its semi-axes.
"""

import warp as wp

from ..ellipsoids.forces import SurfaceForces, add_force
from ..mesh.screen import project_depth
from .rules import RULES
from .state import PROJ, SEG, Drawn, EllipsoidArrays, Problem, Pull, State, Terms, Wrench, lens_of


@wp.func
def surface_point(ellipsoids: EllipsoidArrays, b: int, k: int, normalised: wp.vec3):
    """A point of part k in the camera frame [m]."""
    return ellipsoids.centres[b, k] + ellipsoids.axes[b, k] * wp.cw_mul(ellipsoids.semi_axes[b, k], normalised)


@wp.func
def slope_of_abs(x: float):
    """Derivative of |x|: 0 at 0, unlike ``wp.sign``; NaN of NaN."""
    return wp.where(x > 0.0, 1.0, wp.where(x < 0.0, -1.0, 0.0 * x))


@wp.func
def pull_landmark(problem: Problem, state: State, b: int, index: int):
    """Cost and force of a landmark's distance from its keypoint."""
    pull = Pull()
    row = b % problem.landmarks.votes.shape[0]
    vote = problem.weights[PROJ] * problem.landmarks.votes[row, index]
    if vote > 0.0:
        scale = wp.exp(state.bodies.log_scale[b])
        landmark = problem.landmarks.landmarks[index]
        first = surface_point(state.ellipsoids, b, landmark.parts[0], landmark.first)
        second = surface_point(state.ellipsoids, b, landmark.parts[1], landmark.second)
        position = landmark.shares[0] * first + landmark.shares[1] * second
        flat = wp.vec2(position[0], position[1])
        lens = lens_of(problem, b)
        centre = state.bodies.shift[b]
        if lens[0] > 0.0:
            scale = lens[0] / project_depth(position[2])
            centre = wp.vec2(lens[1], lens[2])
        miss = scale * flat + centre - problem.landmarks.points[row, index]
        slope = vote * wp.vec2(slope_of_abs(miss[0]), slope_of_abs(miss[1]))
        pull.cost = vote * (wp.abs(miss[0]) + wp.abs(miss[1]))
        growing = scale * wp.dot(slope, flat)  # of the cost with the picture
        if lens[0] > 0.0:
            pull.force = wp.vec3(scale * slope[0], scale * slope[1], -growing / project_depth(position[2]))
        else:
            pull.force = scale * wp.vec3(slope[0], slope[1], 0.0)
            pull.camera = wp.vec3(growing, slope[0], slope[1])
    state.pulls[b, index] = pull


@wp.func
def no_costs(problem: Problem, state: State, b: int, k: int):
    return Terms()


def _and_rule(before: wp.Function, column: int, rule: wp.Function) -> wp.Function:
    """Costs so far and that of one more rule.

    A chain of functions, and no loop over ``wp.static(RULES[i])``, which Warp's cache of kernels does not look into: it
    would go on with the old kernel after a rule has changed.
    """

    @wp.func(name=f"cost_rules_{column}")
    def costs(problem: Problem, state: State, b: int, k: int):
        cost = before(problem, state, b, k)
        cost[column] = rule(problem, state, problem.weights[column], b, k)
        return cost

    return costs


cost_each_rule = no_costs
for _column, _rule in RULES:
    cost_each_rule = _and_rule(cost_each_rule, _column, _rule)


@wp.func
def cost_rules(problem: Problem, state: State, b: int, k: int):
    """Cost of part k by all ``RULES``, which begin its gradient."""
    state.gradient.rotations[b, k] = wp.vec3(0.0)
    if k < state.bodies.lengths.shape[1]:
        state.gradient.lengths[b, k] = 0.0
    if k < state.bodies.thicknesses.shape[1]:
        state.gradient.thicknesses[b, k] = 0.0
    state.pushes[b, k] = wp.vec3(0.0)
    state.costs[b, k] = cost_each_rule(problem, state, b, k)


@wp.func
def add_drawn(problem: Problem, state: State, drawn: Drawn, b: int, i: int):
    """Sum one of the 16 numbers of the renderer's forces on part k over its shares."""
    k = i // state.drawn.shape[2]
    number = i - k * state.drawn.shape[2]
    shares = drawn.forces[b, k]
    total = float(0.0)
    for share in range(shares.shape[0]):
        total += shares[share, number]
    state.drawn[b, k, number] = problem.weights[SEG] * total


@wp.func
def sum_forces(problem: Problem, state: State, b: int, k: int):
    """Sum the renderer's, the landmarks' and the rules' forces on part k, and the landmarks' costs."""
    scale = wp.exp(state.bodies.log_scale[b])
    half_size = problem.half_size
    seen = state.drawn[b, k]
    sums = SurfaceForces()
    for i in range(3):
        sums.force[i] = seen[i]
        for j in range(3):
            sums.moment[i, j] = seen[3 + 3 * i + j]
    to_camera = half_size * wp.vec3((seen[12] + seen[13]) * scale, seen[14], seen[15])
    cost = float(0.0)
    for i in range(problem.landmarks.first_share[k], problem.landmarks.first_share[k + 1]):
        share = problem.landmarks.shares[i]
        pull = state.pulls[b, share.landmark]
        sums = add_force(sums, share.weight * pull.force, share.normalised)
        if share.counts == 1:
            cost += pull.cost
            to_camera += pull.camera
    state.costs[b, k][PROJ] = cost
    if lens_of(problem, b)[0] > 0.0:
        # The camera stays; what scale and shift move is the pelvis, at (shift - centre, focal) / scale.
        to_camera = wp.vec3(-wp.dot(state.roots[b], sums.force), sums.force[0] / scale, sums.force[1] / scale)
    sums.force += state.pushes[b, k]

    axes = state.ellipsoids.axes[b, k]
    turning = sums.moment * wp.diag(state.ellipsoids.semi_axes[b, k]) * wp.transpose(axes)  # sum of F (X - c)^T
    wrench = Wrench()
    wrench.force = sums.force
    wrench.torque = wp.vec3(turning[2, 1] - turning[1, 2], turning[0, 2] - turning[2, 0], turning[1, 0] - turning[0, 1])
    wrench.semi_axes = wp.get_diag(wp.transpose(axes) * sums.moment)
    wrench.camera = to_camera
    state.wrenches[b, k] = wrench
