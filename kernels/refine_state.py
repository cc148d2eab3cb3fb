"""What the kernels of one refinement iteration share: bodies, their skeleton, and the module that holds them all.

An iteration is five launches beside the renderer's: ``pose_parts``, ``slope_components``, ``cost_parts``,
``gather_gradients``, ``step_parameters``. Each thread owns what it writes and adds in a fixed order, so a run repeats
bit for bit. Bodies that stopped early (``active`` 0) are skipped by all of them.
"""

from collections.abc import Sequence

import warp as wp

# One module for all five: each of its own would cost seconds when compiled first.
MODULE = wp.get_module("warp_partdr.refine")
wp.set_module_options({"enable_backward": False, "fast_math": True}, module=MODULE)
BLOCK = 64  # threads a block on CUDA: small, so that even one body spreads; the same for all, or they compile again

# Columns of the energy's terms.
PROJ = wp.constant(0)
SEG = wp.constant(1)
LENGTH = wp.constant(2)
THICKNESS = wp.constant(3)
PRIOR = wp.constant(4)
LIMITS = wp.constant(5)
NUM_TERMS = 6
Terms = wp.types.vector(length=NUM_TERMS, dtype=wp.float32)


@wp.struct
class Bodies:
    """Views of parameters, or of their gradients, that lie side by side in one row a body."""

    orientation: wp.array2d[wp.vec3]  # (B, 2) columns of the 6D orientation
    rotations: wp.array2d[wp.vec3]  # (B, P) axis times angle [rad]
    lengths: wp.array2d[float]  # (B, number of lengths) [m]
    thicknesses: wp.array2d[float]  # (B, number of thicknesses) [m]
    log_scale: wp.array[float]  # (B,) logarithm of the crop's half-sides a metre
    shift: wp.array[wp.vec2]  # (B,) the root in the crop, -1 to 1


@wp.struct
class Skeleton:
    """The template; a bone points along the first column of its rest axes."""

    parents: wp.array[int]  # (P,) -1 = root
    shape_indices: wp.array[wp.vec3i]  # (P,) length, first and second thickness
    rest_axes: wp.array[wp.mat33]  # (P,) columns: bone, first thickness, second thickness
    subtrees: wp.array[int]  # (P + 1,) bit j: part j moves with part i; the last entry is the root's
    locked: int  # bit k: part k keeps its rest rotation


@wp.struct
class Ellipsoids:
    """Posed parts, and the camera that sees them."""

    centres: wp.array2d[wp.vec3]  # (B, P) [m]
    axes: wp.array2d[wp.mat33]  # (B, P) columns
    semi_axes: wp.array2d[wp.vec3]  # (B, P) [m]
    camera: wp.array[wp.vec4]  # (B,) f_x, f_y, c_x, c_y of the drawn crop [px]


@wp.func
def has_bit(mask: int, bit: int):
    return (mask >> bit) & 1 == 1


@wp.func
def column(m: wp.mat33, index: int):
    return wp.vec3(m[0, index], m[1, index], m[2, index])


def launch(kernel: wp.Kernel, dim: Sequence[int], inputs: Sequence[object], device: wp.Device) -> None:
    """Launch with the common block size."""
    wp.launch(kernel, tuple(dim), list(inputs), device=device, block_dim=BLOCK)
