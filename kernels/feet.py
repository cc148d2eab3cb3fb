"""Squared speeds of points of feet in films, times how surely they stand.

A thread has what it writes to itself, so results are the same every time.
"""

from collections.abc import Sequence

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.func
def square_across(velocity: wp.vec3, middle: wp.vec3):
    """Squared speed across the ray through a point [m^2/s^2], all of it at the camera's centre; never negative."""
    ray = wp.normalize(middle)
    return wp.length_sq(velocity - wp.dot(velocity, ray) * ray)


@wp.kernel
def weigh_slides(
    seen: wp.array4d[wp.vec3],  # (P, T, V, F) in each camera's frame [m]
    shown: wp.array3d[wp.bool],  # (P, T, V) who is seen where
    rates: wp.array2d[float],  # (P, T - 1) 1 over the time from each frame to the next [1/s]
    odds: wp.vec2,  # logarithm of those that a point at rest stands, and how much of it each m^2/s^2 takes
    costs: wp.array3d[float],  # (P, T - 1, F) [m^2/s^2]  OUTPUT
    forces: wp.array3d[wp.vec3],  # (P, T - 1, F) gradients of costs at the later frame in view 0 [m/s^2]  OUTPUT
):
    """One thread a point between two frames."""
    p, t, f = wp.tid()
    rate = rates[p, t]
    across = float(-1.0)  # in the view that sees it fastest; below 0: none sees it
    for v in range(seen.shape[2]):
        if shown[p, t, v] and shown[p, t + 1, v]:
            before, after = seen[p, t, v, f], seen[p, t + 1, v, f]
            across = wp.max(across, square_across((after - before) * rate, after + before))
    stands = float(0.0)
    if across >= 0.0:
        stands = 1.0 / (1.0 + wp.exp(across * odds[1] - odds[0]))
    velocity = (seen[p, t + 1, 0, f] - seen[p, t, 0, f]) * rate
    costs[p, t, f] = stands * wp.length_sq(velocity)
    forces[p, t, f] = 2.0 * rate * stands * velocity


@wp.kernel
def weigh_slides_adjoint(
    forces: wp.array3d[wp.vec3],
    adjoint: wp.array3d[float],  # (P, T - 1, F) of the costs
    gradient: wp.array4d[wp.vec3],  # (P, T, V, F) of the points  OUTPUT
):
    """One thread a point of a frame, which adds the step to it and the one from it."""
    p, t, f = wp.tid()
    pull = wp.vec3()
    if t > 0:
        pull += adjoint[p, t - 1, f] * forces[p, t - 1, f]
    if t < forces.shape[1]:
        pull -= adjoint[p, t, f] * forces[p, t, f]
    gradient[p, t, 0, f] = pull
    for v in range(1, gradient.shape[2]):
        gradient[p, t, v, f] = wp.vec3()


def launch_slides(inputs: Sequence[wp.array], odds: wp.vec2, outputs: Sequence[wp.array]) -> None:
    """Fill costs and forces from points, who is shown, and rates."""
    wp.launch(weigh_slides, outputs[0].shape, [*inputs, odds, *outputs], device=outputs[0].device)


def launch_slides_adjoint(forces: wp.array, adjoint: wp.array, gradient: wp.array) -> None:
    """Fill the ``gradient`` with respect to points from the ``adjoint`` of costs, by what ``launch_slides`` filled."""
    people, frames, _, points = gradient.shape
    wp.launch(weigh_slides_adjoint, (people, frames, points), [forces, adjoint, gradient], device=gradient.device)
