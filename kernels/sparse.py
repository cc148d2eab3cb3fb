"""Sparse matrices row by row, and points that are sums of few others."""

from collections.abc import Sequence
from typing import Any

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.struct
class SparseRows:
    """Entries of a matrix that are not zero."""

    starts: wp.array[int]  # (R + 1,) where the entries of each row begin
    columns: wp.array[int]
    values: wp.array[float]


@wp.func
def point_of(first: wp.array2d[wp.vec3], second: wp.array2d[wp.vec3], b: int, place: int):
    """Point of both arrays in a row."""
    if place < first.shape[1]:
        return first[b, place]
    return second[b, place - first.shape[1]]


@wp.kernel
def sum_entries(
    rows: SparseRows,  # R rows of n + m columns
    first: wp.array2d[wp.vec3],  # (B, n)
    second: wp.array2d[wp.vec3],  # (B, m)
    sums: wp.array2d[wp.vec3],  # (B, R)  OUTPUT
):
    """One thread a sum."""
    b, row = wp.tid()
    total = wp.vec3()
    for k in range(rows.starts[row], rows.starts[row + 1]):
        total += rows.values[k] * point_of(first, second, b, rows.columns[k])
    sums[b, row] = total


@wp.kernel
def sum_entries_adjoint(
    columns: SparseRows,  # the matrix's transpose
    adjoint: wp.array2d[wp.vec3],  # (B, R)
    grad_first: wp.array2d[wp.vec3],  # (B, n)  OUTPUT
    grad_second: wp.array2d[wp.vec3],  # (B, m)  OUTPUT
):
    """One thread a point."""
    b, place = wp.tid()
    total = wp.vec3()
    for k in range(columns.starts[place], columns.starts[place + 1]):
        total += columns.values[k] * adjoint[b, columns.columns[k]]
    if place < grad_first.shape[1]:
        grad_first[b, place] = total
    else:
        grad_second[b, place - grad_first.shape[1]] = total


def gather_rows(starts: wp.array, columns: wp.array, values: wp.array) -> Any:
    """Rows of these arrays."""
    rows = SparseRows()
    rows.starts, rows.columns, rows.values = starts, columns, values
    return rows


def launch_sum_points(rows: Any, points: Sequence[wp.array], sums: wp.array) -> None:
    """Fill ``sums``."""
    wp.launch(sum_entries, sums.shape, [rows, *points, sums], device=sums.device)


def launch_sum_points_adjoint(columns: Any, adjoint: wp.array, gradients: Sequence[wp.array]) -> None:
    """Fill ``gradients`` with respect to both arrays of points from the ``adjoint`` of the sums."""
    shape = adjoint.shape[0], gradients[0].shape[1] + gradients[1].shape[1]
    wp.launch(sum_entries_adjoint, shape, [columns, adjoint, *gradients], device=adjoint.device)
