"""Gradients as forces F = dL/dX on surface points X = c + A diag(a) u of an ellipsoid (u on the unit sphere).

Two sums over the forces give the gradients of all parameters, force = sum F and moment = sum F u^T:
dL/dc = force, dL/dA = moment diag(a), dL/da = diag(A^T moment).
"""

from collections.abc import Sequence
from typing import Any

import warp as wp

from ..labels import flat, target_of
from ..lanes import SIXTEEN, Sixteen, ballot, num_lanes, shuffle_float, sum_lanes, sum_sixteen
from .silhouette import BROKEN, Seen, Silhouette

wp.set_module_options({"enable_backward": False})

_MANY_ITEMS = wp.constant(2**24)  # of work, which any number of shares is worth; more could overflow


@wp.struct
class Ellipsoid:
    """One posed ellipsoid before its camera."""

    centre: wp.vec3  # [m]
    axes: wp.mat33  # columns
    semi_axes: wp.vec3  # [m]
    camera: wp.vec4  # f_x, f_y, c_x, c_y
    perspective: bool


@wp.struct
class SceneArrays:
    """B bodies of P ellipsoids and their picture: the input of every estimator of a gradient."""

    centres: wp.array2d[wp.vec3]  # (B, P)
    axes: wp.array2d[wp.mat33]  # (B, P)
    semi_axes: wp.array2d[wp.vec3]  # (B, P)
    camera: wp.array[wp.vec4]  # (B,)
    silhouettes: wp.array2d[Silhouette]  # (B, P)
    neighbours: wp.array3d[wp.uint32]  # (B, P, N) or empty, from ``find_neighbours``
    creases: wp.array3d[wp.uint32]  # (B, P, N)
    parts: wp.array3d[wp.uint8]  # (B, H, W) index + 1 of the ellipsoid shown, 0 = background
    perspective: bool
    lanes: int  # threads of a warp, which share an ellipsoid's work
    least: int  # turns of its threads that are worth a warp, divided by their weight


@wp.struct
class Sampling:
    """Accuracy of the gradient "coverage"."""

    steps_per_pixel: float
    halvings: int  # of a step in which something changes


@wp.struct
class EllipsoidView:
    """One ellipsoid as a thread sees it: views of its body's arrays, cheaper to index than the whole batch."""

    scene: SceneArrays
    b: int
    k: int
    share: int  # of ``shares``, in which warps divide its work
    shares: int
    lane: int
    target: int  # index of the target
    own: Silhouette
    silhouettes: wp.array[Silhouette]  # (P,)
    neighbours: wp.array[wp.uint32]  # (N,) bit j: the boxes of the two outlines overlap
    creases: wp.array[wp.uint32]  # (N,) bit j: and they may be equally near, with different labels
    parts: wp.array[wp.uint8]  # (H W,)
    height: int  # of the picture
    width: int


@wp.func
def make_view(scene: SceneArrays, forces: wp.array4d[float], gradient: Any, thread: int):
    """Split the number of a thread: ``lanes`` to an ellipsoid, all first shares before all second ones.

    So warps that run at the same time do the same kind of work, and share its instructions in the GPU's cache.
    """
    view = EllipsoidView()
    view.scene = scene
    parts = forces.shape[1]
    view.shares = forces.shape[2]
    group = thread // scene.lanes
    view.lane = thread - group * scene.lanes
    view.share = group // (forces.shape[0] * parts)
    ellipsoid = group - view.share * forces.shape[0] * parts
    view.b = ellipsoid // parts
    view.k = ellipsoid - view.b * parts
    view.target = target_of(gradient, view.b)
    view.own = scene.silhouettes[view.b, view.k]
    view.silhouettes = scene.silhouettes[view.b]
    view.neighbours = scene.neighbours[view.b, view.k]
    view.creases = scene.creases[view.b, view.k]
    view.parts = flat(scene.parts[view.b])
    view.height = scene.parts.shape[1]
    view.width = scene.parts.shape[2]
    return view


@wp.func
def find_neighbours(view: EllipsoidView):
    """Fill the sets of ellipsoids that may hide an ellipsoid or meet it: a bit each, 32 to a word.

    Every thread writes all that it will read, so that none waits for another.
    """
    s = view.own
    lanes = view.scene.lanes
    for word in range(view.neighbours.shape[0]):
        near_bits = wp.uint32(0)
        crease_bits = wp.uint32(0)
        for first in range(0, 32, lanes):
            j = 32 * word + first + view.lane
            overlaps = bool(False)
            meets = bool(False)
            if j < view.silhouettes.shape[0] and j != view.k:
                other = view.silhouettes[j]
                low = other.low
                high = other.high
                overlaps = low[0] < s.high[0] and low[1] < s.high[1] and high[0] > s.low[0] and high[1] > s.low[1]
                if other.label != s.label and other.closest > s.farthest and s.closest > other.farthest:
                    meets = overlaps
            near_bits |= ballot(overlaps) << wp.uint32(first)
            crease_bits |= ballot(meets) << wp.uint32(first)
        view.neighbours[word] = near_bits
        view.creases[word] = crease_bits


@wp.struct
class Share:
    """A warp's share in a work on an ellipsoid."""

    number: int
    count: int  # of shares; 0: this warp has none
    turn: int  # items of a turn, at most one for each thread


@wp.func
def take_share(view: EllipsoidView, first: int, most: int, items: int, weight: int):
    """Share in a work on so many items, of at most ``most`` shares from the ``first`` on.

    Little work is left to few warps, for the threads of many would have nothing to do. The ``weight`` of a turn of all
    threads says how soon it is worth a warp.
    """
    share = Share()
    lanes = view.scene.lanes
    some = wp.min(items, _MANY_ITEMS)
    count = wp.clamp(weight * some // (lanes * view.scene.least), 1, most)
    if view.share >= first and view.share < first + count:
        share.number = view.share - first
        share.count = count
        share.turn = wp.clamp((items + count - 1) // count, 1, lanes)
    return share


@wp.func
def load_ellipsoid(view: EllipsoidView):
    e = Ellipsoid()
    e.centre = view.scene.centres[view.b, view.k]
    e.axes = view.scene.axes[view.b, view.k]
    e.semi_axes = view.scene.semi_axes[view.b, view.k]
    e.camera = view.scene.camera[view.b]
    e.perspective = view.scene.perspective
    return e


@wp.struct
class SurfaceForces:
    """Sums over the forces on one ellipsoid."""

    force: wp.vec3
    moment: wp.mat33
    camera: wp.vec4  # dL/d(f_x, f_y, c_x, c_y)


@wp.func
def add_force(sums: SurfaceForces, force: wp.vec3, unit: wp.vec3):
    sums.force += force
    sums.moment += wp.outer(force, unit)
    return sums


@wp.func
def store_forces(forces: wp.array4d[float], view: EllipsoidView, sums: SurfaceForces, more: bool):
    """Add up the threads of a share and store it, or add it as ``more``; the forces on a BROKEN ellipsoid are NaN."""
    values = Sixteen()
    fault = wp.where(view.own.label == BROKEN, wp.nan, 0.0)
    for i in range(3):
        values[i] = sums.force[i] + fault
        for j in range(3):
            values[3 + 3 * i + j] = sums.moment[i, j] + fault
    for i in range(4):
        values[12 + i] = sums.camera[i] + fault
    share = forces[view.b, view.k, view.share]
    if view.scene.lanes == 1:
        for i in range(SIXTEEN):
            share[i] = wp.where(more, share[i], 0.0) + values[i]
    else:
        total = sum_sixteen(values)
        if view.lane < SIXTEEN:
            if more:
                total += share[view.lane]
            share[view.lane] = total


@wp.func
def add_shares(shares: wp.array2d[float], lane: int, lanes: int):
    """Sums over the shares (S, 16) of an ellipsoid's forces, for all threads of a warp."""
    sums = Sixteen()
    if lanes == 1:
        for share in range(shares.shape[0]):
            for i in range(SIXTEEN):
                sums[i] += shares[share, i]
    else:
        # Half of the threads take every other share.
        own = float(0.0)
        for share in range(lane // SIXTEEN, shares.shape[0], 2):
            own += shares[share, lane % SIXTEEN]
        for i in range(SIXTEEN):
            sums[i] = shuffle_float(own, i) + shuffle_float(own, SIXTEEN + i)
    return sums


@wp.func
def sum_row(values: wp.array[float], lane: int, lanes: int):
    """Sum of a row, in a fixed order."""
    total = float(0.0)
    for i in range(lane, values.shape[0], lanes):
        total += values[i]
    return sum_lanes(total)


@wp.kernel
def spread_forces(
    axes: wp.array2d[wp.mat33],  # (B, P)
    semi_axes: wp.array2d[wp.vec3],  # (B, P)
    forces: wp.array4d[float],  # (B, P, S, 16) force, moment row by row, camera: in shares to be added up
    losses: wp.array2d[float],  # (B, T) partial sums of L_seg, or empty
    lanes: int,  # threads of a warp, which share an ellipsoid
    grad_centres: wp.array2d[wp.vec3],  # (B, P)  OUTPUT
    grad_axes: wp.array2d[wp.mat33],  # (B, P)  OUTPUT
    grad_semi_axes: wp.array2d[wp.vec3],  # (B, P)  OUTPUT
    grad_camera: wp.array[wp.vec4],  # (B,)  OUTPUT
    totals: wp.array[float],  # (B,) L_seg, or empty  OUTPUT
):
    """Gradients with respect to centres, axes and semi-axes and, by a warp each, to the camera, and the loss's sum."""
    thread = wp.tid()
    parts = axes.shape[1]
    lane = thread % lanes
    b = (thread // lanes) // (parts + 2)
    k = thread // lanes - b * (parts + 2)
    if k < parts:
        sums = add_shares(forces[b, k], lane, lanes)
        if lane == 0:
            moment = wp.mat33(sums[3], sums[4], sums[5], sums[6], sums[7], sums[8], sums[9], sums[10], sums[11])
            grad_centres[b, k] = wp.vec3(sums[0], sums[1], sums[2])
            grad_axes[b, k] = moment * wp.diag(semi_axes[b, k])
            grad_semi_axes[b, k] = wp.get_diag(wp.transpose(axes[b, k]) * moment)
    elif k == parts:
        shares = forces.shape[2]
        camera = wp.vec4()
        for n in range(lane, parts * shares, lanes):
            values = forces[b, n // shares]
            for i in range(4):
                camera[i] += values[n % shares, 12 + i]
        for i in range(4):
            camera[i] = sum_lanes(camera[i])
        if lane == 0:
            grad_camera[b] = camera
    elif losses.shape[0] > 0:
        total = sum_row(losses[b], lane, lanes)
        if lane == 0:
            totals[b] = total


@wp.kernel
def sum_rows(
    values: wp.array2d[float],  # (B, N)
    lanes: int,  # threads of a warp, which share a row
    totals: wp.array[float],  # (B,)  OUTPUT
):
    """Sum of each row, in a fixed order."""
    thread = wp.tid()
    b = thread // lanes
    lane = thread - b * lanes
    total = sum_row(values[b], lane, lanes)
    if lane == 0:
        totals[b] = total


_FEW = 32  # threads a block where a launch has few: more blocks, so more of the GPU, share them
BLOCK = 64  # of the kernels that fill forces
NUM_SUMS = SIXTEEN  # of an ellipsoid's forces
_WARPS_TO_FILL = 2560  # of 132 multiprocessors
_MAX_SHARES = 16  # measured: docs/measured/performance.md
_MANY = 8192  # ellipsoids that fill the GPU several times
_WORTH = 160  # ellipsoids at which a turn is worth a warp


def make_forces(batch: int, parts: int, device: wp.Device, fewest_shares: int) -> wp.array:
    """Allocate the sums of forces, in as many shares as it takes to fill the device: (B, P, S, 16).

    Large batches have fewer, but two: one kind of work, or the half of a large ellipsoid, for each.
    """
    shares = 1
    if not device.is_cpu:
        ellipsoids = max(batch * parts, 1)
        fewest = fewest_shares if ellipsoids < _MANY else 2
        shares = min(max(_WARPS_TO_FILL // ellipsoids, fewest), _MAX_SHARES)
    return wp.empty((batch, parts, shares, NUM_SUMS), dtype=float, device=device)


def launch_forces(
    kernels: Sequence[wp.Kernel],  # take the scene, its options, the gradient and the forces
    options: Sequence[object],
    ellipsoids: Sequence[wp.array],  # centres, axes, semi-axes, camera
    seen: Seen,
    parts: wp.array,
    *,
    perspective: bool,
    gradient: Any,  # LabelTarget or DenseGradient
    forces: wp.array,
) -> None:
    """Fill the sums of forces on every ellipsoid after ``launch_see`` and ``launch_draw``."""
    scene = SceneArrays()
    scene.centres, scene.axes, scene.semi_axes, scene.camera = ellipsoids
    scene.silhouettes, scene.neighbours, scene.creases = seen.silhouettes, seen.neighbours, seen.creases
    scene.parts, scene.perspective, scene.lanes = parts, perspective, num_lanes(forces.device)
    dim = forces.size // NUM_SUMS * scene.lanes
    scene.least = max(forces.shape[0] * forces.shape[1] // _WORTH, 1)
    for kernel in kernels:
        wp.launch(kernel, dim, [scene, *options, gradient], [forces], device=forces.device, block_dim=BLOCK)


def launch_spread(
    axes: wp.array,
    semi_axes: wp.array,
    forces: wp.array,
    gradients: Sequence[wp.array],
    losses: wp.array,
    totals: wp.array,
) -> None:
    """Fill the gradients with respect to centres, axes, semi-axes and camera from the sums of forces.

    ``totals`` become the sums of the rows of ``losses``, if these are not empty.
    """
    batch, parts = axes.shape
    lanes = num_lanes(axes.device)
    dim = batch * (parts + 2) * lanes
    inputs, outputs = [axes, semi_axes, forces, losses, lanes], [*gradients, totals]
    wp.launch(spread_forces, dim, inputs, outputs, device=axes.device, block_dim=BLOCK)


def launch_sum_rows(values: wp.array, totals: wp.array) -> None:
    """Fill the sum of each row."""
    lanes = num_lanes(values.device)
    wp.launch(sum_rows, values.shape[0] * lanes, [values, lanes], [totals], device=values.device, block_dim=_FEW)
