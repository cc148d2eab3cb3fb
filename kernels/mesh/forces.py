"""Forces on a mesh's vertices, added as whole numbers: whichever order threads add them in, the sum is the same.

A force is counted in units of a power of two. They are so large that the sum of all forces that there can be has room
in an integer of 64 bits, and far smaller than what a float leaves out.
"""

import math
from typing import Any

import numpy as np
import warp as wp

from ..labels import flat
from .rasterize import launch_bodies

wp.set_module_options({"enable_backward": False})

_SUM_BITS = 62
_MOST = wp.constant(2.0**_SUM_BITS)  # [units]
_EXPONENT = wp.constant(0x7F800000)  # of a float: its bits, all of them for what is no number
_LEAST = wp.constant(2.0**-80)  # bound of a loss gradient below which forces lose digits, so that units are a float
_LARGEST_OF_LABELS = int(np.float32(2.0).view(np.int32))  # of ``pixel_gradient``
_EACH = 64  # numbers of the maps for a thread on CUDA


@wp.struct
class Forces:
    """Forces on the vertices of B bodies."""

    sums: wp.array3d[wp.int64]  # (B, V, 3) [units], 0 between launches
    largest: wp.array[int]  # (B,) bound of the loss gradient of a pixel: a float's bits
    faults: wp.array[float]  # (B,) as in ``ImageArrays``; NaN, too, where a force is no number
    units: float  # of a force of 1 if the loss gradient is below 1


@wp.func
def units_of(forces: Forces, b: int):
    """Units of a force of 1 on a body, a power of two; NaN if the loss gradient has no bound."""
    exponent = forces.largest[b] & _EXPONENT
    power = wp.cast(exponent, wp.float32)  # of two, at most the bound
    return wp.where(exponent < _EXPONENT, forces.units / (2.0 * wp.max(power, _LEAST)), wp.nan)


@wp.func
def push_vertex(forces: Forces, b: int, vertex: int, axis: int, count: float):
    """Add a force [units] to a vertex."""
    if wp.abs(count) < _MOST:
        wp.atomic_add(forces.sums, b, vertex, axis, wp.int64(count))
    else:
        forces.faults[b] = wp.nan  # all who find one write the same


@wp.func_native("""
    // Bits of floats without a sign are in the order of their values; NaN comes last. Compilers know this loop.
    int largest = 0;
    for (int at = first; at < size; at += step) {
        const int bits = ((const int*)values)[at] & 0x7FFFFFFF;
        largest = bits > largest ? bits : largest;
    }
    return largest;
""")
def largest_magnitude(values: wp.uint64, first: int, size: int, step: int) -> int:  # type: ignore[empty-body]
    """Bits of the largest magnitude of every ``step``-th of an array's floats; more than infinity's if one is NaN."""
    ...


@wp.kernel
def find_largest(
    first_body: int,
    threads: int,  # of one body
    maps: wp.array4d[float],  # (B, K, H, W) loss gradient
    largest: wp.array[int],  # (B,) bits of floats, zeroed  MODIFIED: the largest of the magnitudes
):
    """Bound of a loss gradient with respect to part maps."""
    thread = wp.tid()
    b = first_body + thread // threads
    size = maps.shape[1] * maps.shape[2] * maps.shape[3]
    mine = largest_magnitude(maps[b].ptr, thread % threads, size, threads)
    if mine > largest[b]:  # it only grows, so a stale value is safe
        wp.atomic_max(largest, b, mine)


@wp.kernel
def take_forces(
    first_body: int,
    threads: int,  # of one body
    each: int,  # numbers that a thread takes
    forces: Forces,  # MODIFIED: 0 again
    depth_weight: float,  # the paper's lambda [m], a factor of z
    grad_vertices: wp.array3d[float],  # (B, V, 3)  OUTPUT
):
    """Gradient of the vertices; NaN for a body with a fault."""
    thread = wp.tid()
    b = first_body + thread // threads
    first = thread % threads * each
    sums = flat(forces.sums[b])
    gradient = flat(grad_vertices[b])
    fault = forces.faults[b]
    force = 1.0 / units_of(forces, b)
    for k in range(first, first + each):
        weight = wp.where(k % 3 == 2, depth_weight, 1.0)
        gradient[k] = float(sums[k]) * force * weight + fault
        sums[k] = wp.int64(0)


def make_vertex_forces(
    size: tuple[int, int],
    num_vertices: int,
    num_edges: int,
    faults: wp.array,
    *,
    depth_slope: float,
    maps: wp.array | None = None,
) -> Any:
    """Forces of B bodies, 0, for a LabelTarget, or for a gradient with respect to part maps.

    Args:
        size: Height and width of the picture.
        num_vertices: Number of a body's vertices, V.
        num_edges: Number of a body's edges.
        faults: Faults of the picture, shape (B,).
        depth_slope: Largest slope of a face's depth, for a loss gradient of 1 and a weight of 1.
        maps: Gradient with respect to part maps (B, K, H, W). ``launch_find_largest`` looks at its numbers.
    """
    batch, device = len(faults), faults.device
    forces = Forces()
    forces.sums = wp.zeros((batch, num_vertices, 3), dtype=wp.int64, device=device)
    forces.faults = faults
    forces.largest = wp.full(batch, _LARGEST_OF_LABELS, dtype=int, device=device)
    labels = 1 if maps is None else maps.shape[1]  # that may come forward at one pixel
    # All forces that one vertex can get, from a loss gradient below 1. In the plane: each edge ends there, is crossed
    # by all lines, and each line's pixels pull either way, over distances of 1, 1, 2, 3, ... In depth: all pixels push
    # it, as part of the face that is hidden and of the one that hides it.
    lines = max(size)
    in_plane = 2 * num_edges * lines * (2 + math.log(lines))
    in_depth = 2 * labels * math.prod(size) * depth_slope
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
    batch, size = grad.shape[0], math.prod(grad.shape[1:])
    each = size if grad.device.is_cpu else 1
    launch_bodies(take_forces, batch, size // max(each, 1), [each, forces, depth_weight], [grad], grad.device)
