"""PartDR's definition in float64 NumPy: slow, obvious, loops over pixels, edges and faces. Every kernel is held to it.

The paper (section 3.2) and the Neural Mesh Renderer leave much open. The choices made here:

Forward
    1. A face covers a pixel when the pixel's centre is inside it. A centre exactly on an edge belongs to the face for
       which, with vertices in positive orientation, the edge goes down the picture (or, if level, to the left).
    2. Depth is linear in the plane of the picture (weak perspective) or 1/depth is (perspective). The nearest face
       shows; equal depths go to the lower index. Faces of no area, or with a vertex at or before the near plane, are
       not drawn.

Backward, x and y. Here g^i(P) is the loss gradient of part i's map at pixel P; the result is linear in g.
    3. An edge counts where it bounds its part: it belongs to one face, or its two faces lie on the same side of it.
       Where one of two is seen edge-on, it counts half: of the edges before and behind that face, which lie on one
       line, one would count if it turned a little, the other if it turned the other way.
    4. Along every pixel row (for x) and column (for y) whose centre line it crosses, the edge moves straight along that
       line. The crossing's way to a pixel at distance d is d, and at least one pixel: max(d, 1).
    5. Where the first pixel outside shows the same label, the edge lies inside its own part's picture: it does nothing.
    6. Outward, pixels up to the picture's border, or to the next pixel that shows the part, switch on (dI = +1) if
       they show background. Inward, pixels up to the first that shows background switch off (dI = -1) if they show the
       part.
       A pixel that shows another part gives 0 and does not end the walk (eq. 11). With ``over_farther`` that holds for
       occluders only: outward, a part that lies farther away than the edge at its crossing counts as background does.
       ``max_distance`` [px] ends both walks.
    7. The crossing's derivative is the sum of g dI / (x1 - x0) (eq. 10), signed by the direction. A vertex with weight
       w at the crossing moves it by w times its own way, so by the chain rule either end gets w times that: together,
       the derivative of the edge as a whole, however finely a mesh divides it.
    8. ``all_edges`` is NMR's rule: each face's edges alone, where the pixel just inside shows that face; outward over
       all background to the border, inward over the pixels of this very face.

Backward, z
    9. At a pixel P that shows part j, for a part i != j with faces behind it, the nearest such face f_i and the face
       f_j that shows exchange places: A^i(P) gains 1. The point of f_i that is seen at P gets
       dI/dz = -lambda log(1 / dz + 1), with dz >= 1e-4 m the depth between the two, and the point of f_j
       +lambda log(1 / dz + 1): a push and its counter-push. Each vertex gets w times its face's, with w its barycentric
       weight in 3D (Delta(M0, Q) / Delta(M0, v_k) of eq. 12 is just that). Both are multiplied with g^i(P).
"""

from __future__ import annotations

import numpy as np

MIN_DELTA_Z = 1e-4


def cross(a, b, c):
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def weights_at(triangle, x, y, perspective):
    """Barycentric weights in 3D of the point of the face that projects to (x, y)."""
    a, b, c = triangle
    p = (x, y)
    w = np.array([cross(b, c, p), cross(c, a, p), cross(a, b, p)]) / cross(a, b, c)
    w = np.maximum(w, 0)
    if perspective:
        w = w / triangle[:, 2]
    return w / w.sum()


def covers(triangle, x, y):
    a, b, c = triangle if cross(*triangle) > 0 else triangle[[0, 2, 1]]
    for start, end in ((a, b), (b, c), (c, a)):
        value = cross(start, end, (x, y))
        down = end[1] > start[1] or (end[1] == start[1] and end[0] < start[0])
        if value < 0 or (value == 0 and not down):
            return False
    return True


def drawable(triangle, near):
    return cross(*triangle) != 0 and triangle[:, 2].min() > near


def rasterize(vertices, faces, face_labels, size, *, perspective=False, near=-np.inf):
    """Labels, depth and face index of one body."""
    height, width = size
    index = np.full(size, -1)
    depth = np.full(size, np.inf)
    for f, face in enumerate(faces):
        triangle = vertices[face]
        if not drawable(triangle, near):
            continue
        for row in range(height):
            for column in range(width):
                x, y = column + 0.5, row + 0.5
                if covers(triangle, x, y):
                    z = weights_at(triangle, x, y, perspective) @ triangle[:, 2]
                    if z < depth[row, column]:
                        depth[row, column], index[row, column] = z, f
    labels = np.where(index >= 0, np.asarray(face_labels)[index], 0)
    return labels, depth, index


def label_gradient(labels, target, num_labels, weights=None):
    """g of L_seg (paper, eq. 6) for a label target, as maps (K, H, W)."""
    g = np.zeros((num_labels, *labels.shape))
    for k in range(1, num_labels + 1):
        weight = 1.0 if weights is None else weights[k]
        g[k - 1] = 2 * weight * ((labels == k).astype(float) - (target == k))
        g[k - 1][target == 255] = 0
    return g


def find_edges(faces, face_labels):
    """{(vertex, vertex): [(face, opposite vertex), ...]}, split where the label differs or three faces meet."""
    found = {}
    for f, face in enumerate(faces):
        for k in range(3):
            i, j, opposite = face[k], face[(k + 1) % 3], face[(k + 2) % 3]
            found.setdefault((min(i, j), max(i, j), face_labels[f]), []).append((f, opposite))
    edges = []
    for (i, j, _), sides in found.items():
        edges += [(i, j, sides)] if len(sides) == 2 else [(i, j, [side]) for side in sides]
    return edges


def gradient(
    vertices,
    faces,
    face_labels,
    labels,
    face_index,
    g,
    *,
    perspective=False,
    near=-np.inf,
    all_edges=False,
    over_farther=False,
    depth=None,
    max_distance=np.inf,
    depth_weight=1.0,
):
    """dL/dvertices (V, 3) of one body, from the picture (labels, face_index) and g of shape (K, H, W)."""
    grad = np.zeros_like(vertices)
    if all_edges:
        edges = [
            (face[k], face[(k + 1) % 3], [(f, face[(k + 2) % 3])]) for f, face in enumerate(faces) for k in range(3)
        ]
    else:
        edges = find_edges(faces, face_labels)
    for i, j, sides in edges:
        farther = depth if over_farther else np.full(labels.shape, -np.inf)
        grad += edge_gradient(
            vertices,
            (i, j),
            sides,
            face_labels,
            labels,
            face_index,
            farther,
            g,
            perspective,
            near,
            all_edges,
            max_distance,
        )
    if depth_weight:
        grad[:, 2] += depth_gradient(
            vertices, faces, face_labels, labels, face_index, g, perspective, near, depth_weight
        )
    return grad


def edge_gradient(
    vertices, edge, sides, face_labels, labels, face_index, depth, g, perspective, near, all_edges, max_distance
):
    grad = np.zeros_like(vertices)
    p = vertices[list(edge)]
    if min(p[:, 2].min(), *(vertices[o][2] for _, o in sides)) <= near:
        return grad
    counted = np.mean([np.sign(cross(p[0], p[1], vertices[o])) for _, o in sides])  # choice 3: +-1, +-1/2 or 0
    side = np.sign(counted)
    if side == 0:
        return grad
    face = sides[0][0]
    part = int(face_labels[face])
    for axis in (0, 1):
        across = 1 - axis
        if p[0, across] == p[1, across]:
            continue
        # Seen from the edge, is the face toward larger coordinates of this axis?
        step = np.zeros(2)
        step[axis] = 1
        toward = np.sign(cross(p[0], p[1], p[0, :2] + step)) * side
        lines = labels if axis == 0 else labels.T
        faces_on = face_index if axis == 0 else face_index.T
        wanted = g[part - 1] if axis == 0 else g[part - 1].T
        depths = depth if axis == 0 else depth.T
        for line in range(lines.shape[0]):
            centre = line + 0.5
            if not min(p[:, across]) <= centre < max(p[:, across]):
                continue
            w1 = (centre - p[0, across]) / (p[1, across] - p[0, across])
            weights = np.array([1 - w1, w1])
            crossing = weights @ p[:, axis]
            edge_depth = 1 / (weights @ (1 / p[:, 2])) if perspective else weights @ p[:, 2]
            positions = np.arange(lines.shape[1]) + 0.5
            is_outside = (positions - crossing) * toward < 0
            outside = np.flatnonzero(is_outside)
            inside = np.flatnonzero(~is_outside)
            outside = outside if toward < 0 else outside[::-1]  # from the crossing on
            inside = inside if toward > 0 else inside[::-1]
            at_crossing = abs(positions - crossing) <= 1
            if all_edges:  # choice 8
                if not (len(inside) and at_crossing[inside[0]] and faces_on[line, inside[0]] == face):
                    continue
            elif len(outside) and at_crossing[outside[0]] and lines[line, outside[0]] == part:
                continue  # choice 5
            slope = 0.0
            for pixel in outside:
                shown = lines[line, pixel]
                if (shown == part and not all_edges) or abs(positions[pixel] - crossing) > max_distance:
                    break
                if shown == 0 or (shown != part and depths[line, pixel] > edge_depth):
                    slope = slope + wanted[line, pixel] * -toward / max(abs(positions[pixel] - crossing), 1)
            for pixel in inside:
                shown = lines[line, pixel]
                if shown == 0 or (all_edges and faces_on[line, pixel] != face):
                    break
                if abs(positions[pixel] - crossing) > max_distance:
                    break
                if shown == part:
                    slope = slope - wanted[line, pixel] * toward / max(abs(positions[pixel] - crossing), 1)
            grad[list(edge), axis] += abs(counted) * slope * weights
    return grad


def depth_gradient(vertices, faces, face_labels, labels, face_index, g, perspective, near, depth_weight):
    grad = np.zeros(len(vertices))
    for row, column in zip(*np.nonzero(labels), strict=True):
        x, y = column + 0.5, row + 0.5
        front = faces[face_index[row, column]]
        front_weights = weights_at(vertices[front], x, y, perspective)
        front_depth = front_weights @ vertices[front, 2]
        nearest = {}
        for f, face in enumerate(faces):
            if face_labels[f] == labels[row, column] or not drawable(vertices[face], near):
                continue
            if covers(vertices[face], x, y):
                weights = weights_at(vertices[face], x, y, perspective)
                depth = weights @ vertices[face, 2]
                if depth < nearest.get(face_labels[f], (np.inf,))[0]:
                    nearest[face_labels[f]] = (depth, face, weights)
        for part, (depth, face, weights) in nearest.items():  # choice 9
            if part > len(g):
                continue
            delta_z = max(depth - front_depth, MIN_DELTA_Z)
            amount = depth_weight * g[part - 1, row, column] * np.log(1 / delta_z + 1)
            np.add.at(grad, face, -amount * weights)
            np.add.at(grad, front, amount * front_weights)
    return grad
