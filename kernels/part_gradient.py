"""PartDR's backward pass: approximate derivatives of part maps with respect to projected vertices.

The definition is DESIGN.md's section 3 and paper eq. 10 to 12; ``tests/reference.py`` states it as slow float64 NumPy.
The result is linear in the loss gradient g of the part maps. g comes in two forms: dense maps (B, K, H, W), or a target
label image, from which L_seg's gradient at a pixel follows from two labels (``LabelTarget``).
"""

from dataclasses import dataclass
from typing import Any, Self

import warp as wp

from .rasterize import EMPTY_KEY, HIDDEN, IGNORE, MISSING, SURPLUS, TILE_ROWS, pixel_lanes, row_lanes
from .targets import flat
from .triangles import (
    Triangle,
    covers,
    depth_at,
    depth_key,
    double_area,
    edge_values,
    first_pixel,
    key_face,
    load_triangle,
    make_edges,
    pixel_columns,
    pixel_rows,
    weights_3d,
)

wp.set_module_options({"enable_backward": False})

MIN_DELTA_Z = wp.constant(1.0e-4)  # [m]; equal depths would divide by zero in eq. 12

# On CUDA, threads a block and blocks a multiprocessor: it takes some spilled registers to have enough threads that wait
# for memory at once.
_PUSH_EDGES_BOUNDS = (256, 4)

# Threads on CUDA that share one body's silhouette edges, and the scan lines of one edge: more of these where few bodies
# would leave the device idle.
_EDGE_SLOTS = 256
_MIN_LINE_LANES = 4
_MAX_LINE_LANES = 16
_LINES_TO_FILL = 512

_COUNT_STRIDE = 32  # counters of two bodies share no line of memory, or their atomics would queue


@wp.struct
class LabelTarget:
    """L_seg against a label image: g is 2 w (shown) where a part is wrong and -2 w (wanted) where one is missing."""

    target: wp.array3d[wp.uint8]  # (B, H, W), 255 = ignore
    label_weights: wp.array[float]  # (256,)
    scale: wp.array[float]  # (B,) gradient of the loss itself
    extents: wp.array3d[wp.vec4i]  # (B, 3, L) where pixels are wrong, from ``launch_compare_labels``


@wp.struct
class DenseGradient:
    """Any gradient with respect to the part maps."""

    maps: wp.array4d[float]  # (B, K, H, W)
    wanted: int  # the z pass looks for one map's part at a time


@wp.func
def pixels_of(g: LabelTarget, b: int, label: int):
    """What ``gradient_at`` reads for a label: the target."""
    return flat(g.target[b])


@wp.func
def pixels_of(g: DenseGradient, b: int, label: int):
    """What ``gradient_at`` reads for a label: its map."""
    return flat(g.maps[b, label - 1])


@wp.func
def gradient_at(target: wp.array[wp.uint8], at: int, label: int, shows_it: bool):
    """dL/dA of map ``label`` at a pixel that shows this label or another, but for the factor ``weight_of``."""
    want = int(target[at])
    if shows_it:
        return wp.where(want == label or want == IGNORE, 0.0, 2.0)
    return wp.where(want == label, -2.0, 0.0)


@wp.func
def gradient_at(map: wp.array[float], at: int, label: int, shows_it: bool):
    """dL/dA of map ``label`` at a pixel."""
    return map[at]


@wp.func
def weight_of(g: LabelTarget, b: int, label: int):
    """The factor of all that ``gradient_at`` says of a label."""
    return g.label_weights[label] * g.scale[b]


@wp.func
def weight_of(g: DenseGradient, b: int, label: int):
    """None."""
    return 1.0


@wp.func
def wanted_at(g: LabelTarget, b: int, at: int):
    """The label that may come forward at a pixel: what the target shows."""
    return int(flat(g.target[b])[at])


@wp.func
def wanted_at(g: DenseGradient, b: int, at: int):
    """The label that may come forward at a pixel: every one in its turn, and its map's gradient says how much."""
    return g.wanted


@wp.func
def extent(g: LabelTarget, b: int, kind: int, label: int):
    """First and last row, first and last column of the pixels that are wrong in this way; last < first if none is."""
    if label >= g.extents.shape[2]:
        return wp.vec4i(0, -1, 0, -1)
    reach = g.extents[b, kind, label]
    return wp.vec4i(g.target.shape[1] - reach[0], reach[1] - 1, g.target.shape[2] - reach[2], reach[3] - 1)


@wp.func
def extent(g: DenseGradient, b: int, kind: int, label: int):
    """Any pixel can have a gradient."""
    if label > g.maps.shape[1]:
        return wp.vec4i(0, -1, 0, -1)
    return wp.vec4i(0, g.maps.shape[2] - 1, 0, g.maps.shape[3] - 1)


@wp.func
def along_and_across(axis: int, p: wp.vec3):
    """A point's place along the scan lines, then across them, and its depth."""
    if axis == 0:
        return p
    return wp.vec3(p[1], p[0], p[2])


@wp.kernel
def find_silhouettes(
    vertices: wp.array2d[wp.vec3],  # (B, V) screen space
    face_labels: wp.array[wp.uint8],  # (F,)
    edges: wp.array2d[int],  # (E, 6): vertex, vertex, face, face or -1, opposite vertex of either face
    near: float,
    gradient: Any,
    counts: wp.array2d[int],  # (B, 32), zeroed  MODIFIED: column 0
    silhouettes: wp.array2d[int],  # (B, E)  OUTPUT: edge + 1, negative where ``side`` is
):
    """List the edges that bound their part, of parts that are wrong somewhere: few of all, and they do all the work."""
    b, edge = wp.tid()
    label = int(face_labels[edges[edge, 2]])
    if extent(gradient, b, MISSING, label)[1] < 0 and extent(gradient, b, SURPLUS, label)[1] < 0:
        return
    p0 = vertices[b, edges[edge, 0]]
    p1 = vertices[b, edges[edge, 1]]
    q = vertices[b, edges[edge, 4]]
    side = double_area(p0, p1, q)  # which side of the edge the face lies on
    nearest = wp.min(wp.min(p0[2], p1[2]), q[2])
    if edges[edge, 3] >= 0:
        r = vertices[b, edges[edge, 5]]
        other_side = double_area(p0, p1, r)
        nearest = wp.min(nearest, r[2])
        if side * other_side < 0.0:
            return  # the faces lie on either side: no silhouette
        if side == 0.0:
            side = other_side
    if side == 0.0 or nearest <= near:
        return
    place = wp.atomic_add(counts, b, 0, 1)
    silhouettes[b, place] = wp.where(side > 0.0, edge + 1, -edge - 1)


@wp.kernel(launch_bounds=_PUSH_EDGES_BOUNDS)
def push_edges(
    vertices: wp.array2d[wp.vec3],  # (B, V) screen space
    face_labels: wp.array[wp.uint8],  # (F,)
    edges: wp.array2d[int],  # (E, 6)
    counts: wp.array2d[int],  # (B, 32), column 0
    silhouettes: wp.array2d[int],  # (B, E)
    slots: int,  # threads that share a body's silhouettes
    lanes: int,  # threads that share an edge's scan lines
    perspective: bool,
    all_edges: bool,  # True: NMR's rule, every visible face reaches out; False: silhouettes only
    over_farther: bool,  # whether an edge also moves over parts farther away than itself; the paper's rule: no
    max_distance: float,  # [px] pixels farther from the edge do nothing; the paper's rule: inf
    labels: wp.array3d[wp.uint8],  # (B, H, W)
    face_index: wp.array3d[int],  # (B, H, W), read where something shows
    depth: wp.array3d[float],  # (B, H, W) [m], likewise
    gradient: Any,
    grad_vertices: wp.array3d[float],  # (B, V, 3)  MODIFIED: x and y are added to
):
    """x and y (paper, eq. 10 and 11), along each pixel row and column that an edge crosses.

    Pixels of background that should show the part pull the edge out, pixels of the part that should not push it in,
    others do nothing.
    """
    b, way, slot, lane = wp.tid()  # neighbouring threads go the same way, for about as long
    axis = way // 2  # 0: along rows, x moves; 1: along columns, y moves
    outward = way % 2 == 0
    width = labels.shape[2]
    count_along = wp.where(axis == 0, width, labels.shape[1])
    count_across = wp.where(axis == 0, labels.shape[1], width)
    pitch = wp.where(axis == 0, 1, width)  # from one pixel of a scan line to the next
    line_pitch = wp.where(axis == 0, width, 1)
    picture = flat(labels[b])
    count = counts[b, 0]
    while slot < count:
        signed = silhouettes[b, slot]
        slot += slots
        edge = wp.abs(signed) - 1
        face = edges[edge, 2]
        label = int(face_labels[face])
        asked = pixels_of(gradient, b, label)
        p0 = along_and_across(axis, vertices[b, edges[edge, 0]])
        p1 = along_and_across(axis, vertices[b, edges[edge, 1]])
        length = p1[1] - p0[1]
        if length == 0.0:
            continue
        inward = 1
        if (length > 0.0) == ((signed > 0) == (axis == 0)):
            inward = -1
        step = wp.where(outward, -inward, inward)
        wrong = extent(gradient, b, wp.where(outward, MISSING, SURPLUS), label)
        if axis == 1:
            wrong = wp.vec4i(wrong[2], wrong[3], wrong[0], wrong[1])
        last = wp.where(step > 0, wrong[3], wrong[2])
        high = wp.max(p0[1], p1[1])
        pull0 = float(0.0)
        pull1 = float(0.0)
        line = wp.max(first_pixel(wp.min(p0[1], p1[1]), count_across), wrong[0]) + lane
        while line <= wrong[1] and float(line) + 0.5 < high:
            w1 = (float(line) + 0.5 - p0[1]) / length
            w0 = 1.0 - w1
            crossing = w0 * p0[0] + w1 * p1[0]
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

            start = line * line_pitch
            going = bool(True)
            if all_edges:
                # NMR draws on visible faces only: the pixel just inside must show this one
                going = inside >= 0 and inside < count_along
                if going:
                    at = start + inside * pitch
                    going = picture[at] != wp.uint8(0) and flat(face_index[b])[at] == face
            elif outside >= 0 and outside < count_along:
                # an edge inside its own part's picture bounds nothing
                going = int(picture[start + outside * pitch]) != label

            pixel = wp.where(outward, outside, inside)
            pixel = wp.where(step > 0, wp.max(pixel, 0), wp.min(pixel, count_along - 1))
            distance = wp.abs(float(pixel) + 0.5 - crossing)
            left = (last - pixel) * step + 1
            if float(left) > max_distance - distance:
                left = int(wp.floor(max_distance - distance)) + 1
            at = start + pixel * pitch
            while going and left > 0:
                # both loads before anything hangs on them, so that they wait together
                shown = int(picture[at])
                value = gradient_at(asked, at, label, not outward)
                switches = shown == label
                if outward:
                    switches = shown == 0
                    if shown == label:
                        going = all_edges
                    elif over_farther and shown != 0 and value != 0.0:
                        switches = flat(depth[b])[at] > edge_depth
                else:
                    going = shown != 0
                    if all_edges and going:
                        going = flat(face_index[b])[at] == face
                if going and switches and value != 0.0:
                    nearness = 1.0 / wp.max(distance, 1.0e-6)
                    pull0 += value * inverse_move(nearness, w0)
                    pull1 += value * inverse_move(nearness, w1)
                at += step * pitch
                distance += 1.0
                left -= 1
            line += lanes

        if pull0 != 0.0 or pull1 != 0.0:
            factor = weight_of(gradient, b, label) * float(-inward)
            wp.atomic_add(grad_vertices, b, edges[edge, 0], axis, factor * pull0)
            wp.atomic_add(grad_vertices, b, edges[edge, 1], axis, factor * pull1)


@wp.func
def inverse_move(nearness: float, weight: float):
    """1 / (x1 - x0) of eq. 10: the edge moves by 1 / nearness, so the vertex by that / weight, a pixel at least."""
    return wp.clamp(weight * nearness, 0.0, 1.0)


@wp.kernel
def draw_hidden_faces(
    vertices: wp.array2d[wp.vec3],  # (B, V)
    faces: wp.array[wp.vec3i],  # (F,)
    face_labels: wp.array[wp.uint8],  # (F,)
    near: float,
    perspective: bool,
    lanes: int,
    labels: wp.array3d[wp.uint8],  # (B, H, W) what is shown
    gradient: Any,
    keys: wp.array3d[wp.uint64],  # (B, H, W), empty  MODIFIED: the nearest face of the wanted label's key
):
    """Nearest face of the wanted label where another part hides it."""
    b, face, lane = wp.tid()
    label = int(face_labels[face])
    wrong = extent(gradient, b, HIDDEN, label)
    if wrong[1] < 0:
        return
    t = load_triangle(vertices, faces, b, face, near)
    if t.valid == 0:
        return
    rows = pixel_rows(t, keys.shape[1])
    first_row = wp.max(rows[0], wrong[0]) + lane
    last_row = wp.min(rows[1], wrong[1])
    if first_row > last_row:
        return
    e = make_edges(t)
    width = keys.shape[2]
    picture = flat(labels[b])
    body_keys = flat(keys[b])
    for row in range(first_row, last_row + 1, lanes):
        y = float(row) + 0.5
        columns = pixel_columns(e, y, width)
        for column in range(wp.max(columns[0], wrong[2]), wp.min(columns[1], wrong[3]) + 1):
            at = row * width + column
            shown = int(picture[at])
            if shown != 0 and shown != label and wanted_at(gradient, b, at) == label:
                values = edge_values(e, float(column) + 0.5, y)
                if covers(e, values):
                    depth = depth_at(t, weights_3d(t, values, perspective))
                    wp.atomic_min(body_keys, at, depth_key(depth, face))


@wp.kernel
def push_depths(
    vertices: wp.array2d[wp.vec3],  # (B, V)
    faces: wp.array[wp.vec3i],  # (F,)
    near: float,
    perspective: bool,
    depth_weight: float,  # the paper's lambda [m]
    lanes: int,
    labels: wp.array3d[wp.uint8],  # (B, H, W)
    face_index: wp.array3d[int],  # (B, H, W), read where something shows
    gradient: Any,
    keys: wp.array3d[wp.uint64],  # (B, H, W) the hidden face that should be seen  MODIFIED: emptied
    grad_vertices: wp.array3d[float],  # (B, V, 3)  MODIFIED: z is added to
):
    """z (paper, eq. 12): the face that should be seen comes forward, the one that hides it goes back by as much."""
    b, tile_row, lane = wp.tid()
    wrong = extent(gradient, b, HIDDEN, 0)
    width = labels.shape[2]
    picture = flat(labels[b])
    body_keys = flat(keys[b])
    first = wp.max(wrong[0], tile_row * TILE_ROWS)
    end = wp.min(wrong[1] + 1, (tile_row + 1) * TILE_ROWS)
    for row in range(first, end):
        for column in range(wrong[2] + lane, wrong[3] + 1, lanes):
            at = row * width + column
            shown = int(picture[at])
            want = wanted_at(gradient, b, at)
            if shown == 0 or shown == want:
                continue
            key = body_keys[at]
            if key == EMPTY_KEY:
                continue
            body_keys[at] = EMPTY_KEY
            amount = (
                gradient_at(pixels_of(gradient, b, want), at, want, False) * weight_of(gradient, b, want) * depth_weight
            )
            if amount == 0.0:
                continue
            x = float(column) + 0.5
            y = float(row) + 0.5
            back_face = key_face(key)
            front_face = face_index[b, row, column]
            back = load_triangle(vertices, faces, b, back_face, near)
            front = load_triangle(vertices, faces, b, front_face, near)
            back_weights = weights_3d(back, edge_values(make_edges(back), x, y), perspective)
            front_weights = weights_3d(front, edge_values(make_edges(front), x, y), perspective)
            delta_z = wp.max(depth_at(back, back_weights) - depth_at(front, front_weights), MIN_DELTA_Z)
            # Moving the hidden face forward (z down) switches its map on: dA/dz < 0.
            add_depth(grad_vertices, faces[back_face], back, b, back_weights, delta_z, -amount)
            add_depth(grad_vertices, faces[front_face], front, b, front_weights, delta_z, amount)


@wp.func
def add_depth(
    grad_vertices: wp.array3d[float],
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
    w = weights / ((weights[0] + weights[1] + weights[2]) * delta_z)
    wp.atomic_add(grad_vertices, b, index[0], 2, amount * wp.log(w[0] + 1.0))
    wp.atomic_add(grad_vertices, b, i1, 2, amount * wp.log(w[1] + 1.0))
    wp.atomic_add(grad_vertices, b, i2, 2, amount * wp.log(w[2] + 1.0))


# Registered up front: an overload that appears later would compile the module again.
for _gradient in (LabelTarget, DenseGradient):
    for _kernel in (find_silhouettes, push_edges, draw_hidden_faces, push_depths):
        wp.overload(_kernel, {"gradient": _gradient})


@dataclass(frozen=True)
class SilhouetteList:
    """Scratch: the silhouette edges of each body.

    Attributes:
        counts: How many a body has, in column 0, shape (B, 32), int32.
        silhouettes: Room for all edges, shape (B, E), int32.
    """

    counts: wp.array
    silhouettes: wp.array

    @classmethod
    def make(cls, batch: int, num_edges: int, device: str | wp.Device) -> Self:
        """Room for a batch."""
        return cls(
            counts=wp.empty((batch, _COUNT_STRIDE), dtype=int, device=device),
            silhouettes=wp.empty((batch, num_edges), dtype=int, device=device),
        )


def launch_push_edges(
    vertices: wp.array,
    face_labels: wp.array,
    edges: wp.array,
    *,
    near: float,
    perspective: bool,
    all_edges: bool,
    over_farther: bool,
    max_distance: float,
    labels: wp.array,
    face_index: wp.array,
    depth: wp.array,
    gradient: Any,  # LabelTarget or DenseGradient
    found: SilhouetteList,
    grad_vertices: wp.array,
) -> None:
    """Add the x and y gradient.

    All images are contiguous; ``face_index`` and ``depth`` need no values where nothing shows.
    """
    device = vertices.device
    batch = vertices.shape[0]
    found.counts.zero_()
    wp.launch(
        find_silhouettes,
        (batch, edges.shape[0]),
        [vertices, face_labels, edges, near, gradient],
        [found.counts, found.silhouettes],
        device=device,
    )
    slots, lanes = 1, 1
    if not device.is_cpu:
        slots = _EDGE_SLOTS
        lanes = min(max(_LINES_TO_FILL // max(batch, 1), _MIN_LINE_LANES), _MAX_LINE_LANES)
    wp.launch(
        push_edges,
        (batch, 4, slots, lanes),
        [
            vertices,
            face_labels,
            edges,
            found.counts,
            found.silhouettes,
            slots,
            lanes,
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


def launch_push_depths(
    vertices: wp.array,
    faces: wp.array,
    face_labels: wp.array,
    *,
    near: float,
    perspective: bool,
    depth_weight: float,
    labels: wp.array,
    face_index: wp.array,
    gradient: Any,
    keys: wp.array,
    grad_vertices: wp.array,
) -> None:
    """Add the z gradient; ``keys`` are a ``ZBuffer``'s, empty before and after.

    All images are contiguous; ``face_index`` needs no values where nothing shows.
    """
    device = vertices.device
    lanes = row_lanes(vertices.shape[0] * faces.shape[0], device)
    wp.launch(
        draw_hidden_faces,
        (vertices.shape[0], faces.shape[0], lanes),
        [vertices, faces, face_labels, near, perspective, lanes, labels, gradient],
        [keys],
        device=device,
    )
    dim = pixel_lanes(labels.shape, device.is_cpu)
    wp.launch(
        push_depths,
        dim,
        [vertices, faces, near, perspective, depth_weight, dim[2], labels, face_index, gradient],
        [keys, grad_vertices],
        device=device,
    )
