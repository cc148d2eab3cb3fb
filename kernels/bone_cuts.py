"""Masks of people cut into parts, each pixel by the nearest of their bones."""

import warp as wp

from .labels import IGNORE
from .lanes import num_lanes
from .own_pixels import gather

# Torch doesn't fuse multiplications and additions of different operations.
wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@wp.struct
class BoneArrays:
    """Bones of B people, one a part, in crop coordinates."""

    starts: wp.array2d[wp.vec2]  # (B, P)
    ways: wp.array2d[wp.vec2]  # (B, P), to their ends
    squares: wp.array2d[float]  # (B, P), of these ways' lengths
    radii: wp.array2d[float]  # (B, P), half the parts' thicknesses
    unsure: wp.array[wp.bool]  # (B,), pixels within parts that are no neighbours are unknown
    neighbours: wp.array[int]  # (P + 1,), of each label, a bit for each part


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    return hypotf(x, y);
#else
    const double across = x, down = y;
    return ::sqrt(across * across + down * down);
#endif
""")
def length_of(x: float, y: float) -> float:  # type: ignore[empty-body]
    """Length of (x, y) as torch rounds it, on the CPU but for one of some ten million."""
    ...


@wp.kernel
def cut_by_bones(
    mask: wp.array3d[wp.bool],  # (B, S, S)
    bones: BoneArrays,
    centres: wp.array[float],  # (S,), of pixels, crop coordinates
    lanes: int,
    labels: wp.array3d[wp.uint8],  # (B, S, S)  OUTPUT
):
    """Label pixels by the nearest surface about a bone. One thread a row, or some of its columns."""
    n, row, lane = wp.tid()
    for column in range(lane, mask.shape[2], lanes):
        label = int(0)
        if mask[n, row, column]:
            nearest, inside = float(wp.inf), int(0)
            for part in range(bones.starts.shape[1]):
                start, way = bones.starts[n, part], bones.ways[n, part]
                right, down = centres[column] - start[0], centres[row] - start[1]
                share = wp.clamp((right * way[0] + down * way[1]) / bones.squares[n, part], 0.0, 1.0)
                distance = length_of(right - share * way[0], down - share * way[1]) - bones.radii[n, part]
                if distance < nearest:
                    label, nearest = part + 1, distance
                if distance < 0.0:
                    inside |= 1 << part
            if bones.unsure[n] and (inside & ~bones.neighbours[label]) != 0:
                label = IGNORE
        labels[n, row, column] = wp.uint8(label)


def launch_cuts(mask: wp.array, bones: list[wp.array], centres: wp.array, labels: wp.array) -> None:
    """Launch ``cut_by_bones``, with bones in the order of ``BoneArrays``."""
    dim = *mask.shape[:2], num_lanes(mask.device)
    wp.launch(cut_by_bones, dim, [mask, gather(BoneArrays, bones), centres, dim[2]], [labels], device=mask.device)
