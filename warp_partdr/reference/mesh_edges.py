"""The mesh renderer's gradient "edges", with loops over pairs of pixels.

1. Each two neighbouring pixels that show different labels have a border half way between their centres.
2. It belongs to the face that shows in the nearer of the two; of equal depths, in the first.
3. As it moves, a pixel's length of area changes hands, so the loss changes by the cost of the first label less that of
   the second, the mean over both pixels. Rows give x, columns give y.
4. A vertex moves the border by its barycentric weight, in the picture, of the face's point there, clamped to the face.
"""

from __future__ import annotations

import numpy as np

from .mesh import MeshPicture, MeshScene, weights_at


def mesh_edges_gradient(scene: MeshScene, picture: MeshPicture, costs: np.ndarray) -> np.ndarray:
    """dL/dvertices (V, 3) from a picture.

    Args:
        scene: Mesh and camera of one body.
        picture: Labels 0 to K, depth and face at each pixel of its picture.
        costs: Cost of a pixel that shows each label, background first, shape (K + 1, H, W).
    """
    labels, depth, faces = picture
    grad = np.zeros_like(scene.vertices)
    for axis in (0, 1):
        step = (0, 1) if axis == 0 else (1, 0)
        for row, column in np.ndindex(labels.shape[0] - step[0], labels.shape[1] - step[1]):
            pair = (row, column), (row + step[0], column + step[1])
            first, second = (labels[at] for at in pair)
            if first == second:
                continue
            excess = np.mean([costs[(first, *at)] - costs[(second, *at)] for at in pair])
            nearer = min(pair, key=lambda at: depth[at] if labels[at] else np.inf)
            face = scene.faces[faces[nearer]]
            x, y = (sum(at[k] for at in pair) / 2 + 0.5 for k in (1, 0))
            grad[face, axis] += excess * weights_at(scene.vertices[face], x, y, False)
    return grad
