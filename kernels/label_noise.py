"""Noise of part labels, pixel by pixel: areas, boundaries that wander, the commonest of nine, growth.

Each pass reads and writes a pixel about once, where torch has a pass for each operation. Numbers are rounded as torch
rounds them, so that results are the same, to the bit.
"""

import warp as wp

from .labels import IGNORE
from .lanes import num_lanes

# Torch doesn't fuse multiplications and additions of different operations.
wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@wp.func
def looked_up(tables: wp.array2d[wp.uint8], n: int, label: wp.uint8) -> wp.uint8:
    """Entry of a part label in table n; the last one is that of 255."""
    return tables[n, wp.min(int(label), tables.shape[1] - 1)]


@wp.func
def beside(labels: wp.array3d[wp.uint8], n: int, row: int, column: int) -> wp.uint8:
    """Label of a pixel; beyond the border that of the nearest one."""
    return labels[n, wp.clamp(row, 0, labels.shape[1] - 1), wp.clamp(column, 0, labels.shape[2] - 1)]


@wp.kernel
def count_labels(
    labels: wp.array3d[wp.uint8],  # (B, S, S)
    counts: wp.array2d[int],  # (B, L), of labels 1 to L, zeros before  OUTPUT
):
    """Count pixels. A thread goes down a column and adds what is alike at once."""
    n, column = wp.tid()
    before, length = int(0), int(0)
    for row in range(labels.shape[1]):
        label = int(labels[n, row, column])
        if label != before:
            if before >= 1 and before <= counts.shape[1]:
                wp.atomic_add(counts, n, before - 1, length)
            before, length = label, int(0)
        length += 1
    if before >= 1 and before <= counts.shape[1]:
        wp.atomic_add(counts, n, before - 1, length)


@wp.kernel
def take_from_beside(
    labels: wp.array3d[wp.uint8],  # (B, S, S), parts
    coarse: wp.array4d[float],  # (B, 2, S, S), way down and to the right [px]
    fine: wp.array4d[float],  # the same, to be added
    tables: wp.array2d[wp.uint8],  # (B, 22), what each part is called
    lanes: int,
    found: wp.array3d[wp.uint8],  # (B, S, S)  OUTPUT
):
    """Labels from a little way off, through their tables. One thread a row, or some of its columns."""
    n, row, lane = wp.tid()
    height, width = labels.shape[1], labels.shape[2]
    for column in range(lane, width, lanes):
        down = float(row) + (coarse[n, 0, row, column] + fine[n, 0, row, column])
        right = float(column) + (coarse[n, 1, row, column] + fine[n, 1, row, column])
        y = int(wp.clamp(wp.rint(down), 0.0, float(height - 1)))
        x = int(wp.clamp(wp.rint(right), 0.0, float(width - 1)))
        found[n, row, column] = looked_up(tables, n, labels[n, y, x])


@wp.func
def same_of_nine(labels: wp.array3d[wp.uint8], n: int, row: int, column: int, apart: int, label: wp.uint8) -> int:
    """Number of the nine pixels about one that have this label."""
    same = int(0)
    for i in range(3):
        for j in range(3):
            if beside(labels, n, row + (i - 1) * apart, column + (j - 1) * apart) == label:
                same += 1
    return same


@wp.kernel
def take_commonest(
    labels: wp.array3d[wp.uint8],  # (B, S, S)
    chosen: wp.array[wp.bool],  # (B,), the other images stay as they are
    apart: int,  # [px]
    lanes: int,
    found: wp.array3d[wp.uint8],  # (B, S, S)  OUTPUT
):
    """Find the commonest label of nine: of a tie the pixel's own, then in the order 0, -1, +1 down, then right."""
    n, row, lane = wp.tid()
    yes = chosen[n]
    for column in range(lane, labels.shape[2], lanes):
        best = labels[n, row, column]
        if yes:
            most = same_of_nine(labels, n, row, column, apart, best)
            if most < 5:  # of nine, five are the most whatever the others are
                for k in range(1, 9):
                    i, j = k // 3, k % 3
                    down, right = wp.where(i == 2, 1, -i), wp.where(j == 2, 1, -j)
                    label = beside(labels, n, row + down * apart, column + right * apart)
                    votes = same_of_nine(labels, n, row, column, apart, label)
                    if votes > most:
                        best, most = label, votes
        found[n, row, column] = best


@wp.kernel
def grow_or_shrink(
    labels: wp.array3d[wp.uint8],  # (B, S, S), 0 = background, 255 = unknown
    pixels: wp.array[float],  # (B,), how far people are to grow in all; negative: to shrink
    step: int,  # pixels that they have grown or shrunk by so far
    lanes: int,
    found: wp.array3d[wp.uint8],  # (B, S, S)  OUTPUT
):
    """People a pixel wider, by the greatest label beside, or narrower. One thread a row, or some of its columns."""
    n, row, lane = wp.tid()
    wider, narrower = pixels[n] > float(step), pixels[n] < -float(step)
    background, unknown = wp.uint8(0), wp.uint8(IGNORE)
    for column in range(lane, labels.shape[2], lanes):
        label = labels[n, row, column]
        if (wider and label == background) or (narrower and label != background and label != unknown):
            greatest, bare = background, bool(False)
            for k in range(4):
                side = 1 - 2 * (k % 2)
                down, right = wp.where(k < 2, side, 0), wp.where(k < 2, 0, side)
                other = beside(labels, n, row + down, column + right)
                if other == background:
                    bare = True
                elif other != unknown:
                    greatest = wp.max(greatest, other)
            if wider:
                label = greatest
            elif bare:
                label = background
        found[n, row, column] = label


def launch_areas(labels: wp.array, counts: wp.array) -> None:
    """Launch ``count_labels``."""
    dim = labels.shape[0], labels.shape[2]
    wp.launch(count_labels, dim, [labels], [counts], device=labels.device)


def launch_from_beside(labels: wp.array, fields: tuple[wp.array, wp.array], tables: wp.array, found: wp.array) -> None:
    """Launch ``take_from_beside``."""
    dim = *labels.shape[:2], num_lanes(labels.device)
    wp.launch(take_from_beside, dim, [labels, *fields, tables, dim[2]], [found], device=labels.device)


def launch_commonest(labels: wp.array, chosen: wp.array, apart: int, found: wp.array) -> None:
    """Launch ``take_commonest``."""
    dim = *labels.shape[:2], num_lanes(labels.device)
    wp.launch(take_commonest, dim, [labels, chosen, apart, dim[2]], [found], device=labels.device)


def launch_growth(labels: wp.array, pixels: wp.array, step: int, found: wp.array) -> None:
    """Launch ``grow_or_shrink``."""
    dim = *labels.shape[:2], num_lanes(labels.device)
    wp.launch(grow_or_shrink, dim, [labels, pixels, step, dim[2]], [found], device=labels.device)
