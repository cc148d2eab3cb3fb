"""What each part costs: keypoints, joint limits, sizes and the renderer's share, and the forces that follow.

Whatever pulls on a part ends as a force, a torque about its centre and a gradient of its semi-axes.
"""

import warp as wp

from .refine_prior import Mixture, exponent
from .refine_state import (
    LENGTH,
    LIMITS,
    MODULE,
    PROJ,
    SEG,
    THICKNESS,
    Bodies,
    Ellipsoids,
    Skeleton,
    Terms,
    has_bit,
    launch,
)
from .surface_forces import SurfaceForces, add_force

_MILLIMETRES = wp.constant(1000.0)


@wp.struct
class Landmarks:
    """Every landmark that there is; what is seen of it stands in ``points`` and ``votes``, N = 1 or one row a body."""

    touches: wp.array[int]  # landmarks of part 0, of part 1, ...
    first_touch: wp.array[int]  # (P + 1,) where a part's begin
    parts: wp.array2d[int]  # (L, 2) the landmark is a weighted mean of a point of each
    normalised: wp.array2d[wp.vec3]  # (L, 2) in units of the semi-axes
    shares: wp.array2d[float]  # (L, 2) sum to 1
    points: wp.array2d[wp.vec2]  # (N, L) in the crop, -1 to 1
    votes: wp.array2d[float]  # (N, L) 0 = not seen


@wp.struct
class Rules:
    """What needs no picture: joint limits and usual sizes."""

    lower_limits: wp.array[wp.vec3]  # (P,) [rad]
    upper_limits: wp.array[wp.vec3]  # (P,) [rad]
    mean_lengths: wp.array[float]  # [m]
    mean_thicknesses: wp.array[float]  # [m]


@wp.struct
class TermWeights:
    """Factors of the energy's terms."""

    proj: float  # with the pixels of a half-side
    seg: float
    length: float
    thickness: float
    prior: float
    limits: float


@wp.struct
class Drawn:
    """What the renderer hands over: L_seg in parts that sum to it, and its forces on surface points."""

    loss: wp.array2d[float]  # (B, T) [px]
    force: wp.array2d[wp.vec3]  # (B, P)
    moment: wp.array2d[wp.mat33]  # (B, P)
    camera_force: wp.array2d[wp.vec4]  # (B, P)


@wp.struct
class Wrenches:
    """The forces on each part."""

    force: wp.array2d[wp.vec3]  # (B, P)
    torque: wp.array2d[wp.vec3]  # (B, P) about the part's centre
    semi_axes: wp.array2d[wp.vec3]  # (B, P) gradient of the semi-axes
    camera: wp.array2d[wp.vec3]  # (B, P) gradient of log scale and shift


@wp.func
def landmark_position(landmarks: Landmarks, ellipsoids: Ellipsoids, b: int, index: int):
    """Camera frame [m]."""
    position = wp.vec3(0.0)
    for i in range(2):
        k = landmarks.parts[index, i]
        local = wp.cw_mul(ellipsoids.semi_axes[b, k], landmarks.normalised[index, i])
        position += landmarks.shares[index, i] * (ellipsoids.centres[b, k] + ellipsoids.axes[b, k] * local)
    return position


@wp.func
def slope_of_abs(x: float):
    """0 at 0, unlike ``wp.sign``."""
    return wp.where(x > 0.0, 1.0, wp.where(x < 0.0, -1.0, 0.0))


@wp.kernel(module=MODULE)
def cost_parts(
    active: wp.array[int],  # (B,)
    skeleton: Skeleton,
    bodies: Bodies,
    ellipsoids: Ellipsoids,
    drawn: Drawn,
    landmarks: Landmarks,
    rules: Rules,
    weights: TermWeights,
    mixture: Mixture,
    squares: wp.array3d[float],  # (B, K, S)
    costs: wp.array2d[Terms],  # (B, P) shares of the terms, weighted  OUTPUT
    exponents: wp.array2d[float],  # (B, K) log of each component's share of the density  OUTPUT
    wrenches: Wrenches,  # OUTPUT
    gradient: Bodies,  # OUTPUT: of joint limits and sizes alone
):
    """Thread k owns part k, and of the sizes length k and thickness k; the prior's components are shared out."""
    b, k = wp.tid()
    if active[b] == 0:
        return
    cost = Terms()
    scale = wp.exp(bodies.log_scale[b])
    shift = bodies.shift[b]
    camera = ellipsoids.camera[b]
    half_size = camera[0] / scale

    sums = SurfaceForces()
    sums.force = weights.seg * drawn.force[b, k]
    sums.moment = weights.seg * drawn.moment[b, k]
    seen = weights.seg * drawn.camera_force[b, k]
    to_camera = half_size * wp.vec3((seen[0] + seen[1]) * scale, seen[2], seen[3])
    for i in range(k, drawn.loss.shape[1], costs.shape[1]):
        cost[SEG] += weights.seg * drawn.loss[b, i]

    row = b % landmarks.votes.shape[0]
    for touch in range(landmarks.first_touch[k], landmarks.first_touch[k + 1]):
        index = landmarks.touches[touch]
        vote = weights.proj * landmarks.votes[row, index]
        if vote > 0.0:
            position = landmark_position(landmarks, ellipsoids, b, index)
            flat = wp.vec2(position[0], position[1])
            miss = scale * flat + shift - landmarks.points[row, index]
            pull = vote * wp.vec2(slope_of_abs(miss[0]), slope_of_abs(miss[1]))
            force = scale * wp.vec3(pull[0], pull[1], 0.0)
            for i in range(2):
                if landmarks.parts[index, i] == k:
                    sums = add_force(sums, landmarks.shares[index, i] * force, landmarks.normalised[index, i])
            if landmarks.parts[index, 0] == k:  # a landmark of two parts counts once
                cost[PROJ] += vote * (wp.abs(miss[0]) + wp.abs(miss[1]))
                to_camera += wp.vec3(scale * wp.dot(pull, flat), pull[0], pull[1])

    axes = ellipsoids.axes[b, k]
    turning = sums.moment * wp.diag(ellipsoids.semi_axes[b, k]) * wp.transpose(axes)  # sum of F (X - c)^T
    wrenches.force[b, k] = sums.force
    wrenches.torque[b, k] = wp.vec3(
        turning[2, 1] - turning[1, 2], turning[0, 2] - turning[2, 0], turning[1, 0] - turning[0, 1]
    )
    wrenches.semi_axes[b, k] = wp.get_diag(wp.transpose(axes) * sums.moment)
    wrenches.camera[b, k] = to_camera

    excess = wp.vec3(0.0)
    if not has_bit(skeleton.locked, k):
        v = bodies.rotations[b, k]
        excess = wp.max(v - rules.upper_limits[k], wp.vec3(0.0)) - wp.max(rules.lower_limits[k] - v, wp.vec3(0.0))
    cost[LIMITS] = weights.limits * wp.dot(excess, excess)
    gradient.rotations[b, k] = 2.0 * weights.limits * excess
    if k < bodies.lengths.shape[1]:
        deviation = (bodies.lengths[b, k] - rules.mean_lengths[k]) * _MILLIMETRES
        cost[LENGTH] = weights.length * deviation * deviation
        gradient.lengths[b, k] = 2.0 * weights.length * deviation * _MILLIMETRES
    if k < bodies.thicknesses.shape[1]:
        deviation = (bodies.thicknesses[b, k] - rules.mean_thicknesses[k]) * _MILLIMETRES
        cost[THICKNESS] = weights.thickness * deviation * deviation
        gradient.thicknesses[b, k] = 2.0 * weights.thickness * deviation * _MILLIMETRES
    costs[b, k] = cost
    for component in range(k, exponents.shape[1], costs.shape[1]):
        exponents[b, component] = exponent(mixture, squares, b, component)


def launch_costs(
    active: wp.array,
    skeleton: Skeleton,
    bodies: Bodies,
    ellipsoids: Ellipsoids,
    drawn: Drawn,
    landmarks: Landmarks,
    rules: Rules,
    weights: TermWeights,
    mixture: Mixture,
    squares: wp.array,
    costs: wp.array,
    exponents: wp.array,
    wrenches: Wrenches,
    gradient: Bodies,
) -> None:
    """Fill ``costs``, ``exponents``, ``wrenches`` and the first part of ``gradient``."""
    inputs = [active, skeleton, bodies, ellipsoids, drawn, landmarks, rules, weights, mixture, squares]
    inputs += [costs, exponents, wrenches, gradient]
    launch(cost_parts, costs.shape, inputs, active.device)
