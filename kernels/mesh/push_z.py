"""Backward pass of the mesh renderer in z: a hidden face that should be seen comes forward (paper, eq. 12).

The definition is docs/renderer.md; ``reference/mesh.py`` is the same in slow float64. The result is linear in the loss
gradient of the part maps.
"""

from typing import Any, NamedTuple, Self

import warp as wp

from ..labels import HIDDEN, extent, flat, overload_gradients, pixel_gradient, pixels_of, target_label_at, weight_of
from .rasterize import EMPTY_KEY, launch_bodies, row_lane_bits
from .triangles import (
    ImageArrays,
    MeshArrays,
    Triangle,
    covers,
    depth_at,
    depth_key,
    edge_values,
    key_face,
    load_triangle,
    make_edges,
    pixel_columns,
    pixel_rows,
    weights_3d,
)

wp.set_module_options({"enable_backward": False, "fast_math": True})

MIN_DELTA_Z = wp.constant(1.0e-4)  # [m]; equal depths would divide by zero in eq. 12

_PIXEL_THREADS = 1024  # on CUDA for one body: about one for each hidden pixel in a picture of 256 x 256

_COUNT_STRIDE = 32  # counters of two bodies lie in different cache lines


@wp.kernel
def draw_hidden_faces(
    first_body: int,
    threads: int,  # of one body
    mesh: MeshArrays,
    lane_bits: int,  # 2 ** lane_bits threads share a face's rows
    labels: wp.array3d[wp.uint8],  # (B, H, W) what is shown
    gradient: Any,
    keys: wp.array3d[wp.uint64],  # (B, H, W), empty  MODIFIED: key of the target label's nearest face
    counts: wp.array2d[int],  # (B, 32), zeroed  MODIFIED: column 0
    pixels: wp.array2d[int],  # (B, H * W)  OUTPUT: where there is a key
):
    """Nearest face of the target's label where another part hides it."""
    thread = wp.tid()
    b = first_body + thread // threads
    lanes = 1 << lane_bits
    face = (thread % threads) >> lane_bits
    label = int(mesh.face_labels[face])
    wrong = extent(gradient, b, HIDDEN, label)
    if wrong[1] < 0:
        return
    t = load_triangle(mesh, b, face)
    if t.valid == 0:
        return
    rows = pixel_rows(t, keys.shape[1])
    first_row = wp.max(rows[0], wrong[0]) + ((thread % threads) & (lanes - 1))
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
            # both loads before their first use, so that their latencies overlap
            shown = int(picture[at])
            target_label = target_label_at(gradient, b, at)
            if shown != 0 and shown != label and target_label == label:
                values = edge_values(e, float(column) + 0.5, y)
                if covers(e, values):
                    depth = depth_at(t, weights_3d(t, values, mesh.perspective))
                    if wp.atomic_min(body_keys, at, depth_key(depth, face)) == EMPTY_KEY:
                        pixels[b, wp.atomic_add(counts, b, 0, 1)] = at


@wp.kernel
def push_depths(
    first_body: int,
    threads: int,  # of one body
    mesh: MeshArrays,
    depth_weight: float,  # the paper's lambda [m]
    face_index: wp.array3d[int],  # (B, H, W), read where something shows
    gradient: Any,
    keys: wp.array3d[wp.uint64],  # (B, H, W) the hidden face that should be seen  MODIFIED: emptied
    counts: wp.array2d[int],  # (B, 32), column 0
    pixels: wp.array2d[int],  # (B, H * W)
    grad_vertices: wp.array3d[float],  # (B, V, 3)  MODIFIED: z is added to
):
    """Gradient in z (paper, eq. 12): the hidden face comes forward, the one that hides it goes back by as much."""
    thread = wp.tid()
    b = first_body + thread // threads
    width = keys.shape[2]
    body_keys = flat(keys[b])
    for i in range(thread % threads, counts[b, 0], threads):
        at = pixels[b, i]
        back_index = key_face(body_keys[at])
        body_keys[at] = EMPTY_KEY
        label = int(mesh.face_labels[back_index])
        amount = pixel_gradient(pixels_of(gradient, b, label), at, label, False) * weight_of(gradient, b, label)
        amount *= depth_weight
        if amount == 0.0:
            continue
        x = float(at % width) + 0.5
        y = float(at // width) + 0.5
        back = load_triangle(mesh, b, back_index)
        front = load_triangle(mesh, b, flat(face_index[b])[at])
        back_weights = weights_3d(back, edge_values(make_edges(back), x, y), mesh.perspective)
        front_weights = weights_3d(front, edge_values(make_edges(front), x, y), mesh.perspective)
        delta_z = wp.max(depth_at(back, back_weights) - depth_at(front, front_weights), MIN_DELTA_Z)
        amount *= wp.log(1.0 / delta_z + 1.0)
        # Moving the hidden face forward (z down) switches its map on: dA/dz < 0.
        add_depth(grad_vertices, b, back, back_weights, -amount)
        add_depth(grad_vertices, b, front, front_weights, amount)


@wp.func
def add_depth(grad_vertices: wp.array3d[float], b: int, t: Triangle, weights: wp.vec3, amount: float):
    """Share ``amount`` among a face's vertices, by how much each moves the point that is seen."""
    shares = weights * (amount / (weights[0] + weights[1] + weights[2]))
    for i in range(3):
        wp.atomic_add(grad_vertices, b, t.index[i], 2, shares[i])


overload_gradients(draw_hidden_faces, push_depths)


class HiddenPixels(NamedTuple):
    """Scratch: the pixels where another part hides the one that should be seen.

    Attributes:
        keys: The nearest face of that part, as a ``ZBuffer``'s: empty between launches, shape (B, H, W).
        counts: Number of each body's pixels, in column 0, shape (B, 32), int32.
        pixels: Indices of these pixels, row by row, shape (B, H * W), int32.
    """

    keys: wp.array
    counts: wp.array
    pixels: wp.array

    @classmethod
    def make(cls, keys: wp.array) -> Self:
        """Allocate for pictures of the size of ``keys``, which are empty."""
        batch, height, width = keys.shape
        return cls(
            keys=keys,
            counts=wp.empty((batch, _COUNT_STRIDE), dtype=int, device=keys.device),
            pixels=wp.empty((batch, height * width), dtype=int, device=keys.device),
        )


def launch_push_depths(
    mesh: MeshArrays, images: ImageArrays, gradient: Any, depth_weight: float, hidden: HiddenPixels, grad: wp.array
) -> None:
    """Add the z gradient to the vertices' ``grad``; all images are contiguous."""
    device = mesh.vertices.device
    batch, faces = images.labels.shape[0], mesh.faces.shape[0]
    bits = row_lane_bits(batch * faces, device)
    hidden.counts.zero_()
    launch_bodies(draw_hidden_faces, batch, faces << bits, [mesh, bits, images.labels, gradient], [*hidden], device)
    threads = 1 if device.is_cpu else _PIXEL_THREADS
    inputs = [mesh, depth_weight, images.face_index, gradient]
    launch_bodies(push_depths, batch, threads, inputs, [*hidden, grad], device)
