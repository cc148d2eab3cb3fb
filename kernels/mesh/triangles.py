"""Geometry of a projected triangle for the forward and the backward pass: coverage and depth.

Vertices are in screen space: (u, v) in pixels, z in metres, camera frame. Pixel (row, column) has its centre at
(column + 0.5, row + 0.5).
"""

from typing import Any

import warp as wp

wp.set_module_options({"enable_backward": False, "fast_math": True})

_SIGN_BIT = wp.constant(wp.uint32(0x80000000))
EMPTY_KEY = wp.constant(wp.uint64(0xFFFFFFFFFFFFFFFF))  # behind every face

# A mesh of so few faces has room for two of them in a key's lower half: the hidden one and the one that hides it. So a
# gradient needs no face-index map.
MOST_FACES_IN_KEYS = 1 << 16


@wp.struct
class MeshArrays:
    """A part-labelled mesh of B bodies before a camera."""

    vertices: wp.array2d[wp.vec3]  # (B, V) screen space
    faces: wp.array[wp.vec3i]  # (F,)
    face_labels: wp.array[wp.uint8]  # (F,)
    edges: wp.array2d[int]  # (E, 6): vertex, vertex, face, face or -1, opposite vertex of either face
    near: float  # [m]
    perspective: bool
    cull_backfaces: bool


@wp.struct
class ImageArrays:
    """Picture of a mesh; depth and face index hold no values where nothing shows."""

    labels: wp.array3d[wp.uint8]  # (B, H, W)
    depth: wp.array3d[float]  # (B, H, W) [m]
    face_index: wp.array3d[int]  # (B, H, W)
    faults: wp.array[float]  # (B,) NaN: a vertex is not finite, so that loss and gradient are NaN; else 0


@wp.struct
class Edge:
    """One edge of a face, in the direction in which the face lies on its positive side."""

    origin: wp.vec2  # of its two ends, the one that comes first whichever way the edge goes
    direction: wp.vec2
    slope: float  # columns a row
    bounds: int  # 1: it ends pixel rows, -1: it starts them, 0: too level to tell where
    closed: bool  # fill rule: true if a pixel centre exactly on it belongs to the face


@wp.struct
class Triangle:
    """One face, vertices turned so that the signed area is positive."""

    a: wp.vec3
    b: wp.vec3
    c: wp.vec3
    index: wp.vec3i  # of the vertices
    valid: int  # 0: no area, before the near plane, or seen from behind where that is not drawn


@wp.struct
class Edges:
    """Edges of a face, each named by its ends."""

    bc: Edge
    ca: Edge
    ab: Edge


@wp.func
def load_triangle(mesh: MeshArrays, b: int, face: int):
    """Load a face of a body; see ``Triangle.valid``."""
    vertices = mesh.vertices[b]
    index = mesh.faces[face]
    t = Triangle()
    t.a = vertices[index[0]]
    t.b = vertices[index[1]]
    t.c = vertices[index[2]]
    t.index = index
    area = (t.b[0] - t.a[0]) * (t.c[1] - t.a[1]) - (t.b[1] - t.a[1]) * (t.c[0] - t.a[0])  # twice it, signed [px²]
    if area < 0.0:
        t.b = vertices[index[2]]
        t.c = vertices[index[1]]
        t.index = wp.vec3i(index[0], index[2], index[1])
    nearest = wp.min(t.a[2], wp.min(t.b[2], t.c[2]))
    # v points down, so what winds counterclockwise in the picture has a negative area.
    if area != 0.0 and nearest > mesh.near and (area < 0.0 or not mesh.cull_backfaces):
        t.valid = 1
    return t


@wp.func
def is_finite(t: Triangle):
    """True if all numbers of a face's vertices are finite, and their sums."""
    return wp.isfinite(t.a[0] + t.a[1] + t.a[2] + t.b[0] + t.b[1] + t.b[2] + t.c[0] + t.c[1] + t.c[2])


@wp.func
def make_edge(a: wp.vec3, b: wp.vec3):
    """The edge from a to b.

    Two faces that share it have the same origin, so that ``edge_value`` gives them one number with opposite signs: no
    pixel on it is drawn twice or missed.
    """
    e = Edge()
    if a[0] < b[0] or (a[0] == b[0] and a[1] < b[1]):
        e.origin = wp.vec2(a[0], a[1])
    else:
        e.origin = wp.vec2(b[0], b[1])
    e.direction = wp.vec2(b[0] - a[0], b[1] - a[1])
    if wp.abs(e.direction[1]) > 1.0e-6 * wp.abs(e.direction[0]):
        e.slope = e.direction[0] / e.direction[1]
        e.bounds = wp.where(e.direction[1] > 0.0, 1, -1)
    e.closed = b[1] > a[1] or (b[1] == a[1] and b[0] < a[0])
    return e


@wp.func
def make_edges(t: Triangle):
    e = Edges()
    e.bc = make_edge(t.b, t.c)
    e.ca = make_edge(t.c, t.a)
    e.ab = make_edge(t.a, t.b)
    return e


@wp.func
def edge_value(e: Edge, x: float, y: float):
    """Twice the signed area of (start, end, pixel)."""
    return e.direction[0] * (y - e.origin[1]) - e.direction[1] * (x - e.origin[0])


@wp.func
def edge_values(e: Edges, x: float, y: float):
    """Unnormalised weights of (a, b, c) at a pixel centre, in the image plane."""
    return wp.vec3(edge_value(e.bc, x, y), edge_value(e.ca, x, y), edge_value(e.ab, x, y))


@wp.func
def covers(e: Edges, values: wp.vec3):
    """True if the pixel centre with these ``edge_values`` is in the triangle."""
    if wp.min(values[0], wp.min(values[1], values[2])) > 0.0:
        return True
    return within(e.bc, values[0]) and within(e.ca, values[1]) and within(e.ab, values[2])


@wp.func
def within(e: Edge, value: float):
    """True if a pixel centre with this ``edge_value`` lies on the face's side; on the edge, the fill rule decides."""
    return value > 0.0 or (value == 0.0 and e.closed)


@wp.func
def weights_3d(t: Triangle, values: wp.vec3, perspective: bool):
    """Unnormalised weights of (a, b, c), in 3D, at the face's point with these ``edge_values``, clamped to the face."""
    w = wp.vec3(wp.max(values[0], 0.0), wp.max(values[1], 0.0), wp.max(values[2], 0.0))
    if w[0] + w[1] + w[2] <= 0.0:
        w = wp.vec3(1.0, 1.0, 1.0)
    if perspective:
        w = wp.cw_div(w, wp.vec3(t.a[2], t.b[2], t.c[2]))
    return w


@wp.func
def depth_at(t: Triangle, w: wp.vec3):
    """Depth [m] of the point with these ``weights_3d``; exact where the face is level."""
    return t.a[2] + (w[1] * (t.b[2] - t.a[2]) + w[2] * (t.c[2] - t.a[2])) / (w[0] + w[1] + w[2])


@wp.func
def first_pixel(low: float, size: int):
    """First index whose pixel centre is at or after ``low``, in [0, size]; float first, so that nothing overflows."""
    return int(wp.ceil(wp.clamp(low, 0.0, float(size)) - 0.5))


@wp.func
def last_pixel(high: float, size: int):
    """Last index whose pixel centre is at or before ``high``, in [-1, size - 1]."""
    return int(wp.floor(wp.clamp(high, 0.0, float(size)) - 0.5))


@wp.func
def pixels_between(t: Triangle, axis: int, size: int):
    """First and last column (axis 0) or row (1) whose centres the triangle can cover; empty where last < first."""
    return wp.vec2i(
        first_pixel(wp.min(t.a[axis], wp.min(t.b[axis], t.c[axis])), size),
        last_pixel(wp.max(t.a[axis], wp.max(t.b[axis], t.c[axis])), size),
    )


@wp.func
def pixel_columns(e: Edges, y: float, width: int):
    """First and last column whose centres the triangle can cover in the row at y: a tight bound."""
    ends = bound_row(e.ab, y, bound_row(e.ca, y, bound_row(e.bc, y, wp.vec2(0.0, float(width)))))
    return wp.vec2i(first_pixel(ends[0], width), last_pixel(ends[1], width))


@wp.func
def bound_row(e: Edge, y: float, ends: wp.vec2):
    """Clip a row to the edge's side, with a margin, so that rounding loses no pixel that ``covers`` keeps."""
    along = (y - e.origin[1]) * e.slope
    slack = 0.01 + 1.0e-6 * (wp.abs(e.origin[0]) + wp.abs(along))
    x = e.origin[0] + along
    first = wp.where(e.bounds < 0, x - slack, ends[0])
    last = wp.where(e.bounds > 0, x + slack, ends[1])
    return wp.vec2(wp.max(ends[0], first), wp.min(ends[1], last))


@wp.func
def depth_key(depth: float, face: Any):
    """Key that sorts by depth, then by face index: the float's bits in an order-preserving form, then the face."""
    bits = wp.cast(depth, wp.uint32)
    if bits >= _SIGN_BIT:
        bits = ~bits
    else:
        bits = bits | _SIGN_BIT
    return (wp.uint64(bits) << wp.uint64(32)) | wp.uint64(face)


@wp.func
def key_face(key: wp.uint64):
    """Face of a key."""
    return int(key & wp.uint64(0xFFFFFFFF))


@wp.func
def is_empty(key: wp.uint64):
    """True for a key behind every face; what it has in its lower half does not count."""
    return key >= EMPTY_KEY - wp.uint64(0xFFFFFFFF)


@wp.func
def empty_key(face: Any):
    """Key behind every face that remembers a face."""
    return EMPTY_KEY - wp.uint64(0xFFFFFFFF) + wp.uint64(face)


@wp.func
def key_depth(key: wp.uint64):
    """Depth of a key, bit for bit."""
    bits = wp.uint32(key >> wp.uint64(32))
    if bits >= _SIGN_BIT:
        bits = bits & wp.uint32(0x7FFFFFFF)
    else:
        bits = ~bits
    return wp.cast(bits, wp.float32)
