"""Rules: terms of the energy that need no picture and look at one part at a time.

A new term is a device function here: it returns what part k costs, weighted, and adds its gradient to
``state.gradient`` or, as a force on the part's centre, to ``state.pushes``. ``Weights`` has its row in the same column.
"""

from collections.abc import Callable
from typing import Any

import warp as wp

from .state import Problem, State, has_bit

RULES: list[tuple[int, wp.Function]] = []  # column and device function

_MILLIMETRES = wp.constant(1000.0)


def rule(column: int) -> Callable[[Any], Any]:
    """Decorator of a device function that is the term of a column."""

    def register(function: wp.Function) -> wp.Function:
        RULES.append((column, function))
        return function

    return register


@wp.func
def hold_size(
    sizes: wp.array2d[float], usual: wp.array2d[float], gradient: wp.array2d[float], weight: float, b: int, k: int
):
    """Squared deviation of size k from the usual, where there is one."""
    cost = float(0.0)
    if k < sizes.shape[1]:
        deviation = (sizes[b, k] - usual[b % usual.shape[0], k]) * _MILLIMETRES
        cost = weight * deviation * deviation
        gradient[b, k] = gradient[b, k] + 2.0 * weight * deviation * _MILLIMETRES
    return cost


@rule(column=5)
@wp.func
def limit_joint(problem: Problem, state: State, weight: float, b: int, k: int):
    """Squared excess over the limits of joint k."""
    excess = wp.vec3(0.0)
    if not has_bit(problem.locked, k):
        v = state.bodies.rotations[b, k]
        lower, upper = problem.rules.lower_limits[k], problem.rules.upper_limits[k]
        for i in range(3):  # not by ``wp.max``, which passes over NaN
            if not v[i] <= upper[i]:
                excess[i] = v[i] - upper[i]
            if v[i] < lower[i]:
                excess[i] = v[i] - lower[i]
    state.gradient.rotations[b, k] = state.gradient.rotations[b, k] + 2.0 * weight * excess
    return weight * wp.dot(excess, excess)


@rule(column=2)
@wp.func
def hold_length(problem: Problem, state: State, weight: float, b: int, k: int):
    """Squared deviation of length k from the usual, a term of L_l."""
    bodies, gradient = state.bodies, state.gradient
    return hold_size(bodies.lengths, problem.rules.usual_lengths, gradient.lengths, weight, b, k)


@rule(column=3)
@wp.func
def hold_thickness(problem: Problem, state: State, weight: float, b: int, k: int):
    """Squared deviation of thickness k from the usual, a term of L_t."""
    bodies, gradient = state.bodies, state.gradient
    return hold_size(bodies.thicknesses, problem.rules.usual_thicknesses, gradient.thicknesses, weight, b, k)


@rule(column=6)
@wp.func
def hold_depth(problem: Problem, state: State, weight: float, b: int, k: int):
    """Squared distance along z of part k's centre from its given depth, in spreads of its own."""
    row = b % problem.rules.depths.shape[0]
    depth = state.ellipsoids.centres[b, k][2] - state.roots[b][2]
    scale = problem.rules.depth_scales[row, k]
    deviation = (depth - problem.rules.depths[row, k]) * scale
    push = 2.0 * weight * deviation * scale
    state.pushes[b, k] = state.pushes[b, k] + wp.vec3(0.0, 0.0, push)
    return weight * deviation * deviation
