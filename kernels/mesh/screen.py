"""Vertices of ellipsoids on the screen, and the adjoint: sums over an ellipsoid's vertices, by a warp each."""

from typing import Any

import warp as wp

from ..lanes import num_lanes, sum_lanes

wp.set_module_options({"enable_backward": False})

_MIN_DEPTH = wp.constant(1.0e-6)  # [m]; nearer, a vertex has no picture, but finite numbers


@wp.struct
class EllipsoidsSeen:
    """B bodies of P ellipsoids with their cameras, or the gradient with respect to them."""

    centres: wp.array2d[wp.vec3]  # (B, P) [m]
    axes: wp.array2d[wp.mat33]  # (B, P)
    semi_axes: wp.array2d[wp.vec3]  # (B, P) [m]
    cameras: wp.array2d[wp.vec4]  # (B, 1) f_x, f_y, c_x, c_y [px]; of gradients (B, P) shares


@wp.func
def project_depth(z: float):
    """Depth that a point is divided by."""
    if wp.abs(z) < _MIN_DEPTH:
        return _MIN_DEPTH
    return z


@wp.func
def place_point(seen: EllipsoidsSeen, b: int, k: int, unit: wp.vec3):
    """Point of ellipsoid k where the unit sphere has one (the paper's E, eq. 14) [m]; NaN if a size is 0 or less."""
    sizes = seen.semi_axes[b, k]
    if not (sizes[0] > 0.0 and sizes[1] > 0.0 and sizes[2] > 0.0):
        return wp.vec3(wp.nan)
    return seen.centres[b, k] + seen.axes[b, k] * wp.cw_mul(sizes, unit)


@wp.kernel
def place_on_screen(
    unit_vertices: wp.array[wp.vec3],  # (N,) on the unit sphere
    seen: EllipsoidsSeen,
    perspective: bool,
    screen: wp.array2d[wp.vec3],  # (B, P N) u [px], v [px], z [m]  OUTPUT
):
    """Deform the unit sphere's mesh into each ellipsoid (the paper's E, eq. 14) and project it."""
    thread = wp.tid()
    count, parts = unit_vertices.shape[0], seen.centres.shape[1]
    ellipsoid = thread // count
    n = thread - ellipsoid * count
    b = ellipsoid // parts
    k = ellipsoid - b * parts
    camera = seen.cameras[b, 0]
    point = place_point(seen, b, k, unit_vertices[n])
    if not (camera[0] > 0.0 and camera[1] > 0.0):  # a scale of 0, of a training that diverged, shows no picture
        point = wp.vec3(wp.nan)
    ray = wp.vec2(point[0], point[1])
    if perspective:
        ray = ray / project_depth(point[2])
    screen[b, k * count + n] = wp.vec3(ray[0] * camera[0] + camera[2], ray[1] * camera[1] + camera[3], point[2])


@wp.kernel
def place_on_screen_adjoint(
    unit_vertices: wp.array[wp.vec3],
    seen: EllipsoidsSeen,
    perspective: bool,
    adj_screen: wp.array2d[wp.vec3],  # (B, P N)
    lanes: int,  # threads of a warp, which share an ellipsoid's vertices
    gradient: EllipsoidsSeen,  # OUTPUT
):
    """Fill ``gradient``, added in a fixed order."""
    thread = wp.tid()
    count, parts = unit_vertices.shape[0], seen.centres.shape[1]
    ellipsoid = thread // lanes
    lane = thread - ellipsoid * lanes
    b = ellipsoid // parts
    k = ellipsoid - b * parts
    camera = seen.cameras[b, 0]
    force = wp.vec3()
    moment = wp.mat33()
    of_camera = wp.vec4()
    n = lane
    while n < count:
        unit = unit_vertices[n]
        adj = adj_screen[b, k * count + n]
        point = place_point(seen, b, k, unit)
        ray = wp.vec2(point[0], point[1])
        push = wp.vec3(adj[0] * camera[0], adj[1] * camera[1], adj[2])
        if perspective:
            depth = project_depth(point[2])
            ray = ray / depth
            along = adj[2]
            if depth == point[2]:
                along -= (push[0] * ray[0] + push[1] * ray[1]) / depth
            push = wp.vec3(push[0] / depth, push[1] / depth, along)
        force += push
        moment += wp.outer(push, unit)
        of_camera += wp.vec4(adj[0] * ray[0], adj[1] * ray[1], adj[0], adj[1])
        n += lanes
    for i in range(3):
        force[i] = sum_lanes(force[i])
        for j in range(3):
            moment[i, j] = sum_lanes(moment[i, j])
    for i in range(4):
        of_camera[i] = sum_lanes(of_camera[i])
    if lane == 0:
        gradient.centres[b, k] = force
        gradient.axes[b, k] = moment * wp.diag(seen.semi_axes[b, k])
        gradient.semi_axes[b, k] = wp.get_diag(wp.transpose(seen.axes[b, k]) * moment)
        gradient.cameras[b, k] = of_camera


_BLOCK = 64


def launch_place_on_screen(unit_vertices: wp.array, seen: Any, screen: wp.array, *, perspective: bool) -> None:
    """Fill ``screen`` from ellipsoids and cameras."""
    inputs = [unit_vertices, seen, perspective]
    wp.launch(place_on_screen, screen.size, inputs, [screen], device=screen.device, block_dim=_BLOCK)


def launch_place_on_screen_adjoint(
    unit_vertices: wp.array, seen: Any, adj_screen: wp.array, gradient: Any, *, perspective: bool
) -> None:
    """Fill the gradient with respect to ellipsoids and, in shares, cameras."""
    lanes = num_lanes(adj_screen.device)
    inputs = [unit_vertices, seen, perspective, adj_screen, lanes, gradient]
    dim = seen.centres.size * lanes
    wp.launch(place_on_screen_adjoint, dim, inputs, device=adj_screen.device, block_dim=_BLOCK)
