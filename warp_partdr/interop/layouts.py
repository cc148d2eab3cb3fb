"""Tensors of B bodies in one piece of memory: one after the other, or a body's numbers side by side."""

from __future__ import annotations

import math
from functools import lru_cache

import torch

Shapes = tuple[torch.Size, ...]  # each (B, ...)
Tensors = tuple[torch.Tensor, ...]


def split_blocks(numbers: torch.Tensor, shapes: Shapes) -> Tensors:
    """Views of these shapes into contiguous numbers, one after the other: what many copies at once are fast into."""
    return tuple([numbers.as_strided(*place) for place in _blocks(shapes)])


def split_rows(numbers: torch.Tensor, shapes: Shapes, first: int = 0) -> Tensors:
    """Views of these shapes into rows (B, R) that begin at number ``first``: what a factor for each body is fast on."""
    return tuple([numbers.as_strided(shape, strides, first + start) for shape, strides, start in row_places(shapes)])


def total_length(shapes: Shapes) -> int:
    """Count the numbers of all."""
    return sum(map(math.prod, shapes))


def row_length(shapes: Shapes) -> int:
    """Number of a body's values, R."""
    return sum(math.prod(shape[1:]) for shape in shapes)


_Place = tuple[torch.Size, tuple[int, ...], int]  # shape, strides and first number


@lru_cache(maxsize=64)
def row_places(shapes: Shapes) -> list[_Place]:
    """Shape, strides and offset of each tensor in rows."""
    length, places, start = row_length(shapes), [], 0
    for shape in shapes:
        places.append((shape, (length, *_strides(shape)[1:]), start))
        start += math.prod(shape[1:])
    return places


@lru_cache(maxsize=64)
def _blocks(shapes: Shapes) -> list[_Place]:
    places, start = [], 0
    for shape in shapes:
        places.append((shape, _strides(shape), start))
        start += math.prod(shape)
    return places


def _strides(shape: torch.Size) -> tuple[int, ...]:
    return tuple([max(math.prod(shape[k + 1 :]), 1) for k in range(len(shape))])
