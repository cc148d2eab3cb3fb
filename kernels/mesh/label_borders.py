"""Gradient "edges" of a mesh: derivative of area, sampled between each two pixels that show different labels.

``reference/mesh_edges.py`` is the same in slow float64. The border lies half way between the two centres, and the face
that is nearer to the camera carries it. As it moves, a pixel's length of area changes hands, at the two pixels' mean
cost. Rows give x, columns give y: together they are the force along the border's normal. Depths have no gradient. The
result is linear in the loss gradient of the part maps.
"""

from typing import Any

import warp as wp

from ..labels import QUAD, are_words, excess_at, first_bytes, flat, load_word, overload_gradients, unequal_bytes
from ..lanes import ballot, deal, num_lanes, prefix_sum, shuffle
from .forces import Forces, push_vertex, units_of
from .rasterize import launch_bodies
from .triangles import ImageArrays, MeshArrays, edge_values, load_triangle, make_edges, weights_3d

wp.set_module_options({"enable_backward": False, "fast_math": True})


@wp.func
def push_border_between(
    mesh: MeshArrays,
    images: ImageArrays,
    gradient: Any,
    b: int,
    row: int,
    column: int,
    axis: int,  # of the next pixel: 0 to the right, 1 below
    forces: Forces,
    units: float,  # ``units_of`` the forces
):
    """Force of the border between a pixel and the next, which shows another label, on the face that carries it."""
    width = images.labels.shape[2]
    at = row * width + column
    after = at + wp.where(axis == 0, 1, width)
    # all loads before their first use, so that their latencies overlap
    picture = flat(images.labels[b])
    depth = flat(images.depth[b])
    faces = flat(images.face_index[b])
    here = int(picture[at])
    there = int(picture[after])
    depth_here = depth[at]
    depth_there = depth[after]
    face_here = faces[at]
    face_there = faces[after]
    excess = 0.5 * (excess_at(gradient, b, here, there, at) + excess_at(gradient, b, here, there, after))
    if excess == 0.0:
        return
    first = there == 0 or (here != 0 and depth_here <= depth_there)  # background has neither depth nor face
    t = load_triangle(mesh, b, wp.where(first, face_here, face_there))
    x = float(column) + wp.where(axis == 0, 1.0, 0.5)
    y = float(row) + wp.where(axis == 0, 0.5, 1.0)
    # Weights in the picture: there a face's points move by them, with perspective, too.
    weights = weights_3d(t, edge_values(make_edges(t), x, y), False)
    shares = weights * (excess * units / (weights[0] + weights[1] + weights[2]))
    for i in range(3):
        push_vertex(forces, b, t.index[i], axis, shares[i])


@wp.kernel
def push_label_borders(
    first_body: int,
    threads: int,  # of one body, a multiple of the lanes
    mesh: MeshArrays,
    images: ImageArrays,
    lanes: int,  # threads that share borders: a warp, or one
    each: int,  # words of four pixels that a thread looks at: one, or a row of them
    gradient: Any,
    forces: Forces,  # MODIFIED: x and y are added to
):
    """Gradient in x and y from the borders of pixels with their neighbours to the right and below.

    Each thread looks at a word, then all share the borders.
    """
    thread = wp.tid()
    b = first_body + thread // threads
    lane = (thread % threads) & (lanes - 1)
    height = images.labels.shape[1]
    width = images.labels.shape[2]
    quads = (width + QUAD - 1) // QUAD
    in_words = are_words(images.labels)
    picture = images.labels[b]
    units = units_of(forces, b)
    row = thread % threads * each // quads
    first = thread % threads * each % quads
    for quad in range(first, first + each):
        column = quad * QUAD
        to_right = wp.uint32(0)
        to_below = wp.uint32(0)
        if row < height:
            here = load_word(picture, row, column, in_words)
            below = load_word(picture, row + 1, column, in_words)
            next_pixel = wp.uint32(flat(picture)[row * width + wp.min(column + QUAD, width - 1)])
            right = (here >> wp.uint32(8)) | (next_pixel << wp.uint32(24))
            to_right = unequal_bytes(here, right)
            to_below = unequal_bytes(here, below)
        if ballot((to_right | to_below) != wp.uint32(0)) != wp.uint32(0):
            to_right &= first_bytes(width - 1 - column)
            to_below &= wp.where(row + 1 < height, first_bytes(width - column), wp.uint32(0))
            borders = to_right | (to_below >> wp.uint32(1))  # bit 7 of a pixel's byte: to its right, bit 6: below it
            found = prefix_sum(wp.bit_count(borders))
            total = int(shuffle(wp.uint32(found), lanes - 1))
            for begin in range(0, total, lanes):
                mine = deal(borders, found, row * quads + quad, begin + lane, lanes)
                if begin + lane < total:
                    axis = 1 - mine[1] % 8 // 7
                    at = mine[0] % quads * QUAD + mine[1] // 8
                    push_border_between(mesh, images, gradient, b, mine[0] // quads, at, axis, forces, units)


overload_gradients(push_label_borders)


def launch_push_label_borders(mesh: MeshArrays, images: ImageArrays, gradient: Any, forces: Any) -> None:
    """Add to the forces on vertices, by a LabelTarget or DenseGradient; images are contiguous."""
    device = mesh.vertices.device
    batch, height, width = images.labels.shape
    quads, lanes = -(-width // int(QUAD)), num_lanes(device)
    each = quads if device.is_cpu else 1  # a thread of the CPU takes as long to begin as a word
    threads = -(-height * quads // (each * lanes)) * lanes
    launch_bodies(push_label_borders, batch, threads, [mesh, images, lanes, each, gradient], [forces], device)
