"""Forces on a mesh's vertices, added as whole numbers: whichever order threads add them in, the sum is the same.

A force is counted in units of a power of two. They are so large that the sum of all forces that there can be has room
in an integer of 64 bits, and far smaller than what a float leaves out.
"""

import math
from typing import Any

import warp as wp

from ..labels import flat
from .rasterize import launch_bodies

wp.set_module_options({"enable_backward": False})

MIN_DELTA_Z = 1.0e-4  # [m]; equal depths would divide by zero in eq. 12

_SUM_BITS = 62
_MOST = wp.constant(2.0**_SUM_BITS)  # [units]
_EXPONENT = wp.constant(wp.uint32(0x7F800000))
_LEAST = wp.constant(2.0**-80)  # bound of a loss gradient below which forces lose digits, so that units are a float
_LARGEST_OF_LABELS = 2.0  # of ``pixel_gradient``
_EACH = 64  # numbers of the maps for a thread on CUDA


@wp.struct
class Forces:
    """Forces on the vertices of B bodies."""

    sums: wp.array3d[wp.int64]  # (B, V, 3) [units], 0 between launches
    largest: wp.array[float]  # (B,) bound of the loss gradient of a pixel
    faults: wp.array[float]  # (B,) as in ``ImageArrays``; NaN, too, where a force is no number
    units: float  # of a force of 1 if the loss gradient is below 1


@wp.func
def units_of(forces: Forces, b: int):
    """Units of a force of 1 on a body, a power of two; NaN if the loss gradient has no bound."""
    largest = forces.largest[b]
    power = wp.cast(wp.cast(largest, wp.uint32) & _EXPONENT, wp.float32)  # of two, at most ``largest``
    return wp.where(largest < wp.inf, forces.units / (2.0 * wp.max(power, _LEAST)), wp.nan)


@wp.func
def add_force(forces: Forces, b: int, vertex: int, axis: int, count: float):
    """Add a force [units] to a vertex."""
    if wp.abs(count) < _MOST:
        wp.atomic_add(forces.sums, b, vertex, axis, wp.int64(count))
    else:
        forces.faults[b] = wp.nan  # all who find one write the same


@wp.kernel
def find_largest(
    first_body: int,
    threads: int,  # of one body
    maps: wp.array4d[float],  # (B, K, H, W) loss gradient
    largest: wp.array[float],  # (B,), zeroed  MODIFIED: largest of the magnitudes; infinity if one is no number
):
    """Bound of a loss gradient with respect to part maps."""
    thread = wp.tid()
    b = first_body + thread // threads
    body = maps[b]
    size = body.shape[0] * body.shape[1] * body.shape[2]
    values = wp.array(ptr=body.ptr, shape=(size,), dtype=float)
    mine = float(0.0)
    for at in range(thread % threads, size, threads):
        value = wp.abs(values[at])
        mine = wp.max(mine, wp.where(value < wp.inf, value, wp.inf))
    if mine > largest[b]:  # it only grows, so a stale value is safe
        wp.atomic_max(largest, b, mine)


@wp.kernel
def take_forces(
    first_body: int,
    threads: int,  # of one body: 3 V
    forces: Forces,  # MODIFIED: 0 again
    depth_weight: float,  # the paper's lambda [m], a factor of z
    grad_vertices: wp.array3d[float],  # (B, V, 3)  OUTPUT
):
    """Gradient of the vertices; NaN for a body with a fault."""
    thread = wp.tid()
    b = first_body + thread // threads
    k = thread % threads
    sums = flat(forces.sums[b])
    force = float(sums[k]) / units_of(forces, b)
    sums[k] = wp.int64(0)
    if k % 3 == 2:
        force *= depth_weight
    flat(grad_vertices[b])[k] = force + forces.faults[b]


def make_forces(
    size: tuple[int, int], num_vertices: int, num_edges: int, faults: wp.array, maps: wp.array | None = None
) -> Any:
    """Forces of B bodies, 0, for a LabelTarget, or for a gradient with respect to part maps.

    Args:
        size: Height and width of the picture.
        num_vertices: Number of a body's vertices, V.
        num_edges: Number of a body's edges.
        faults: Faults of the picture, shape (B,).
        maps: Gradient with respect to part maps (B, K, H, W). ``launch_find_largest`` looks at its numbers.
    """
    batch, device = len(faults), faults.device
    forces = Forces()
    forces.sums = wp.zeros((batch, num_vertices, 3), dtype=wp.int64, device=device)
    forces.faults = faults
    forces.largest = wp.full(batch, _LARGEST_OF_LABELS, dtype=float, device=device)
    labels = 1 if maps is None else maps.shape[1]  # that may come forward at one pixel
    # All forces that one vertex can get, from a loss gradient below 1. In the plane: each edge ends there, is crossed
    # by all lines, and each line's pixels pull either way, over distances of 1, 1, 2, 3, ... In depth: all pixels push
    # it, as part of the face that is hidden and of the one that hides it.
    lines = max(size)
    in_plane = 2 * num_edges * lines * (2 + math.log(lines))
    in_depth = 2 * labels * math.prod(size) * math.log(1 / MIN_DELTA_Z + 1)
    forces.units = 2.0 ** (_SUM_BITS - math.ceil(math.log2(max(in_plane, in_depth))))
    return forces


def launch_find_largest(maps: wp.array, forces: Any) -> None:
    """Bound the forces for a gradient with respect to part maps as it is now."""
    device, (batch, *shape) = forces.largest.device, maps.shape
    forces.largest.zero_()
    threads = 1 if device.is_cpu else -(-math.prod(shape) // _EACH)
    launch_bodies(find_largest, batch, threads, [maps], [forces.largest], device)


def launch_take_forces(forces: Any, depth_weight: float, grad: wp.array) -> None:
    """Fill the gradient of the vertices (B, V, 3), contiguous, and empty the forces."""
    batch, vertices, axes = grad.shape
    launch_bodies(take_forces, batch, vertices * axes, [forces, depth_weight], [grad], grad.device)
