"""Sparse matrices for kernels, each made once."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch

from ..kernels.sparse import gather_rows
from .arrays import warp_array
from .captured_function import Fixed
from .device_cache import device_cache


class SparseMatrix(NamedTuple):
    """Matrix for kernels, as ``SparseRows`` of its rows and of its columns."""

    rows: Any
    columns: Any


@device_cache(32)
def sparse_matrix(matrix: Fixed) -> SparseMatrix:
    """Make a sparse matrix of a matrix (R, C), float32, that does not change. The first call waits for the device."""
    with torch.inference_mode(False), torch.no_grad():
        return SparseMatrix(*(_rows(each) for each in (matrix.tensor, matrix.tensor.mT)))


def _rows(matrix: torch.Tensor) -> Any:
    indices = matrix.nonzero()  # row by row
    counts = torch.bincount(indices[:, 0], minlength=len(matrix))
    starts = torch.nn.functional.pad(counts.cumsum(0), (1, 0)).int()
    values = matrix[indices[:, 0], indices[:, 1]]
    return gather_rows(warp_array(starts), warp_array(indices[:, 1].int().contiguous()), warp_array(values))
