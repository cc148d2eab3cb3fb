"""Backward pass of the mesh renderer in z: a hidden face that should be seen comes forward (paper, eq. 12).

The definition is docs/explanation/mesh_renderer.md; ``reference/mesh.py`` is the same in slow float64. The result is
linear in the loss gradient of the part maps.
"""

import math
from typing import Any

import warp as wp

from ..labels import (
    HIDDEN,
    QUAD,
    DenseGradient,
    LabelTarget,
    are_words,
    expected_block,
    extent,
    flat,
    hidden_pixels,
    load_block,
    may_come_forward,
    overload_gradients,
    pixel_gradient,
    pixels_of,
    target_label_at,
    weight_of,
)
from ..lanes import LANES, ballot, deal, num_lanes, prefix_sum, shuffle
from .forces import Forces, push_vertex, units_of
from .rasterize import (
    BLOCKS_ACROSS,
    SQUARE_COLUMNS,
    SQUARE_ROWS,
    launch_bodies,
    num_squares,
    row_lane_bits,
)
from .triangles import (
    MOST_FACES_IN_KEYS,
    ImageArrays,
    MeshArrays,
    Triangle,
    covers,
    depth_at,
    depth_key,
    edge_values,
    empty_key,
    is_empty,
    load_triangle,
    make_edges,
    pixel_columns,
    pixels_between,
    weights_3d,
)

wp.set_module_options({"enable_backward": False, "fast_math": True})

_FACE_BITS = wp.constant(wp.uint32(16))  # of a key that has two faces
_FRONT = wp.constant(wp.uint32(MOST_FACES_IN_KEYS - 1))  # bits of the face that hides the other

MIN_DELTA_Z = wp.constant(1.0e-4)  # [m]; equal depths would divide by zero in eq. 12
MAX_SLOPE = math.log(1.0 / MIN_DELTA_Z + 1.0)  # of a face's depth by eq. 12, but for the loss gradient and its weight

# On CUDA, threads a block and blocks a multiprocessor: some registers spill, but the memory's latency is hidden.
_PUSH_DEPTHS_BOUNDS = (256, 4)


@wp.kernel
def draw_hidden_faces(
    first_body: int,
    threads: int,  # of one body
    mesh: MeshArrays,
    lane_bits: int,  # 2 ** lane_bits threads share a face's rows
    images: ImageArrays,  # labels; without a face-index map, empty keys remember the faces that show
    gradient: Any,
    keys: wp.array3d[wp.uint64],  # (B, H, W), empty  MODIFIED: key of the target label's nearest face
):
    """Nearest face of the target's label where another part hides it."""
    thread = wp.tid()
    b = first_body + thread // threads
    lanes = 1 << lane_bits
    face = (thread % threads) >> lane_bits
    label = int(mesh.face_labels[face])
    if not may_come_forward(gradient, label):
        return
    wrong = extent(gradient, b, HIDDEN, label)
    if wrong[1] < 0:
        return
    t = load_triangle(mesh, b, face)
    if t.valid == 0:
        return
    width = keys.shape[2]
    rows = pixels_between(t, 1, keys.shape[1])
    bounds = pixels_between(t, 0, width)
    first_row = wp.max(rows[0], wrong[0]) + ((thread % threads) & (lanes - 1))
    last_row = wp.min(rows[1], wrong[1])
    left = wp.max(bounds[0], wrong[2])
    right = wp.min(bounds[1], wrong[3])
    if first_row > last_row or left > right:
        return
    e = make_edges(t)
    picture = flat(images.labels[b])
    body_keys = flat(keys[b])
    for row in range(first_row, last_row + 1, lanes):
        y = float(row) + 0.5
        columns = pixel_columns(e, y, width)
        first_column = wp.max(left, columns[0])
        last_column = wp.min(right, columns[1])
        for column in range(first_column, last_column + 1):
            at = row * width + column
            # both loads before their first use, so that their latencies overlap
            shown = int(picture[at])
            wanted = target_label_at(gradient, b, at)
            if shown != 0 and shown != label and wanted == label:
                values = edge_values(e, float(column) + 0.5, y)
                if covers(e, values):
                    depth = depth_at(t, weights_3d(t, values, mesh.perspective))
                    faces = wp.uint32(face)
                    if not images.face_index:  # the face in front is the same for all, and stays
                        faces = (faces << _FACE_BITS) | (wp.uint32(body_keys[at]) & _FRONT)
                    wp.atomic_min(body_keys, at, depth_key(depth, faces))


@wp.func
def hidden_in_block(
    g: LabelTarget, hidden: wp.array2d[wp.uint32], labels: wp.array3d[wp.uint8], b: int, square: int, block: int
):
    """Pixels of a block in which a part hides the target's, as ``compare_labels`` found them."""
    return hidden[square, block]


@wp.func
def hidden_in_block(
    g: DenseGradient, hidden: wp.array2d[wp.uint32], labels: wp.array3d[wp.uint8], b: int, square: int, block: int
):
    """Pixels of a block in which a part hides the one whose turn it is."""
    place = block_place(labels.shape[2], square, block)
    shown = load_block(labels[b], place[0], place[1], are_words(labels))
    expected = expected_block(g, b, place[0], place[1])
    pixels = wp.uint32(0)
    for k in range(QUAD):
        pixels |= hidden_pixels(shown[k], expected[k]) >> wp.uint32(k)
    return pixels


@wp.func
def block_place(width: int, square: int, block: int):
    """First row and column of a block."""
    across = (width + SQUARE_COLUMNS - 1) // SQUARE_COLUMNS
    return wp.vec2i(
        square // across * SQUARE_ROWS + block // BLOCKS_ACROSS * QUAD,
        square % across * SQUARE_COLUMNS + block % BLOCKS_ACROSS * QUAD,
    )


@wp.kernel(launch_bounds=_PUSH_DEPTHS_BOUNDS)
def push_depths(
    first_body: int,
    threads: int,  # of one body
    mesh: MeshArrays,
    lanes: int,  # threads that share a square: a warp, or one
    images: ImageArrays,  # labels and, unless keys have room for two faces, faces
    hidden: wp.array3d[wp.uint32],  # (B, squares, 32) for a LabelTarget
    gradient: Any,
    keys: wp.array3d[wp.uint64],  # (B, H, W) the hidden face that should be seen  MODIFIED: emptied
    forces: Forces,  # MODIFIED: z is added to, but for its weight
):
    """Gradient in z (paper, eq. 12): the hidden face comes forward, the one that hides it goes back by as much.

    Each thread looks at a block, then all share the pixels in which something is hidden.
    """
    thread = wp.tid()
    b = first_body + thread // threads
    lane = (thread % threads) & (lanes - 1)
    warp = thread % threads // lanes
    warps = threads // lanes
    width = keys.shape[2]
    body_keys = flat(keys[b])
    for turn in range(LANES // lanes):
        # from all over the picture, so that all warps have about as many pixels
        block = (turn * lanes + lane) * warps + warp
        pixels = hidden_in_block(gradient, hidden[b], images.labels, b, block // LANES, block % LANES)
        if ballot(pixels != wp.uint32(0)) != wp.uint32(0):
            found = prefix_sum(wp.bit_count(pixels))
            total = int(shuffle(wp.uint32(found), lanes - 1))
            for begin in range(0, total, lanes):
                mine = deal(pixels, found, block, begin + lane, lanes)
                if begin + lane < total:
                    place = block_place(width, mine[0] // LANES, mine[0] % LANES)
                    row = place[0] + 7 - mine[1] % 8
                    column = place[1] + mine[1] // 8
                    at = row * width + column
                    key = body_keys[at]
                    if not is_empty(key):
                        back = wp.uint32(key)
                        front = back & _FRONT
                        if images.face_index:
                            front = wp.uint32(flat(images.face_index[b])[at])
                        else:
                            back = back >> _FACE_BITS
                        body_keys[at] = empty_key(front)
                        push_pixel(mesh, gradient, b, row, column, width, int(back), int(front), forces)


@wp.func
def push_pixel(
    mesh: MeshArrays,
    gradient: Any,
    b: int,
    row: int,
    column: int,
    width: int,  # of the picture
    back_index: int,  # face that is hidden
    front_index: int,
    forces: Forces,
):
    """Gradient in z from one pixel."""
    label = int(mesh.face_labels[back_index])
    amount = pixel_gradient(pixels_of(gradient, b, label), row * width + column, label, False) * weight_of(
        gradient, b, label
    )
    amount *= units_of(forces, b)
    if amount != 0.0:
        x = float(column) + 0.5
        y = float(row) + 0.5
        back = load_triangle(mesh, b, back_index)
        front = load_triangle(mesh, b, front_index)
        back_weights = weights_3d(back, edge_values(make_edges(back), x, y), mesh.perspective)
        front_weights = weights_3d(front, edge_values(make_edges(front), x, y), mesh.perspective)
        delta_z = wp.max(depth_at(back, back_weights) - depth_at(front, front_weights), MIN_DELTA_Z)
        amount *= wp.log(1.0 / delta_z + 1.0)
        # Moving the hidden face forward (z down) switches its map on: dA/dz < 0.
        add_depth(forces, b, back, back_weights, -amount)
        add_depth(forces, b, front, front_weights, amount)


@wp.func
def add_depth(forces: Forces, b: int, t: Triangle, weights: wp.vec3, amount: float):
    """Share ``amount`` among a face's vertices, by how much each moves the point that is seen."""
    shares = weights * (amount / (weights[0] + weights[1] + weights[2]))
    for i in range(3):
        push_vertex(forces, b, t.index[i], 2, shares[i])


overload_gradients(draw_hidden_faces, push_depths)


def launch_push_depths(
    mesh: MeshArrays, images: ImageArrays, gradient: Any, keys: wp.array, hidden: wp.array | None, forces: Any
) -> None:
    """Add to the forces on vertices in z.

    All images are contiguous. ``keys`` are a ``ZBuffer``'s, empty before and after. ``hidden`` are the pixels that
    ``launch_compare_labels`` has found, for a LabelTarget.
    """
    device = mesh.vertices.device
    (batch, height, width), faces = images.labels.shape, mesh.faces.shape[0]
    bits = row_lane_bits(batch * faces, device)
    inputs = [mesh, bits, images, gradient]
    launch_bodies(draw_hidden_faces, batch, faces << bits, inputs, [keys], device)
    lanes = num_lanes(device)
    threads = math.prod(num_squares(height, width)) * lanes
    launch_bodies(push_depths, batch, threads, [mesh, lanes, images, hidden, gradient], [keys, forces], device)
