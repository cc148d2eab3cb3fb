"""Kinematics with a thread a part: each walks its own ancestors up to the root and waits for nobody."""

import warp as wp

from .refine_state import MODULE, Bodies, Ellipsoids, Skeleton, column, has_bit, launch
from .rotations import rotation_from_6d, rotation_from_axis_angle


@wp.func
def local_rotation(skeleton: Skeleton, bodies: Bodies, b: int, k: int):
    if has_bit(skeleton.locked, k):
        return wp.identity(n=3, dtype=float)
    return rotation_from_axis_angle(bodies.rotations[b, k])


@wp.kernel(module=MODULE)
def pose_parts(
    active: wp.array[int],  # (B,)
    skeleton: Skeleton,
    bodies: Bodies,
    half_size: float,  # of the drawn crop [px]
    slots: wp.array[int],  # (P + 1,) see ``Mixture``
    iteration: wp.array[int],  # (1,) MODIFIED: counts up before another kernel reads it
    ellipsoids: Ellipsoids,  # OUTPUT
    orientations: wp.array[wp.mat33],  # (B,)  OUTPUT
    directions: wp.array2d[wp.vec3],  # (B, S) what the prior looks at  OUTPUT
):
    """The same as ``pose_bones`` of the flexible path, from axis-angle and 6D numbers."""
    b, k = wp.tid()
    if b == 0 and k == 0:
        iteration[0] = iteration[0] + 1
    if active[b] == 0:
        return
    rotation = local_rotation(skeleton, bodies, b, k)
    start = wp.vec3(0.0)
    above = skeleton.parents[k]
    while above >= 0:
        turn = local_rotation(skeleton, bodies, b, above)
        bone = column(skeleton.rest_axes[above], 0) * bodies.lengths[b, skeleton.shape_indices[above][0]]
        start = turn * (start + bone)
        rotation = turn * rotation
        above = skeleton.parents[above]
    orientation = rotation_from_6d(bodies.orientation[b, 0], bodies.orientation[b, 1])
    shape = skeleton.shape_indices[k]
    semi_axes = 0.5 * wp.vec3(
        bodies.lengths[b, shape[0]], bodies.thicknesses[b, shape[1]], bodies.thicknesses[b, shape[2]]
    )
    axes = orientation * rotation * skeleton.rest_axes[k]
    ellipsoids.axes[b, k] = axes
    ellipsoids.semi_axes[b, k] = semi_axes
    ellipsoids.centres[b, k] = orientation * start + semi_axes[0] * column(axes, 0)
    if slots[k] >= 0:
        directions[b, slots[k]] = bodies.rotations[b, k]
    if k == 0:
        orientations[b] = orientation
        up = slots[slots.shape[0] - 1]
        if up >= 0:
            # The camera's y is down.
            directions[b, up] = -wp.vec3(orientation[1, 0], orientation[1, 1], orientation[1, 2])
        focal = wp.exp(bodies.log_scale[b]) * half_size
        shift = bodies.shift[b]
        ellipsoids.camera[b] = wp.vec4(focal, focal, (shift[0] + 1.0) * half_size, (shift[1] + 1.0) * half_size)


def launch_pose(
    active: wp.array,
    skeleton: Skeleton,
    bodies: Bodies,
    half_size: float,
    slots: wp.array,
    iteration: wp.array,
    ellipsoids: Ellipsoids,
    orientations: wp.array,
    directions: wp.array,
) -> None:
    """Fill ``ellipsoids``, ``orientations`` and ``directions``, and start the next iteration."""
    inputs = [active, skeleton, bodies, half_size, slots, iteration, ellipsoids, orientations, directions]
    launch(pose_parts, ellipsoids.centres.shape, inputs, active.device)
