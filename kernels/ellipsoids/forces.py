"""Gradients as forces F = dL/dX on surface points X = c + A diag(a) u of an ellipsoid (u on the unit sphere).

Two sums over the forces give the gradients of all parameters, force = sum F and moment = sum F u^T:
dL/dc = force, dL/dA = moment diag(a), dL/da = diag(A^T moment).
"""

from collections.abc import Sequence

import warp as wp

from ..labels import flat
from ..lanes import LANES, sum_lanes
from .silhouette import Seen, Silhouette

wp.set_module_options({"enable_backward": False})


@wp.struct
class Ellipsoid:
    """One posed ellipsoid before its camera."""

    centre: wp.vec3  # [m]
    axes: wp.mat33  # columns
    semi_axes: wp.vec3  # [m]
    camera: wp.vec4  # f_x, f_y, c_x, c_y


@wp.struct
class SceneArrays:
    """B bodies of P ellipsoids and their picture: the input of every estimator of a gradient."""

    centres: wp.array2d[wp.vec3]  # (B, P)
    axes: wp.array2d[wp.mat33]  # (B, P)
    semi_axes: wp.array2d[wp.vec3]  # (B, P)
    camera: wp.array[wp.vec4]  # (B,)
    silhouettes: wp.array2d[Silhouette]  # (B, P)
    neighbours: wp.array3d[wp.uint32]  # (B, P, N) from ``find_neighbours``
    creases: wp.array3d[wp.uint32]  # (B, P, N)
    parts: wp.array3d[wp.uint8]  # (B, H, W) index + 1 of the ellipsoid shown, 0 = background
    perspective: bool


@wp.struct
class EllipsoidView:
    """One ellipsoid and its body's arrays, as views that are cheaper to index than the whole batch."""

    b: int
    k: int
    target: int  # index of the target
    silhouettes: wp.array[Silhouette]  # (P,)
    neighbours: wp.array[wp.uint32]  # (N,)
    parts: wp.array[wp.uint8]  # (H W,)
    height: int  # of the picture
    width: int


@wp.func
def view_ellipsoid(scene: SceneArrays, b: int, k: int, target: int):
    """View of ellipsoid k of body b."""
    view = EllipsoidView()
    view.b = b
    view.k = k
    view.target = target
    view.silhouettes = scene.silhouettes[b]
    view.neighbours = scene.neighbours[b, k]
    view.parts = flat(scene.parts[b])
    view.height = scene.parts.shape[1]
    view.width = scene.parts.shape[2]
    return view


@wp.func
def load_ellipsoid(scene: SceneArrays, view: EllipsoidView):
    """Load the ellipsoid's centre, axes, semi-axes and camera."""
    e = Ellipsoid()
    e.centre = scene.centres[view.b, view.k]
    e.axes = scene.axes[view.b, view.k]
    e.semi_axes = scene.semi_axes[view.b, view.k]
    e.camera = scene.camera[view.b]
    return e


@wp.func
def pixel_box(view: EllipsoidView, s: Silhouette):
    """First and last column, first and last row of pixels whose centres the ellipsoid may cover; last < first: none."""
    # Clamped in float against overflow.
    left = int(wp.clamp(wp.ceil(s.low[0] - 0.5), 0.0, float(view.width)))
    right = int(wp.clamp(wp.floor(s.high[0] - 0.5), -1.0, float(view.width - 1)))
    top = int(wp.clamp(wp.ceil(s.low[1] - 0.5), 0.0, float(view.height)))
    bottom = int(wp.clamp(wp.floor(s.high[1] - 0.5), -1.0, float(view.height - 1)))
    return left, right, top, bottom


@wp.struct
class SurfaceForces:
    """Sums over the forces on one ellipsoid."""

    force: wp.vec3
    moment: wp.mat33
    camera: wp.vec4  # dL/d(f_x, f_y, c_x, c_y)


@wp.func
def from_unit(e: Ellipsoid, unit: wp.vec3):
    """Point of the ellipsoid relative to its centre [m], from a point of the unit sphere."""
    return e.axes * wp.cw_mul(e.semi_axes, unit)


@wp.func
def to_unit(e: Ellipsoid, point: wp.vec3):
    """Point of the unit sphere that corresponds to a surface point."""
    return wp.cw_div(wp.transpose(e.axes) * (point - e.centre), e.semi_axes)


@wp.func
def unproject(e: Ellipsoid, x: float, y: float, nearness: float, perspective: bool):
    """Camera-frame point of a pixel position and a nearness [m]."""
    rx = (x - e.camera[2]) / e.camera[0]
    ry = (y - e.camera[3]) / e.camera[1]
    if perspective:
        return wp.vec3(rx, ry, 1.0) / nearness
    return wp.vec3(rx, ry, -nearness)


@wp.func
def add_force(sums: SurfaceForces, force: wp.vec3, unit: wp.vec3):
    sums.force += force
    sums.moment += wp.outer(force, unit)
    return sums


@wp.func
def add_image_force(sums: SurfaceForces, e: Ellipsoid, unit: wp.vec3, fx: float, fy: float, perspective: bool):
    """Add dL/d(u, v) = (fx, fy) of the picture of a surface point [1/px]."""
    point = e.centre + from_unit(e, unit)
    ray = wp.vec2(point[0], point[1])
    force = wp.vec3(e.camera[0] * fx, e.camera[1] * fy, 0.0)
    if perspective:
        ray = ray / point[2]
        force = wp.vec3(force[0], force[1], -(force[0] * ray[0] + force[1] * ray[1])) / point[2]
    sums = add_force(sums, force, unit)
    sums.camera += wp.vec4(fx * ray[0], fy * ray[1], fx, fy)
    return sums


@wp.func
def add_nearness_force(
    sums: SurfaceForces,
    e: Ellipsoid,
    x: float,
    y: float,
    nearness: float,
    slope: wp.vec2,
    amount: float,
    perspective: bool,
):
    """Add dL/dn = amount of the nearness that the surface has at a fixed place of the picture.

    The surface there moves with the normal part of its points' motion: dn = -N.dX / N_z for n = -z, and
    dn = -N.dX / (z N.X) for n = 1/z. ``slope`` is the nearness' gradient in the picture, along which the camera moves
    it.
    """
    point = unproject(e, x, y, nearness, perspective)
    unit = to_unit(e, point)
    normal = e.axes * wp.cw_div(unit, e.semi_axes)
    ray = wp.vec2(point[0], point[1])
    along = normal[2]
    if perspective:
        ray = ray / point[2]
        along = point[2] * wp.dot(normal, point)
    if along != 0.0:
        sums = add_force(sums, -amount / along * normal, unit)
        sums.camera -= amount * wp.vec4(slope[0] * ray[0], slope[1] * ray[1], slope[0], slope[1])
    return sums


@wp.struct
class Forces:
    """Sums over the forces on each of P ellipsoids, in S shares to be added up, one of each warp that worked on it."""

    values: wp.array4d[float]  # (B, P, S, 16) force, moment row by row, camera


@wp.struct
class Worker:
    """Place of a thread among those that share an ellipsoid's work."""

    b: int
    k: int
    share: int
    lane: int
    number: int  # of ``count`` threads
    count: int


@wp.func
def worker_of(forces: Forces, lanes: int, thread: int):
    """Split the number of a thread: ``lanes`` to a share, S shares to an ellipsoid."""
    parts = forces.values.shape[1]
    shares = forces.values.shape[2]
    w = Worker()
    w.count = lanes * shares
    ellipsoid = thread // w.count
    w.number = thread - ellipsoid * w.count
    w.share = w.number // lanes
    w.lane = w.number - w.share * lanes
    w.b = ellipsoid // parts
    w.k = ellipsoid - w.b * parts
    return w


@wp.func
def store_forces(forces: Forces, w: Worker, sums: SurfaceForces):
    """Add up the threads of a share and store it."""
    shares = forces.values[w.b, w.k]
    for i in range(3):
        force = sum_lanes(sums.force[i])
        if w.lane == 0:
            shares[w.share, i] = force
        for j in range(3):
            moment = sum_lanes(sums.moment[i, j])
            if w.lane == 0:
                shares[w.share, 3 + 3 * i + j] = moment
    for i in range(4):
        camera = sum_lanes(sums.camera[i])
        if w.lane == 0:
            shares[w.share, 12 + i] = camera


@wp.func
def add_shares(forces: Forces, b: int, k: int, i: int):
    """Sum one of the 16 numbers of an ellipsoid's forces over its shares."""
    shares = forces.values[b, k]
    total = float(0.0)
    for share in range(shares.shape[0]):
        total += shares[share, i]
    return total


@wp.kernel
def spread_forces(
    axes: wp.array2d[wp.mat33],  # (B, P)
    semi_axes: wp.array2d[wp.vec3],  # (B, P)
    forces: Forces,
    lanes: int,  # threads of a warp, each of which adds some of the shares
    grad_centres: wp.array2d[wp.vec3],  # (B, P)  OUTPUT
    grad_axes: wp.array2d[wp.mat33],  # (B, P)  OUTPUT
    grad_semi_axes: wp.array2d[wp.vec3],  # (B, P)  OUTPUT
    grad_camera: wp.array[wp.vec4],  # (B,)  OUTPUT
):
    """Gradients with respect to centres, axes, semi-axes and, by one warp more, the camera."""
    thread = wp.tid()
    parts = axes.shape[1]
    lane = thread % lanes
    b = (thread // lanes) // (parts + 1)
    k = thread // lanes - b * (parts + 1)
    shares = forces.values.shape[2]
    if k == parts:
        camera = wp.vec4()
        for n in range(lane, parts * shares, lanes):
            values = forces.values[b, n // shares]
            for i in range(4):
                camera[i] += values[n % shares, 12 + i]
        for i in range(4):
            camera[i] = sum_lanes(camera[i])
        if lane == 0:
            grad_camera[b] = camera
        return
    force = wp.vec3()
    moment = wp.mat33()
    values = forces.values[b, k]
    for share in range(lane, shares, lanes):
        for i in range(3):
            force[i] += values[share, i]
            for j in range(3):
                moment[i, j] += values[share, 3 + 3 * i + j]
    for i in range(3):
        force[i] = sum_lanes(force[i])
        for j in range(3):
            moment[i, j] = sum_lanes(moment[i, j])
    if lane == 0:
        grad_centres[b, k] = force
        grad_axes[b, k] = moment * wp.diag(semi_axes[b, k])
        grad_semi_axes[b, k] = wp.get_diag(wp.transpose(axes[b, k]) * moment)


@wp.kernel
def sum_rows(
    values: wp.array2d[float],  # (B, N)
    totals: wp.array[float],  # (B,)  OUTPUT
):
    """Sum of each row, one thread a body, in a fixed order."""
    b = wp.tid()
    total = float(0.0)
    for i in range(values.shape[1]):
        total += values[b, i]
    totals[b] = total


_FEW = 32  # threads a block where a launch has few: more blocks, so more of the GPU, share them
BLOCK = 64  # of the kernels that fill forces
NUM_SUMS = 16  # of an ellipsoid's forces
_WARPS_TO_FILL = 2048  # of 132 multiprocessors
_MAX_SHARES = 16  # measured: docs/performance.md


def make_scene(ellipsoids: Sequence[wp.array], seen: Seen, parts: wp.array, *, perspective: bool) -> SceneArrays:
    """Scene of centres, axes, semi-axes and camera, after ``launch_see`` and ``launch_draw``."""
    scene = SceneArrays()
    scene.centres, scene.axes, scene.semi_axes, scene.camera = ellipsoids
    scene.silhouettes, scene.neighbours, scene.creases = seen.silhouettes, seen.neighbours, seen.creases
    scene.parts, scene.perspective = parts, perspective
    return scene


def make_forces(batch: int, parts: int, device: wp.Device) -> Forces:
    """Allocate the sums of forces, in as many shares as it takes to fill the device."""
    shares = 1
    if not device.is_cpu:
        shares = max(min(_WARPS_TO_FILL // max(batch * parts, 1), _MAX_SHARES), 1)
    forces = Forces()
    forces.values = wp.empty((batch, parts, shares, NUM_SUMS), dtype=float, device=device)
    return forces


def cut_forces(forces: Forces, part: slice) -> Forces:
    """Forces of a slice of the bodies."""
    if part.stop - part.start == forces.values.shape[0]:
        return forces
    cut = Forces()
    cut.values = forces.values[part]
    return cut


def launch_on_ellipsoids(kernel: wp.Kernel, inputs: Sequence[object], forces: Forces) -> None:
    """Launch a kernel whose threads find their work by ``worker_of``, given the number of lanes and the forces last."""
    device = forces.values.device
    lanes = _lanes(device)
    dim = forces.values.size // NUM_SUMS * lanes
    wp.launch(kernel, dim, [*inputs, lanes], [forces], device=device, block_dim=BLOCK)


def _lanes(device: wp.Device) -> int:
    return 1 if device.is_cpu else int(LANES)


def launch_spread(
    axes: wp.array,
    semi_axes: wp.array,
    forces: Forces,
    *,
    grad_centres: wp.array,
    grad_axes: wp.array,
    grad_semi_axes: wp.array,
    grad_camera: wp.array,
) -> None:
    """Fill the gradients from the sums of forces."""
    batch, parts = axes.shape
    lanes = _lanes(axes.device)
    wp.launch(
        spread_forces,
        batch * (parts + 1) * lanes,
        [axes, semi_axes, forces, lanes],
        [grad_centres, grad_axes, grad_semi_axes, grad_camera],
        device=axes.device,
        block_dim=BLOCK,
    )


def launch_sum_rows(values: wp.array, totals: wp.array) -> None:
    """Fill the sum of each row."""
    wp.launch(sum_rows, values.shape[0], [values], [totals], device=values.device, block_dim=_FEW)
