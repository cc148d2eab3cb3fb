"""PartDR's forward pass: z-buffer of a part-labelled mesh (paper, eq. 8 and 9), the same to the bit in every run."""

import warp as wp

from .triangles import (
    BACKGROUND,
    barycentric,
    covers,
    depth_at,
    depth_key,
    key_depth,
    key_face,
    load_triangle,
    pixel_box,
)

wp.set_module_options({"enable_backward": False})

EMPTY_KEY = wp.constant(wp.uint64(0xFFFFFFFFFFFFFFFF))  # behind every face
IGNORE = wp.constant(wp.uint8(255))  # a target pixel that neither attracts nor repels

# Threads that share the rows of one face on CUDA, so that a large face does not hold up its warp.
_ROW_LANES = 8


@wp.kernel
def draw_faces(
    vertices: wp.array2d[wp.vec3],  # (B, V) screen space
    faces: wp.array[wp.vec3i],  # (F,)
    near: float,  # [m]
    perspective: bool,
    lanes: int,
    keys: wp.array3d[wp.uint64],  # (B, H, W)  MODIFIED: the nearest face's key
):
    """Nearest face at every pixel centre; a tie in depth goes to the lower face index."""
    b, face, lane = wp.tid()
    t = load_triangle(vertices, faces, b, face, near)
    if t.valid == 0:
        return
    box = pixel_box(t, keys.shape[1], keys.shape[2])
    row = box[0] + lane
    while row <= box[1]:
        y = float(row) + 0.5
        for column in range(box[2], box[3] + 1):
            x = float(column) + 0.5
            if covers(t, x, y):
                depth = depth_at(t, barycentric(t, x, y, perspective))
                wp.atomic_min(keys, b, row, column, depth_key(depth, face))
        row += lanes


@wp.kernel
def draw_hidden_faces(
    vertices: wp.array2d[wp.vec3],
    faces: wp.array[wp.vec3i],
    face_labels: wp.array[wp.uint8],  # (F,)
    near: float,
    perspective: bool,
    lanes: int,
    labels: wp.array3d[wp.uint8],  # (B, H, W) what is shown
    wanted: wp.array3d[wp.uint8],  # (B or 1, H or 1, W or 1) what should be shown; size 1 repeats
    keys: wp.array3d[wp.uint64],  # (B, H, W)  MODIFIED: the nearest face of the wanted label's key
):
    """Nearest face of the wanted label where another part hides it."""
    b, face, lane = wp.tid()
    label = face_labels[face]
    t = load_triangle(vertices, faces, b, face, near)
    if t.valid == 0:
        return
    box = pixel_box(t, keys.shape[1], keys.shape[2])
    row = box[0] + lane
    while row <= box[1]:
        y = float(row) + 0.5
        for column in range(box[2], box[3] + 1):
            shown = labels[b, row, column]
            if shown != wp.uint8(0) and shown != label:
                want = wanted[b % wanted.shape[0], row % wanted.shape[1], column % wanted.shape[2]]
                x = float(column) + 0.5
                if want == label and covers(t, x, y):
                    depth = depth_at(t, barycentric(t, x, y, perspective))
                    wp.atomic_min(keys, b, row, column, depth_key(depth, face))
        row += lanes


@wp.kernel
def resolve_keys(
    keys: wp.array3d[wp.uint64],  # (B, H, W)
    face_labels: wp.array[wp.uint8],  # (F,)
    face_index: wp.array3d[int],  # (B, H, W)  OUTPUT
    depth: wp.array3d[float],  # (B, H, W) [m], inf = background  OUTPUT
    labels: wp.array3d[wp.uint8],  # (B, H, W), 0 = background  OUTPUT
):
    """Split the keys into face-index map, depth and label image."""
    b, row, column = wp.tid()
    key = keys[b, row, column]
    if key == EMPTY_KEY:
        face_index[b, row, column] = BACKGROUND
        depth[b, row, column] = wp.inf
        labels[b, row, column] = wp.uint8(0)
    else:
        face = key_face(key)
        face_index[b, row, column] = face
        depth[b, row, column] = key_depth(key)
        labels[b, row, column] = face_labels[face]


@wp.kernel
def label_loss_rows(
    labels: wp.array3d[wp.uint8],  # (B, H, W)
    target: wp.array3d[wp.uint8],  # (B, H, W), 255 = ignore
    label_weights: wp.array[float],  # (256,)
    row_losses: wp.array2d[float],  # (B, H)  OUTPUT
):
    """L_seg (paper, eq. 6) of each row from two label images: a wrong pixel misses one map and dirties another."""
    b, row = wp.tid()
    total = float(0.0)
    for column in range(labels.shape[2]):
        shown = labels[b, row, column]
        want = target[b, row, column]
        if shown != want and want != IGNORE:
            total += label_weights[int(shown)] + label_weights[int(want)]
    row_losses[b, row] = total


def launch_rasterize(
    vertices: wp.array,
    faces: wp.array,
    face_labels: wp.array,
    *,
    near: float,
    perspective: bool,
    keys: wp.array,
    face_index: wp.array,
    depth: wp.array,
    labels: wp.array,
) -> None:
    """Clear the keys, draw every face, write face-index map, depth and labels."""
    device = vertices.device
    lanes = row_lanes(device)
    keys.fill_(EMPTY_KEY)
    dim = (vertices.shape[0], faces.shape[0], lanes)
    wp.launch(draw_faces, dim, [vertices, faces, near, perspective, lanes], [keys], device=device)
    wp.launch(resolve_keys, keys.shape, [keys, face_labels], [face_index, depth, labels], device=device)


def launch_label_loss(labels: wp.array, target: wp.array, label_weights: wp.array, row_losses: wp.array) -> None:
    """Fill the loss of each row; entry 0 of ``label_weights`` must be 0, as background has no part map."""
    wp.launch(label_loss_rows, row_losses.shape, [labels, target, label_weights], [row_losses], device=labels.device)


def row_lanes(device: wp.Device) -> int:
    """How many threads share the rows of a face: the CPU device runs its threads one after another, one is best."""
    return 1 if device.is_cpu else _ROW_LANES
