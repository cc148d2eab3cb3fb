"""Normals of a mesh's vertices."""

from __future__ import annotations

import numpy as np
import torch


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Normals of vertices (V, 3), weighted by the areas of the faces (F, 3) around them, of unit length, shape (V, 3).

    Of a vertex without faces, or between faces that cancel out: 0.
    """
    corners = vertices[faces]
    of_faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    corners_of = torch.from_numpy(faces.astype(np.int64).ravel())
    normals = np.empty_like(vertices)
    for axis in range(3):  # sums of one column in the faces' order, many times as fast as np.add.at
        column = torch.from_numpy(np.repeat(of_faces[:, axis], 3))
        normals[:, axis] = torch.zeros(len(vertices), dtype=column.dtype).index_add_(0, corners_of, column).numpy()
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
