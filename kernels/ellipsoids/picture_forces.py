"""Sums over the forces on an ellipsoid as a picture sees them: 12 numbers, from which its gradients follow once.

A force on a surface point is dL/d(x, y) and dL/d nearness of the point's picture. Its effect on the ellipsoid is linear
in the point's place (1, x, y, nearness), so that a thread adds three forces times these, and keeps no ellipsoid.
"""

import warp as wp

from .forces import Ellipsoid, EllipsoidView, SurfaceForces, load_ellipsoid
from .silhouette import Silhouette


@wp.struct
class PictureForces:
    """Sums over forces times the places of their points: 1, and x, y, nearness less those of the outline's middle.

    For a perspective camera, the force in z is divided by the point's nearness.
    """

    in_x: wp.vec4  # dL/dx [1/px]
    in_y: wp.vec4
    in_z: wp.vec4  # [1/m]


@wp.func
def place_in(s: Silhouette, x: float, y: float, nearness: float):
    """Place of a point that forces are multiplied by."""
    return wp.vec4(1.0, x - s.mean[0], y - s.mean[1], nearness - s.nearness)


@wp.func
def add_picture_force(
    forces: PictureForces, view: EllipsoidView, x: float, y: float, nearness: float, push: wp.vec2, pull: float
):
    """Add dL/d(x, y) = push and dL/d nearness = pull of a surface point."""
    place = place_in(view.own, x, y, nearness)
    forces.in_x += push[0] * place
    forces.in_y += push[1] * place
    force = -pull
    if view.scene.perspective:
        camera = view.scene.camera[view.b]
        force = -(push[0] * (x - camera[2]) + push[1] * (y - camera[3]) + pull * nearness)
    forces.in_z += force * place
    return forces


@wp.func
def add_depth_force(forces: PictureForces, view: EllipsoidView, x: float, y: float, nearness: float, amount: float):
    """Add dL/dz = amount of a surface point."""
    force = wp.where(view.scene.perspective, amount / nearness, amount)
    forces.in_z += force * place_in(view.own, x, y, nearness)
    return forces


@wp.func
def lever_of(e: Ellipsoid, s: Silhouette, force: wp.vec4):
    """Point relative to the ellipsoid's centre in the camera's frame, times a force; and the force."""
    middle = wp.vec2((s.mean[0] - e.camera[2]) / e.camera[0], (s.mean[1] - e.camera[3]) / e.camera[1])
    base = wp.vec3(middle[0], middle[1], -s.nearness) - e.centre
    along = wp.vec3(0.0, 0.0, -1.0)
    total = force[0]
    if e.perspective:
        base = wp.vec3(middle[0], middle[1], 1.0) - s.nearness * e.centre
        along = -e.centre
        total = s.nearness * force[0] + force[3]
    lever = force[0] * base + wp.vec3(force[1] / e.camera[0], force[2] / e.camera[1], 0.0) + force[3] * along
    return wp.vec4(lever[0], lever[1], lever[2], total)


@wp.func
def on_surface(view: EllipsoidView, forces: PictureForces):
    """Forces on the surface."""
    sums = SurfaceForces()
    e = load_ellipsoid(view)
    s = view.own
    n = int(0)
    while n < 3:  # a loop over a constant range would be unrolled
        force = forces.in_z
        if n == 0:
            force = e.camera[0] * forces.in_x
        if n == 1:
            force = e.camera[1] * forces.in_y
        lever = lever_of(e, s, force)
        arm = wp.transpose(e.axes) * wp.vec3(lever[0], lever[1], lever[2])
        row = wp.cw_div(arm, e.semi_axes)
        for i in range(3):
            if n == i:
                sums.force[i] = lever[3]
                for j in range(3):
                    sums.moment[i, j] = row[j]
        n += 1
    x = forces.in_x
    y = forces.in_y
    sums.camera = wp.vec4(
        (x[1] + (s.mean[0] - e.camera[2]) * x[0]) / e.camera[0],
        (y[2] + (s.mean[1] - e.camera[3]) * y[0]) / e.camera[1],
        x[0],
        y[0],
    )
    return sums
