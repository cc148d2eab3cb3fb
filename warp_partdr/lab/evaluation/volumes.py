"""Volumes that closed surfaces share, on a grid: how far bodies stand in one another."""

from __future__ import annotations

from itertools import combinations

import numpy as np

STEP = 0.01  # [m], of the grid
_OFFSET = np.array([0.00137, 0.00271, 0.00613])  # of the grid [m], so that nothing lies on its lines


def shared_volume(bodies: np.ndarray, faces: np.ndarray) -> float:
    """Volume that lies in two of P bodies [cm^3], each pair by itself, of vertices (P, V, 3) [m] and faces (F, 3)."""
    total = 0.0
    for pair in combinations(bodies, 2):
        # Surfaces share at most what lies in both boxes.
        low, high = np.max([each.min(0) for each in pair], 0), np.min([each.max(0) for each in pair], 0)
        if (high > low).all():
            first, count = point_grid(np.stack([low, high]))
            one, other = (windings(each, faces, first, count) > 0 for each in pair)
            total += float((one & other).sum())
    return total * (100 * STEP) ** 3


def point_grid(points: np.ndarray) -> tuple[np.ndarray, tuple[int, ...]]:
    """Place of the first grid point, shape (3,), and how many there are each way, around points (N, 3)."""
    low = np.floor(points.min(0) / STEP) * STEP - STEP + _OFFSET
    return low, tuple(np.ceil((points.max(0) - low) / STEP).astype(int) + 2)


def windings(points: np.ndarray, faces: np.ndarray, low: np.ndarray, count: tuple[int, ...]) -> np.ndarray:
    """Number of times that a closed surface goes around each point of a grid, shape ``count``.

    A line along z through each column of grid points changes it by 1 wherever it goes through a face.
    """
    corners = (points[faces].astype(np.float64) - low) / STEP
    most = np.array(count[:2]) - 1
    first = np.maximum(np.ceil(corners[..., :2].min(1)), 0).astype(int)
    last = np.minimum(np.floor(corners[..., :2].max(1)), most).astype(int)
    sizes = np.maximum(last - first + 1, 0)
    repeats = sizes.prod(1)
    face = np.repeat(np.arange(len(faces)), repeats)
    within = np.arange(repeats.sum()) - np.repeat(np.cumsum(repeats) - repeats, repeats)
    column = first[face] + np.stack(np.divmod(within, sizes[face, 1]), axis=1)
    a, b, c = (corners[face, k] for k in range(3))
    areas = np.stack([_area(b, c, column), _area(c, a, column), _area(a, b, column)], axis=1)
    hit = (areas > 0).all(1) | (areas < 0).all(1)
    areas, column = areas[hit], column[hit]
    whole = areas.sum(1)
    height = np.floor((areas * corners[face[hit]][..., 2]).sum(1) / whole).astype(int)
    changes = np.zeros(count, dtype=np.int16)
    # Points below the surface, where it looks up, are inside; what lies above the grid is above all its points.
    above = height >= 0
    place = (*column[above].T, np.minimum(height[above], count[2] - 1))
    np.add.at(changes, place, np.sign(whole[above]).astype(np.int16))
    return changes[..., ::-1].cumsum(-1)[..., ::-1]


def _area(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Twice the signed area of triangles in the plane of x and y."""
    return (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
