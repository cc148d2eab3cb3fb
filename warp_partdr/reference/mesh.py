"""PartDR on part-labelled meshes (paper, eq. 8 to 12), with loops over pixels, edges and faces.

Beside the choices of ``partdr``:

Forward
    1. A face covers a pixel when the pixel's centre is inside it. A centre exactly on an edge belongs to the face for
       which, with vertices in positive orientation, the edge goes down the picture (or, if level, to the left).
    2. Depth is linear in the plane of the picture (weak perspective) or 1/depth is (perspective). The nearest face
       shows; equal depths go to the lower index. Faces of no area, or with a vertex at or before the near plane, are
       not drawn, nor, where they are culled, those seen from behind: in the picture, v down, their vertices turn to the
       right.

Backward
    3. An edge counts where it bounds its part: it belongs to one face, or its two faces lie on the same side of it.
       Where one of two is seen edge-on, it counts half: of the edges before and behind that face, which lie on one
       line, one would count if it turned a little, the other if it turned the other way.
    4. A vertex with weight w at the crossing moves it by w times its own way, so by the chain rule either end of an
       edge gets w times the crossing's derivative: together, the derivative of the edge as a whole, however finely a
       mesh divides it. In z, w is the barycentric weight in 3D.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from .partdr import MIN_DELTA_Z as MIN_DELTA_Z
from .partdr import PixelLine, Rule, depth_slope, line_slope

Edge = tuple[int, int, list[tuple[int, int]]]  # its vertices, and of each face beside it index and opposite vertex


@dataclass(frozen=True)
class MeshScene:
    """Mesh of one body as its camera sees it.

    Attributes:
        vertices: Columns, rows [px] and depths [m], shape (V, 3).
        faces: Vertex indices f of each face, shape (F, 3).
        labels: Part of each face, 1 to K; 0 has no map.
        perspective: True: 1/depth is linear in the picture, not depth.
        near: Depth of the near plane [m].
        cull_backfaces: Leave out faces seen from behind.
    """

    vertices: np.ndarray
    faces: np.ndarray
    labels: np.ndarray
    perspective: bool = False
    near: float = -np.inf
    cull_backfaces: bool = False


class MeshPicture(NamedTuple):
    """Labels (A^1 to A^K as one image), depth [m] and face index, each (H, W)."""

    labels: np.ndarray
    depth: np.ndarray
    face_index: np.ndarray


def cross(a: Any, b: Any, c: Any) -> Any:
    """Twice the signed area of a triangle in the picture."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def weights_at(triangle: np.ndarray, x: float, y: float, perspective: bool) -> np.ndarray:
    """Barycentric weights in 3D of the point of the face that projects to (x, y)."""
    a, b, c = triangle
    p = (x, y)
    w = np.array([cross(b, c, p), cross(c, a, p), cross(a, b, p)]) / cross(a, b, c)
    w = np.maximum(w, 0)
    if perspective:
        w = w / triangle[:, 2]
    return w / w.sum()


def covers_place(triangle: np.ndarray, x: float, y: float) -> bool:
    """True where a face covers a place of the picture."""
    a, b, c = triangle if cross(*triangle) > 0 else triangle[[0, 2, 1]]
    for start, end in ((a, b), (b, c), (c, a)):
        value = cross(start, end, (x, y))
        down = end[1] > start[1] or (end[1] == start[1] and end[0] < start[0])
        if value < 0 or (value == 0 and not down):
            return False
    return True


def is_drawn(scene: MeshScene, face: np.ndarray) -> bool:
    """True for a face that has an area, lies behind the near plane, and is not culled."""
    triangle = scene.vertices[face]
    area = cross(*triangle)
    return bool(area != 0 and triangle[:, 2].min() > scene.near and not (scene.cull_backfaces and area > 0))


def face_index_map(scene: MeshScene, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Eq. 8: the face-index map F, -1 = background, and its depth D [m], both (H, W).

    The paper leaves open who has a pixel's centre on an edge: see the fill rule above. Of equal
    depths, the lower index shows.
    """
    index, depth = np.full(size, -1), np.full(size, np.inf)
    for f, face in enumerate(scene.faces):
        triangle = scene.vertices[face]
        if not is_drawn(scene, face):
            continue
        for row, column in np.ndindex(size):
            x, y = column + 0.5, row + 0.5
            if covers_place(triangle, x, y):
                z = weights_at(triangle, x, y, scene.perspective) @ triangle[:, 2]
                if z < depth[row, column]:
                    depth[row, column], index[row, column] = z, f
    return index, depth


def part_maps(index: np.ndarray, face_labels: np.ndarray, num_labels: int) -> np.ndarray:
    """Eq. 9: the maps A^1 to A^K, 1 where the face that shows is of the part, (K, H, W).

    Args:
        index: Index F of the face that shows at each pixel, shape (H, W).
        face_labels: Part of each face, 1 to K; 0 has no map.
        num_labels: Number of parts K.

    Kernels write one image of labels; maps are made when they are asked for.
    """
    maps = np.zeros((num_labels, *index.shape))
    for row, column in np.argwhere(index >= 0):
        label = face_labels[index[row, column]]
        if 0 < label <= num_labels:
            maps[label - 1, row, column] = 1.0
    return maps


def rasterize(scene: MeshScene, size: tuple[int, int]) -> MeshPicture:
    """Draw the picture of one body."""
    index, depth = face_index_map(scene, size)
    return MeshPicture(np.where(index >= 0, scene.labels[index], 0), depth, index)


def find_edges(scene: MeshScene) -> list[Edge]:
    """Edges, split where the label differs or three faces meet."""
    found: dict[tuple[int, int, int], list[tuple[int, int]]] = {}
    for f, face in enumerate(scene.faces):
        for k in range(3):
            i, j, opposite = np.roll(face, -k)
            found.setdefault((min(i, j), max(i, j), scene.labels[f]), []).append((f, opposite))
    edges: list[Edge] = []
    for (i, j, _), sides in found.items():
        edges += [(i, j, sides)] if len(sides) == 2 else [(i, j, [side]) for side in sides]
    return edges


def gradient(scene: MeshScene, picture: MeshPicture, g: np.ndarray, **rule: Any) -> np.ndarray:
    """dL/dvertices (V, 3), from the picture and g of shape (K, H, W); ``rule`` are the fields of ``Rule``."""
    options = Rule(**rule)
    edges = find_edges(scene)
    if options.edges == "all":
        edges = [(a[k], a[(k + 1) % 3], [(f, a[(k + 2) % 3])]) for f, a in enumerate(scene.faces) for k in range(3)]
    grad = np.zeros_like(scene.vertices)
    for edge in edges:
        part = int(scene.labels[edge[2][0][0]])
        line = PixelLine(picture.labels, picture.depth, g[part - 1], picture.face_index)
        grad += edge_gradient(scene, edge, part, line, options)
    if options.depth_weight:
        grad[:, 2] += depth_gradient(scene, picture, g, options.depth_weight)
    return grad


def edge_gradient(scene: MeshScene, edge: Edge, part: int, picture: PixelLine, rule: Rule) -> np.ndarray:
    """The share of one edge in x and y; ``picture`` has whole images instead of lines."""
    vertices, grad = scene.vertices, np.zeros_like(scene.vertices)
    *ends, sides = edge
    p = vertices[ends]
    if min(p[:, 2].min(), *(vertices[o][2] for _, o in sides)) <= scene.near:
        return grad
    counted = np.mean([np.sign(cross(p[0], p[1], vertices[o])) for _, o in sides])  # choice 3: +-1, +-1/2 or 0
    for axis in (0, 1):
        across = 1 - axis
        if counted == 0 or p[0, across] == p[1, across]:
            continue
        # Seen from the edge, the way along this axis that leads out of the face.
        out = -int(np.sign(cross(p[0], p[1], p[0, :2] + np.eye(2)[axis])) * np.sign(counted))
        images = [image if axis == 0 else image.T for image in picture if image is not None]
        for line in range(picture.shown.shape[axis]):
            centre = line + 0.5
            if not min(p[:, across]) <= centre < max(p[:, across]):
                continue
            w1 = (centre - p[0, across]) / (p[1, across] - p[0, across])
            weights = np.array([1 - w1, w1])
            edge_depth = float(1 / (weights @ (1 / p[:, 2])) if scene.perspective else weights @ p[:, 2])
            pixels = PixelLine(*(image[line] for image in images))
            slope = line_slope(pixels, part, out, weights @ p[:, axis], edge_depth, rule, sides[0][0])
            grad[ends, axis] += abs(counted) * slope * weights
    return grad


def depth_gradient(scene: MeshScene, picture: MeshPicture, g: np.ndarray, depth_weight: float) -> np.ndarray:
    """dL/dz of the vertices, shape (V,): eq. 12 at every pixel that shows something."""
    vertices, grad = scene.vertices, np.zeros(len(scene.vertices))
    for row, column in zip(*np.nonzero(picture.labels), strict=True):
        x, y = column + 0.5, row + 0.5
        front = scene.faces[picture.face_index[row, column]]
        front_weights = weights_at(vertices[front], x, y, scene.perspective)
        front_depth = front_weights @ vertices[front, 2]
        nearest: dict[int, tuple[float, np.ndarray, np.ndarray]] = {}
        for label, face in zip(scene.labels, scene.faces, strict=True):
            if label == picture.labels[row, column] or not is_drawn(scene, face):
                continue
            if covers_place(vertices[face], x, y):
                weights = weights_at(vertices[face], x, y, scene.perspective)
                depth = weights @ vertices[face, 2]
                if depth < nearest.get(label, (np.inf,))[0]:
                    nearest[label] = (depth, face, weights)
        for part, (depth, face, weights) in nearest.items():
            if part > len(g):
                continue
            amount = g[part - 1, row, column] * depth_slope(depth - front_depth, depth_weight)
            np.add.at(grad, face, amount * weights)
            np.add.at(grad, front, -amount * front_weights)
    return grad
