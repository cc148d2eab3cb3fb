"""Matrices of few entries for kernels, made once each."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import torch

from ..kernels.sparse import gather_rows
from .arrays import warp_array
from .captured_function import Fixed


class SparseMatrix(NamedTuple):
    """A matrix for kernels, ``SparseRows`` both ways."""

    rows: Any
    columns: Any


@lru_cache(maxsize=32)
def sparse_matrix(matrix: Fixed) -> SparseMatrix:
    """Entries of a matrix (R, C) of float32 that does not change; waits for the device the first time."""
    with torch.inference_mode(False), torch.no_grad():
        return SparseMatrix(*(_rows(each) for each in (matrix.tensor, matrix.tensor.mT)))


def _rows(matrix: torch.Tensor) -> Any:
    places = matrix.nonzero()  # row by row
    counts = torch.bincount(places[:, 0], minlength=len(matrix))
    starts = torch.nn.functional.pad(counts.cumsum(0), (1, 0)).int()
    values = matrix[places[:, 0], places[:, 1]]
    return gather_rows(warp_array(starts), warp_array(places[:, 1].int().contiguous()), warp_array(values))
