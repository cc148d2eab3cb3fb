"""The geometry of a projected triangle that the forward and the backward pass share: coverage and depth.

Vertices are in screen space: (u, v) in pixels, z in metres, camera frame. Pixel (row, column) has its centre at
(column + 0.5, row + 0.5).
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

_SIGN_BIT = wp.constant(wp.uint32(0x80000000))
BACKGROUND = wp.constant(-1)  # the face-index map's value where no face is (paper, eq. 8)


@wp.struct
class Triangle:
    """One face, vertices turned so that the signed area is positive."""

    a: wp.vec3
    b: wp.vec3
    c: wp.vec3
    flipped: int  # 1 where b and c changed places
    valid: int  # 0: no area, or behind the near plane


@wp.func
def load_triangle(vertices: wp.array2d[wp.vec3], faces: wp.array[wp.vec3i], b: int, face: int, near: float):
    """Face ``face`` of body ``b``; a face with a vertex nearer than ``near`` is not valid."""
    index = faces[face]
    p0 = vertices[b, index[0]]
    p1 = vertices[b, index[1]]
    p2 = vertices[b, index[2]]
    area = double_area(p0, p1, p2)
    t = Triangle()
    t.a = p0
    if area < 0.0:
        t.b = p2
        t.c = p1
        t.flipped = 1
    else:
        t.b = p1
        t.c = p2
    nearest = wp.min(t.a[2], wp.min(t.b[2], t.c[2]))
    if area != 0.0 and nearest > near:
        t.valid = 1
    return t


@wp.func
def double_area(a: wp.vec3, b: wp.vec3, c: wp.vec3):
    """Twice the signed area in the image plane [px²]."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


@wp.func
def edge_value(a: wp.vec3, b: wp.vec3, x: float, y: float):
    """Twice the signed area of (a, b, pixel).

    Two faces that share an edge get the same number with opposite signs: its ends are put in one order first, so that
    no pixel on it is drawn twice or missed.
    """
    if a[0] < b[0] or (a[0] == b[0] and a[1] < b[1]):
        return (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])
    return (b[0] - a[0]) * (y - b[1]) - (b[1] - a[1]) * (x - b[0])


@wp.func
def inside_edge(a: wp.vec3, b: wp.vec3, value: float):
    """Fill rule: a pixel centre exactly on an edge belongs to the face on one fixed side of it."""
    if value != 0.0:
        return value > 0.0
    return b[1] > a[1] or (b[1] == a[1] and b[0] < a[0])


@wp.func
def covers(t: Triangle, x: float, y: float):
    """Whether the pixel centre (x, y) is in the triangle."""
    if not inside_edge(t.b, t.c, edge_value(t.b, t.c, x, y)):
        return False
    if not inside_edge(t.c, t.a, edge_value(t.c, t.a, x, y)):
        return False
    return inside_edge(t.a, t.b, edge_value(t.a, t.b, x, y))


@wp.func
def barycentric(t: Triangle, x: float, y: float, perspective: bool):
    """Weights of (a, b, c) at the face's point that projects to (x, y), in 3D, clamped to the face."""
    w = wp.vec3(
        wp.max(edge_value(t.b, t.c, x, y), 0.0),
        wp.max(edge_value(t.c, t.a, x, y), 0.0),
        wp.max(edge_value(t.a, t.b, x, y), 0.0),
    )
    if perspective:
        w = wp.cw_div(w, wp.vec3(t.a[2], t.b[2], t.c[2]))
    total = w[0] + w[1] + w[2]
    if total > 0.0:
        return w / total
    return wp.vec3(1.0, 1.0, 1.0) / 3.0


@wp.func
def depth_at(t: Triangle, w: wp.vec3):
    """Depth [m] of the point with these 3D weights; exact where the face is level."""
    return t.a[2] + w[1] * (t.b[2] - t.a[2]) + w[2] * (t.c[2] - t.a[2])


@wp.func
def first_pixel(low: float, size: int):
    """First index whose pixel centre is at or after ``low``, in [0, size]; float first, so that nothing overflows."""
    return int(wp.ceil(wp.clamp(low, 0.0, float(size)) - 0.5))


@wp.func
def last_pixel(high: float, size: int):
    """Last index whose pixel centre is at or before ``high``, in [-1, size - 1]."""
    return int(wp.floor(wp.clamp(high, 0.0, float(size)) - 0.5))


@wp.func
def pixel_box(t: Triangle, height: int, width: int):
    """First and last row, first and last column whose centres the triangle can cover; empty where last < first."""
    return wp.vec4i(
        first_pixel(wp.min(t.a[1], wp.min(t.b[1], t.c[1])), height),
        last_pixel(wp.max(t.a[1], wp.max(t.b[1], t.c[1])), height),
        first_pixel(wp.min(t.a[0], wp.min(t.b[0], t.c[0])), width),
        last_pixel(wp.max(t.a[0], wp.max(t.b[0], t.c[0])), width),
    )


@wp.func
def depth_key(depth: float, face: int):
    """Sorts by depth, then by face index: the float's bits in an order-preserving form, then the face."""
    bits = wp.cast(depth, wp.uint32)
    if bits >= _SIGN_BIT:
        bits = ~bits
    else:
        bits = bits | _SIGN_BIT
    return (wp.uint64(bits) << wp.uint64(32)) | wp.uint64(face)


@wp.func
def key_face(key: wp.uint64):
    """The face of a key."""
    return int(key & wp.uint64(0xFFFFFFFF))


@wp.func
def key_depth(key: wp.uint64):
    """The depth of a key, bit for bit."""
    bits = wp.uint32(key >> wp.uint64(32))
    if bits >= _SIGN_BIT:
        bits = bits & wp.uint32(0x7FFFFFFF)
    else:
        bits = ~bits
    return wp.cast(bits, wp.float32)
