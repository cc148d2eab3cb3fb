"""From forces on parts to the gradient of every parameter, and each body's energy.

A bone turns all that hangs on it, so the gradient of its rotation is the torque of its subtree about its start. A
body's root counts as one more bone: its thread turns the whole body, and keeps the body's books.
"""

import warp as wp

from .refine_costs import TermWeights, Wrenches
from .refine_prior import Mixture, log_density, mixture_gradient
from .refine_state import MODULE, NUM_TERMS, PRIOR, Bodies, Ellipsoids, Skeleton, Terms, column, has_bit, launch
from .rotations import axis_angle_gradient, columns_gradient

_NUM_TERMS = wp.constant(NUM_TERMS)
_DOWN = wp.constant(wp.vec3(0.0, 1.0, 0.0))  # camera frame


@wp.struct
class Stopping:
    """When a body has come to rest: its best energy fell by no more than a share in so many iterations."""

    tolerance: float  # negative: never
    patience: int


@wp.struct
class Records:
    """What is remembered of each body."""

    better: wp.array[int]  # (B,) whether this iteration's state is the best so far
    energy: wp.array[float]  # (B,) the best
    terms: wp.array[Terms]  # (B,) of the best
    history: wp.array2d[float]  # (iterations + 1, B)
    mark: wp.array[float]  # (B,) energy that the next progress is measured from
    mark_iteration: wp.array[int]  # (B,)


@wp.func
def subtree_force(wrenches: Wrenches, b: int, subtree: int):
    """Force on all parts of a bit mask."""
    force = wp.vec3(0.0)
    for k in range(wrenches.force.shape[1]):
        if has_bit(subtree, k):
            force += wrenches.force[b, k]
    return force


@wp.func
def subtree_torque(ellipsoids: Ellipsoids, wrenches: Wrenches, b: int, subtree: int, pivot: wp.vec3):
    """Torque about ``pivot`` on all parts of a bit mask."""
    torque = wp.vec3(0.0)
    for k in range(wrenches.force.shape[1]):
        if has_bit(subtree, k):
            torque += wrenches.torque[b, k] + wp.cross(ellipsoids.centres[b, k] - pivot, wrenches.force[b, k])
    return torque


@wp.func
def gather_rotation(
    skeleton: Skeleton,
    bodies: Bodies,
    ellipsoids: Ellipsoids,
    wrenches: Wrenches,
    mixture: Mixture,
    exponents: wp.array2d[float],
    slopes: wp.array3d[wp.vec3],
    weights: TermWeights,
    gradient: Bodies,
    b: int,
    k: int,
):
    """Rotation of part k."""
    if not has_bit(skeleton.locked, k):
        axes = ellipsoids.axes[b, k]
        start = ellipsoids.centres[b, k] - ellipsoids.semi_axes[b, k][0] * column(axes, 0)
        torque = subtree_torque(ellipsoids, wrenches, b, skeleton.subtrees[k], start)
        own = skeleton.rest_axes[k] * (wp.transpose(axes) * torque)  # the global rotation is axes * rest_axes^T
        total = gradient.rotations[b, k] + axis_angle_gradient(bodies.rotations[b, k], own)
        if mixture.slots[k] >= 0:
            share = mixture_gradient(exponents, slopes, log_density(exponents, b), b, mixture.slots[k])
            total += weights.prior * share
        gradient.rotations[b, k] = total


@wp.func
def gather_length(
    skeleton: Skeleton, bodies: Bodies, ellipsoids: Ellipsoids, wrenches: Wrenches, gradient: Bodies, b: int, k: int
):
    """Length k, of one part or of two."""
    if k < bodies.lengths.shape[1]:
        length = gradient.lengths[b, k]
        for part in range(wrenches.force.shape[1]):
            if skeleton.shape_indices[part][0] == k:
                # A longer bone carries along what hangs on it, and its own centre half as far.
                carried = subtree_force(wrenches, b, skeleton.subtrees[part]) - 0.5 * wrenches.force[b, part]
                along = wp.dot(carried, column(ellipsoids.axes[b, part], 0))
                length += along + 0.5 * wrenches.semi_axes[b, part][0]
        gradient.lengths[b, k] = length


@wp.func
def gather_thickness(skeleton: Skeleton, bodies: Bodies, wrenches: Wrenches, gradient: Bodies, b: int, k: int):
    """Thickness k."""
    if k < bodies.thicknesses.shape[1]:
        thickness = gradient.thicknesses[b, k]
        for part in range(wrenches.force.shape[1]):
            shape = skeleton.shape_indices[part]
            if shape[1] == k:
                thickness += 0.5 * wrenches.semi_axes[b, part][1]
            if shape[2] == k:
                thickness += 0.5 * wrenches.semi_axes[b, part][2]
        gradient.thicknesses[b, k] = thickness


@wp.func
def gather_root(
    skeleton: Skeleton,
    bodies: Bodies,
    ellipsoids: Ellipsoids,
    orientation: wp.mat33,
    wrenches: Wrenches,
    mixture: Mixture,
    exponents: wp.array2d[float],
    slopes: wp.array3d[wp.vec3],
    weights: TermWeights,
    gradient: Bodies,
    b: int,
):
    """Orientation and camera."""
    num_parts = wrenches.force.shape[1]
    torque = subtree_torque(ellipsoids, wrenches, b, skeleton.subtrees[num_parts], wp.vec3(0.0))
    if mixture.slots[num_parts] >= 0:
        share = mixture_gradient(exponents, slopes, log_density(exponents, b), b, mixture.slots[num_parts])
        torque += weights.prior * wp.cross(_DOWN, orientation * share)
    grad_first, grad_second = columns_gradient(bodies.orientation[b, 0], bodies.orientation[b, 1], orientation, torque)
    gradient.orientation[b, 0] = grad_first
    gradient.orientation[b, 1] = grad_second
    camera = wp.vec3(0.0)
    for k in range(num_parts):
        camera += wrenches.camera[b, k]
    gradient.log_scale[b] = camera[0]
    gradient.shift[b] = wp.vec2(camera[1], camera[2])


@wp.func
def keep_books(terms: Terms, iteration: int, stopping: Stopping, records: Records, active: wp.array[int], b: int):
    """Note the energy; say whether it is the best and whether the body may rest."""
    energy = float(0.0)
    for i in range(_NUM_TERMS):
        energy += terms[i]
    records.history[iteration, b] = energy
    better = iteration == 0 or energy < records.energy[b]
    records.better[b] = wp.where(better, 1, 0)
    if better:
        records.energy[b] = energy
        records.terms[b] = terms
    if stopping.tolerance >= 0.0:
        mark = records.mark[b]
        if iteration == 0 or mark - records.energy[b] > stopping.tolerance * wp.abs(mark):
            records.mark[b] = records.energy[b]
            records.mark_iteration[b] = iteration
        elif iteration - records.mark_iteration[b] >= stopping.patience:
            active[b] = 0


@wp.kernel(module=MODULE)
def gather_gradients(
    active: wp.array[int],  # (B,) MODIFIED: 0 where a body may rest
    iteration: wp.array[int],  # (1,)
    skeleton: Skeleton,
    bodies: Bodies,
    ellipsoids: Ellipsoids,
    orientations: wp.array[wp.mat33],  # (B,)
    costs: wp.array2d[Terms],  # (B, P)
    wrenches: Wrenches,
    mixture: Mixture,
    exponents: wp.array2d[float],  # (B, K)
    slopes: wp.array3d[wp.vec3],  # (B, K, S)
    weights: TermWeights,
    stopping: Stopping,
    gradient: Bodies,  # MODIFIED: the forces' share is added
    records: Records,  # MODIFIED
):
    """Threads 0 to P - 1 own a rotation each, P more a length, P more a thickness, and the last one the body.

    The latter may clear ``active`` while the others read it: what they do then matters to nobody.
    """
    b, thread = wp.tid()
    num_parts = wrenches.force.shape[1]
    if thread < 3 * num_parts:
        if active[b] == 1:
            k = thread % num_parts
            if thread < num_parts:
                gather_rotation(
                    skeleton, bodies, ellipsoids, wrenches, mixture, exponents, slopes, weights, gradient, b, k
                )
            elif thread < 2 * num_parts:
                gather_length(skeleton, bodies, ellipsoids, wrenches, gradient, b, k)
            else:
                gather_thickness(skeleton, bodies, wrenches, gradient, b, k)
        return
    if active[b] == 0:
        records.better[b] = 0
        records.history[iteration[0], b] = records.history[iteration[0] - 1, b]
        return
    gather_root(
        skeleton,
        bodies,
        ellipsoids,
        orientations[b],
        wrenches,
        mixture,
        exponents,
        slopes,
        weights,
        gradient,
        b,
    )
    terms = Terms()
    for part in range(num_parts):
        terms += costs[b, part]
    if exponents.shape[1] > 0:
        terms[PRIOR] = -weights.prior * log_density(exponents, b)
    keep_books(terms, iteration[0], stopping, records, active, b)


def launch_gather(
    active: wp.array,
    iteration: wp.array,
    skeleton: Skeleton,
    bodies: Bodies,
    ellipsoids: Ellipsoids,
    orientations: wp.array,
    costs: wp.array,
    wrenches: Wrenches,
    mixture: Mixture,
    exponents: wp.array,
    slopes: wp.array,
    weights: TermWeights,
    stopping: Stopping,
    gradient: Bodies,
    records: Records,
) -> None:
    """Complete ``gradient`` and update ``records`` and ``active``."""
    state = [skeleton, bodies, ellipsoids, orientations, costs, wrenches, mixture, exponents, slopes]
    inputs = [active, iteration, *state, weights, stopping, gradient, records]
    launch(gather_gradients, (costs.shape[0], 3 * costs.shape[1] + 1), inputs, active.device)
