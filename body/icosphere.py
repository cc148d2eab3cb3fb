"""The unit sphere that every ellipsoid is deformed from: an icosahedron, subdivided (paper, section 3.3)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ..errors import check_whole

MAX_SUBDIVISIONS = 3

_SHORT, _LONG = 0.5257311121191336, 0.85065080835204  # half sides of the three rectangles in an icosahedron
_FACES = np.array(
    "0 11 5  0 5 1  0 1 7  0 7 10  0 10 11  1 5 9  5 11 4  11 10 2  10 7 6  7 1 8"
    "  3 9 4  3 4 2  3 2 6  3 6 8  3 8 9  4 9 5  2 4 11  6 2 10  8 6 7  9 8 1".split(),
    dtype=np.int32,
).reshape(-1, 3)


@lru_cache(maxsize=2 * (MAX_SUBDIVISIONS + 1), typed=True)  # so that 1.0 and True are not found as 1
def icosphere(subdivisions: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (N, 3) float64 on the unit sphere and faces (F, 3) int32, outward: F = 20, 80, 320 or 1280.

    They are those of ``trimesh.creation.icosphere``, without half a second for its import.

    Raises:
        ValueError: If ``subdivisions`` is not 0, 1, 2 or 3.
    """
    subdivisions = check_whole("subdivisions", subdivisions, 0, MAX_SUBDIVISIONS)
    rectangle = np.array([(x * _SHORT, y * _LONG, 0.0) for y in (1, -1) for x in (-1, 1)])
    vertices, faces = np.concatenate([np.roll(rectangle, turns, axis=1) for turns in range(3)]), _FACES
    for _ in range(subdivisions):
        sides = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        edges, halves = np.unique(sides[:, ::-1], axis=0, return_inverse=True)
        (a, b, c), (ab, bc, ca) = faces.T, (halves.reshape(-1, 3) + len(vertices)).T
        faces = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3).astype(np.int32)
        vertices = np.concatenate([vertices, vertices[edges[:, ::-1]].mean(axis=1)])
        lengths = np.linalg.norm(vertices, axis=1, keepdims=True)
        vertices += vertices / lengths * (1 - lengths)
    return vertices / np.linalg.norm(vertices, axis=1, keepdims=True), faces
