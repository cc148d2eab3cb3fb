"""PartDR's backward pass: approximate derivatives of part maps with respect to projected vertices.

The definition is DESIGN.md's section 3 and paper eq. 10 to 12; ``tests/reference.py`` states it as slow float64 NumPy.
The result is linear in the loss gradient g of the part maps. g comes in two forms: dense maps (B, K, H, W), or a target
label image, from which L_seg's gradient at a pixel follows from two labels (``LabelTarget``).
"""

from typing import Any

import warp as wp

from .rasterize import EMPTY_KEY, IGNORE, draw_hidden_faces, row_lanes
from .triangles import (
    Triangle,
    barycentric,
    depth_at,
    double_area,
    first_pixel,
    key_face,
    load_triangle,
)

wp.set_module_options({"enable_backward": False})

MIN_DELTA_Z = wp.constant(1.0e-4)  # [m]; equal depths would divide by zero in eq. 12


@wp.func
def row_of(axis: int, line: int, pixel: int):
    """Row of a pixel on a scan line."""
    return wp.where(axis == 0, line, pixel)


@wp.func
def column_of(axis: int, line: int, pixel: int):
    """Column of a pixel on a scan line."""
    return wp.where(axis == 0, pixel, line)


@wp.struct
class LabelTarget:
    """L_seg against a label image: g is 2 w (shown) where a part is wrong and -2 w (wanted) where one is missing."""

    target: wp.array3d[wp.uint8]  # (B, H, W), 255 = ignore
    label_weights: wp.array[float]  # (256,)
    scale: wp.array[float]  # (B,) gradient of the loss itself
    reach: wp.array4d[wp.vec2i]  # (B, 2, L, max(H, W)) from ``find_reach``


@wp.struct
class DenseGradient:
    """Any gradient with respect to the part maps."""

    maps: wp.array4d[float]  # (B, K, H, W)


@wp.func
def gradient_at(g: LabelTarget, b: int, label: int, row: int, column: int, shown: int):
    """dL/dA of map ``label`` at a pixel that shows ``shown``."""
    want = g.target[b, row, column]
    if want == IGNORE or int(want) == shown:
        return 0.0
    value = 0.0
    if shown == label:
        value = 2.0
    elif int(want) == label:
        value = -2.0
    return value * g.label_weights[label] * g.scale[b]


@wp.func
def gradient_at(g: DenseGradient, b: int, label: int, row: int, column: int, shown: int):
    """dL/dA of map ``label`` at a pixel; labels past the last map have none."""
    if label > g.maps.shape[1]:
        return 0.0
    return g.maps[b, label - 1, row, column]


@wp.func
def pull_range(g: LabelTarget, b: int, axis: int, label: int, line: int, count: int):
    """First and last pixel of a scan line that can pull this label's edges out: those that want it."""
    return g.reach[b, axis, label, line]


@wp.func
def pull_range(g: DenseGradient, b: int, axis: int, label: int, line: int, count: int):
    """Any pixel can."""
    return wp.vec2i(0, count - 1)


@wp.kernel
def find_reach(
    target: wp.array3d[wp.uint8],  # (B, H, W)
    reach: wp.array4d[wp.vec2i],  # (B, 2, L, max(H, W))  OUTPUT
):
    """First and last pixel of each row (axis 0) and column (axis 1) that wants a label: no edge has to look further."""
    b, axis, line = wp.tid()
    if line >= target.shape[1 + axis]:
        return
    count = target.shape[2 - axis]
    for label in range(reach.shape[2]):
        reach[b, axis, label, line] = wp.vec2i(count, -1)
    for pixel in range(count):
        label = int(target[b, row_of(axis, line, pixel), column_of(axis, line, pixel)])
        if label < reach.shape[2]:
            first = wp.min(reach[b, axis, label, line][0], pixel)
            reach[b, axis, label, line] = wp.vec2i(first, pixel)


@wp.kernel
def push_edges(
    vertices: wp.array2d[wp.vec3],  # (B, V) screen space
    faces: wp.array[wp.vec3i],  # (F,)
    face_labels: wp.array[wp.uint8],  # (F,)
    edges: wp.array2d[int],  # (E, 6): vertex, vertex, face, face or -1, opposite vertex of either face
    near: float,
    perspective: bool,
    all_edges: bool,  # True: NMR's rule, every visible face reaches out; False: silhouettes only
    over_farther: bool,  # whether an edge also moves over parts farther away than itself; the paper's rule: no
    max_distance: float,  # [px] pixels farther from the edge do nothing; the paper's rule: inf
    labels: wp.array3d[wp.uint8],  # (B, H, W)
    face_index: wp.array3d[int],  # (B, H, W)
    depth: wp.array3d[float],  # (B, H, W) [m]
    gradient: Any,
    grad_vertices: wp.array2d[wp.vec3],  # (B, V)  MODIFIED: x and y are added to
):
    """x and y (paper, eq. 10 and 11), along each pixel row and column that an edge crosses.

    Pixels of background that should show the part pull the edge out, pixels of the part that should not push it in,
    others do nothing.
    """
    b, edge, axis = wp.tid()  # axis 0: along rows, x moves; axis 1: along columns, y moves
    i0 = edges[edge, 0]
    i1 = edges[edge, 1]
    face = edges[edge, 2]
    other_face = edges[edge, 3]
    p0 = vertices[b, i0]
    p1 = vertices[b, i1]
    q = vertices[b, edges[edge, 4]]
    side = double_area(p0, p1, q)  # which side of the edge the face lies on
    nearest = wp.min(wp.min(p0[2], p1[2]), q[2])
    if other_face >= 0:
        r = vertices[b, edges[edge, 5]]
        other_side = double_area(p0, p1, r)
        nearest = wp.min(nearest, r[2])
        if side * other_side < 0.0:
            return  # the faces lie on either side: no silhouette
        if side == 0.0:
            side = other_side
    if side == 0.0 or nearest <= near:
        return

    across = 1 - axis
    length = p1[across] - p0[across]
    if length == 0.0:
        return
    inward = 1
    if (length > 0.0) == ((side > 0.0) == (axis == 0)):
        inward = -1
    label = int(face_labels[face])
    count_along = labels.shape[2 - axis]
    count_across = labels.shape[1 + axis]
    low = wp.min(p0[across], p1[across])
    high = wp.max(p0[across], p1[across])
    grad0 = float(0.0)
    grad1 = float(0.0)
    line = first_pixel(low, count_across)
    while line < count_across and float(line) + 0.5 < high:
        w1 = (float(line) + 0.5 - p0[across]) / length
        w0 = 1.0 - w1
        crossing = w0 * p0[axis] + w1 * p1[axis]
        edge_depth = w0 * p0[2] + w1 * p1[2]
        if perspective:
            edge_depth = 1.0 / (w0 / p0[2] + w1 / p1[2])
        # first pixel centres strictly outside and at or inside the crossing, clamped in float against overflow
        place = wp.clamp(crossing, -1.0, float(count_along) + 1.0)
        inside = int(wp.ceil(place - 0.5))
        outside = inside - 1
        if inward < 0:
            inside = int(wp.floor(place - 0.5))
            outside = inside + 1

        active = True
        if all_edges:
            # NMR draws on visible faces only: the pixel just inside must show this one
            active = inside >= 0 and inside < count_along
            if active:
                active = face_index[b, row_of(axis, line, inside), column_of(axis, line, inside)] == face
        elif outside >= 0 and outside < count_along:
            # an edge inside its own part's picture bounds nothing
            active = int(labels[b, row_of(axis, line, outside), column_of(axis, line, outside)]) != label

        if active:
            step = -inward
            pulls = pull_range(gradient, b, axis, label, line, count_along)
            pixel = outside
            if inward < 0:
                pixel = wp.max(pixel, 0)
            else:
                pixel = wp.min(pixel, count_along - 1)
            while pixel * step <= pulls[wp.where(step > 0, 1, 0)] * step and pixel >= 0 and pixel < count_along:
                row = row_of(axis, line, pixel)
                column = column_of(axis, line, pixel)
                shown = int(labels[b, row, column])
                distance = wp.abs(float(pixel) + 0.5 - crossing)
                if distance > max_distance:
                    break
                if shown == 0 or (over_farther and shown != label and depth[b, row, column] > edge_depth):
                    g = gradient_at(gradient, b, label, row, column, shown) * float(step)
                    grad0 += g * inverse_move(distance, w0)
                    grad1 += g * inverse_move(distance, w1)
                elif shown == label and not all_edges:
                    break
                pixel += step
            step = inward
            pixel = inside
            if inward > 0:
                pixel = wp.max(pixel, 0)
            else:
                pixel = wp.min(pixel, count_along - 1)
            while pixel >= 0 and pixel < count_along:
                row = row_of(axis, line, pixel)
                column = column_of(axis, line, pixel)
                shown = int(labels[b, row, column])
                distance = wp.abs(float(pixel) + 0.5 - crossing)
                if shown == 0 or distance > max_distance:
                    break
                if all_edges and face_index[b, row, column] != face:
                    break
                if shown == label:
                    g = gradient_at(gradient, b, label, row, column, shown) * float(-step)
                    grad0 += g * inverse_move(distance, w0)
                    grad1 += g * inverse_move(distance, w1)
                pixel += step
        line += 1

    if axis == 0:
        wp.atomic_add(grad_vertices, b, i0, wp.vec3(grad0, 0.0, 0.0))
        wp.atomic_add(grad_vertices, b, i1, wp.vec3(grad1, 0.0, 0.0))
    else:
        wp.atomic_add(grad_vertices, b, i0, wp.vec3(0.0, grad0, 0.0))
        wp.atomic_add(grad_vertices, b, i1, wp.vec3(0.0, grad1, 0.0))


@wp.func
def inverse_move(distance: float, weight: float):
    """1 / (x1 - x0) of eq. 10: the edge moves by ``distance``, so the vertex by distance / weight, a pixel at least."""
    if weight <= 0.0:
        return 0.0
    return weight / wp.max(distance, weight)


@wp.kernel
def push_depths(
    vertices: wp.array2d[wp.vec3],  # (B, V)
    faces: wp.array[wp.vec3i],  # (F,)
    near: float,
    perspective: bool,
    depth_weight: float,  # the paper's lambda [m]
    labels: wp.array3d[wp.uint8],  # (B, H, W)
    face_index: wp.array3d[int],  # (B, H, W)
    hidden_keys: wp.array3d[wp.uint64],  # (B, H, W) the hidden face that should be seen
    wanted: wp.array3d[wp.uint8],  # (B or 1, H or 1, W or 1)
    gradient: Any,
    grad_vertices: wp.array2d[wp.vec3],  # (B, V)  MODIFIED: z is added to
):
    """z (paper, eq. 12): the face that should be seen comes forward, the one that hides it goes back by as much."""
    b, row, column = wp.tid()
    key = hidden_keys[b, row, column]
    if key == EMPTY_KEY:
        return
    want = int(wanted[b % wanted.shape[0], row % wanted.shape[1], column % wanted.shape[2]])
    g = gradient_at(gradient, b, want, row, column, int(labels[b, row, column]))
    if g == 0.0:
        return
    x = float(column) + 0.5
    y = float(row) + 0.5
    back_face = key_face(key)
    front_face = face_index[b, row, column]
    back = load_triangle(vertices, faces, b, back_face, near)
    front = load_triangle(vertices, faces, b, front_face, near)
    back_weights = barycentric(back, x, y, perspective)
    front_weights = barycentric(front, x, y, perspective)
    delta_z = wp.max(depth_at(back, back_weights) - depth_at(front, front_weights), MIN_DELTA_Z)
    # Moving the hidden face forward (z down) switches its map on: dA/dz < 0.
    add_depth(grad_vertices, faces[back_face], back, b, back_weights, delta_z, -g * depth_weight)
    add_depth(grad_vertices, faces[front_face], front, b, front_weights, delta_z, g * depth_weight)


@wp.func
def add_depth(
    grad_vertices: wp.array2d[wp.vec3],
    index: wp.vec3i,
    t: Triangle,
    b: int,
    weights: wp.vec3,
    delta_z: float,
    amount: float,
):
    """Share ``amount`` among a face's vertices. Δ(M0, Q) / Δ(M0, v_k) in eq. 12 is the barycentric weight of v_k."""
    i1 = index[1]
    i2 = index[2]
    if t.flipped == 1:
        i1 = index[2]
        i2 = index[1]
    wp.atomic_add(grad_vertices, b, index[0], wp.vec3(0.0, 0.0, amount * wp.log(weights[0] / delta_z + 1.0)))
    wp.atomic_add(grad_vertices, b, i1, wp.vec3(0.0, 0.0, amount * wp.log(weights[1] / delta_z + 1.0)))
    wp.atomic_add(grad_vertices, b, i2, wp.vec3(0.0, 0.0, amount * wp.log(weights[2] / delta_z + 1.0)))


# Registered up front: an overload that appears later would compile the module again.
for _gradient in (LabelTarget, DenseGradient):
    wp.overload(push_edges, {"gradient": _gradient})
    wp.overload(push_depths, {"gradient": _gradient})


def launch_find_reach(target: wp.array, reach: wp.array) -> None:
    """Fill ``LabelTarget.reach``, of shape (B, 2, L, max(H, W)) for labels 0 to L - 1."""
    dim = (target.shape[0], 2, max(target.shape[1:]))
    wp.launch(find_reach, dim, [target], [reach], device=target.device)


def launch_part_gradient(
    vertices: wp.array,
    faces: wp.array,
    face_labels: wp.array,
    edges: wp.array,
    *,
    near: float,
    perspective: bool,
    all_edges: bool,
    over_farther: bool,
    max_distance: float,
    depth_weight: float,
    labels: wp.array,
    face_index: wp.array,
    depth: wp.array,
    gradient: Any,  # LabelTarget or DenseGradient
    wanted: list[wp.array],
    keys: wp.array,
    grad_vertices: wp.array,
) -> None:
    """Add the gradient to zeroed ``grad_vertices``.

    ``wanted`` holds the label images whose hidden parts may come forward: one target, or a constant image (size 1)
    a part map. ``keys`` is scratch; with ``depth_weight`` 0 no depth is looked at.
    """
    device = vertices.device
    wp.launch(
        push_edges,
        (vertices.shape[0], edges.shape[0], 2),
        [
            vertices,
            faces,
            face_labels,
            edges,
            near,
            perspective,
            all_edges,
            over_farther,
            max_distance,
            labels,
            face_index,
            depth,
            gradient,
        ],
        [grad_vertices],
        device=device,
    )
    if depth_weight == 0.0:
        return
    lanes = row_lanes(device)
    for want in wanted:
        keys.fill_(EMPTY_KEY)
        wp.launch(
            draw_hidden_faces,
            (vertices.shape[0], faces.shape[0], lanes),
            [vertices, faces, face_labels, near, perspective, lanes, labels, want],
            [keys],
            device=device,
        )
        wp.launch(
            push_depths,
            keys.shape,
            [vertices, faces, near, perspective, depth_weight, labels, face_index, keys, want, gradient],
            [grad_vertices],
            device=device,
        )
