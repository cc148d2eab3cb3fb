"""The unit sphere that every ellipsoid is deformed from: an icosahedron, subdivided (paper, section 3.3)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ..errors import check_whole

MAX_SUBDIVISIONS = 3


@lru_cache(maxsize=2 * (MAX_SUBDIVISIONS + 1), typed=True)  # so that 1.0 and True are not found as 1
def icosphere(subdivisions: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (N, 3) float64 on the unit sphere and faces (F, 3) int32, outward: F = 20, 80, 320 or 1280.

    Raises:
        ValueError: If ``subdivisions`` is not 0, 1, 2 or 3.
    """
    subdivisions = check_whole("subdivisions", subdivisions, 0, MAX_SUBDIVISIONS)
    from trimesh.creation import icosphere as make  # loaded when a mesh is asked for

    mesh = make(subdivisions=subdivisions)
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    return vertices / np.linalg.norm(vertices, axis=1, keepdims=True), np.asarray(mesh.faces, dtype=np.int32)
