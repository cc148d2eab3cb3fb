"""Tensors of B bodies in one block of memory: one tensor after the other, or all numbers of a body in one row."""

from __future__ import annotations

import math
from functools import lru_cache

import torch

Shapes = tuple[torch.Size, ...]  # each (B, ...)
Tensors = tuple[torch.Tensor, ...]


def as_floats(*tensors: torch.Tensor) -> Tensors:
    """Tensors in float32; those that are so already stay as they are, for even to ask torch for it takes a while."""
    return tuple([tensor if tensor.dtype is torch.float32 else tensor.float() for tensor in tensors])


def split_blocks(numbers: torch.Tensor, shapes: Shapes) -> Tensors:
    """Make views with these shapes of contiguous numbers, one after the other: copies into them are fast."""
    first = numbers.storage_offset()
    return tuple([numbers.as_strided(shape, strides, first + start) for shape, strides, start in _blocks(shapes)])


def split_rows(numbers: torch.Tensor, shapes: Shapes, first: int = 0) -> Tensors:
    """Make views with these shapes of rows (B, R) that begin at number ``first``: a factor for each body is fast."""
    return tuple([numbers.as_strided(shape, strides, first + start) for shape, strides, start in row_views(shapes)])


def total_length(shapes: Shapes) -> int:
    """Count the numbers of tensors with these shapes."""
    return sum(map(math.prod, shapes))


def row_length(shapes: Shapes) -> int:
    """Count a body's numbers in tensors with these shapes, R."""
    return sum(math.prod(shape[1:]) for shape in shapes)


_View = tuple[torch.Size, tuple[int, ...], int]  # shape, strides and first number


@lru_cache(maxsize=64)
def row_views(shapes: Shapes) -> list[_View]:
    """Shape, strides and first number of each tensor in rows (B, R)."""
    length = row_length(shapes)
    views: list[_View] = []
    start = 0
    for shape in shapes:
        views.append((shape, (length, *_strides(shape)[1:]), start))
        start += math.prod(shape[1:])
    return views


@lru_cache(maxsize=64)
def _blocks(shapes: Shapes) -> list[_View]:
    views: list[_View] = []
    start = 0
    for shape in shapes:
        views.append((shape, _strides(shape), start))
        start += math.prod(shape)
    return views


def _strides(shape: torch.Size) -> tuple[int, ...]:
    return tuple([max(math.prod(shape[k + 1 :]), 1) for k in range(len(shape))])
