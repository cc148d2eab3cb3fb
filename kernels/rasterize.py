"""PartDR's forward pass: z-buffer of a part-labelled mesh (paper, eq. 8 and 9), the same to the bit in every run."""

from dataclasses import dataclass
from typing import Self

import warp as wp

from .targets import flat
from .triangles import (
    BACKGROUND,
    covers,
    depth_at,
    depth_key,
    edge_values,
    key_depth,
    key_face,
    load_triangle,
    make_edges,
    pixel_columns,
    pixel_rows,
    weights_3d,
)

wp.set_module_options({"enable_backward": False})

EMPTY_KEY = wp.constant(wp.uint64(0xFFFFFFFFFFFFFFFF))  # behind every face
IGNORE = wp.constant(255)  # a target pixel that neither attracts nor repels

CHUNK = wp.constant(4)  # pixels that a thread loads together

# Keys are read in tiles, so that those without a face cost next to nothing. On CUDA a warp has a row of a tile, and a
# thread waits for all rows together.
TILE_ROWS = wp.constant(4)
TILE_COLUMNS = wp.constant(32)

# Which wrong pixels of a label ``compare_labels`` tells apart; index 1 of its ``extents``
MISSING = wp.constant(0)  # should show the label and do not
SURPLUS = wp.constant(1)  # show it and should not
HIDDEN = wp.constant(2)  # should show it and show another part; under label 0: any label
NUM_EXTENTS = 3

# On CUDA the rows of one face are shared by some threads, so that a large face does not hold up its warp: by more where
# few faces would leave the device idle. Measured on an H200: docs/performance.md.
_MIN_ROW_LANES = 2
_MAX_ROW_LANES = 16
_THREADS_TO_FILL = 1 << 17


@dataclass(frozen=True)
class ZBuffer:
    """Scratch of a z-buffer, for one launch at a time.

    Attributes:
        keys: Nearest face at a pixel as ``depth_key``, shape (B, H, W). ``EMPTY_KEY`` between launches: who reads a key
            puts it back, so that a picture costs only the pixels that show something.
        touched: Whether a face may lie in a tile, shape (B, tiles down, tiles across), uint8.
    """

    keys: wp.array
    touched: wp.array

    @classmethod
    def make(cls, batch: int, height: int, width: int, device: str | wp.Device) -> Self:
        """An empty one."""
        tiles = (batch, -(-height // int(TILE_ROWS)), -(-width // int(TILE_COLUMNS)))
        return cls(
            keys=empty_keys((batch, height, width), device),
            touched=wp.empty(tiles, dtype=wp.uint8, device=device),
        )


def empty_keys(shape: tuple[int, ...], device: str | wp.Device) -> wp.array:
    """Keys behind every face, shape (B, H, W)."""
    return wp.full(shape, EMPTY_KEY, dtype=wp.uint64, device=device)


@wp.kernel
def draw_faces(
    vertices: wp.array2d[wp.vec3],  # (B, V) screen space
    faces: wp.array[wp.vec3i],  # (F,)
    near: float,  # [m]
    perspective: bool,
    lanes: int,
    touched: wp.array3d[wp.uint8],  # (B, tiles down, tiles across), zeroed  MODIFIED
    keys: wp.array3d[wp.uint64],  # (B, H, W)  MODIFIED: the nearest face's key
):
    """Nearest face at every pixel centre; a tie in depth goes to the lower face index."""
    b, face, lane = wp.tid()
    t = load_triangle(vertices, faces, b, face, near)
    if t.valid == 0:
        return
    rows = pixel_rows(t, keys.shape[1])
    if rows[0] + lane > rows[1]:
        return
    e = make_edges(t)
    width = keys.shape[2]
    body_keys = flat(keys[b])
    for row in range(rows[0] + lane, rows[1] + 1, lanes):
        y = float(row) + 0.5
        columns = pixel_columns(e, y, width)
        for tile in range(columns[0] // TILE_COLUMNS, columns[1] // TILE_COLUMNS + 1):
            touched[b, row // TILE_ROWS, tile] = wp.uint8(1)
        for column in range(columns[0], columns[1] + 1):
            values = edge_values(e, float(column) + 0.5, y)
            if covers(e, values):
                depth = depth_at(t, weights_3d(t, values, perspective))
                wp.atomic_min(body_keys, row * width + column, depth_key(depth, face))


@wp.kernel
def resolve_keys(
    face_labels: wp.array[wp.uint8],  # (F,)
    touched: wp.array3d[wp.uint8],  # (B, tiles down, tiles across)
    lanes: int,
    keys: wp.array3d[wp.uint64],  # (B, H, W)  MODIFIED: emptied
    face_index: wp.array3d[int],  # (B, H, W), may be null  OUTPUT
    depth: wp.array3d[float],  # (B, H, W) [m], may be null  OUTPUT
    labels: wp.array3d[wp.uint8],  # (B, H, W)  OUTPUT
):
    """Split the keys into face-index map, depth and label image, where something shows."""
    b, tile_row, lane = wp.tid()
    height = keys.shape[1]
    width = keys.shape[2]
    body_keys = flat(keys[b])
    body_labels = flat(labels[b])
    for tile in range(touched.shape[2]):
        if touched[b, tile_row, tile] == wp.uint8(0):
            continue
        for column in range(tile * TILE_COLUMNS + lane, wp.min((tile + 1) * TILE_COLUMNS, width), lanes):
            # all loads of a tile's column first, so that they wait together
            found = wp.vector(EMPTY_KEY, length=TILE_ROWS, dtype=wp.uint64)
            for k in range(TILE_ROWS):
                row = tile_row * TILE_ROWS + k
                if row < height:
                    found[k] = body_keys[row * width + column]
            for k in range(TILE_ROWS):
                if found[k] != EMPTY_KEY:
                    row = tile_row * TILE_ROWS + k
                    at = row * width + column
                    body_keys[at] = EMPTY_KEY
                    face = key_face(found[k])
                    body_labels[at] = face_labels[face]
                    if face_index:
                        face_index[b, row, column] = face
                    if depth:
                        depth[b, row, column] = key_depth(found[k])


@wp.kernel
def compare_labels(
    labels: wp.array3d[wp.uint8],  # (B, H, W)
    target: wp.array3d[wp.uint8],  # (B, H, W), 255 = ignore
    label_weights: wp.array[float],  # (256,)
    lanes: int,
    extents: wp.array3d[wp.vec4i],  # (B, 3, L), zeroed, as ``grow``  MODIFIED
    losses: wp.array3d[float],  # ``pixel_lanes``  OUTPUT
):
    """L_seg (paper, eq. 6) from two label images, and where they differ.

    A wrong pixel misses one map and dirties another.
    """
    b, tile_row, lane = wp.tid()
    width = labels.shape[2]
    body_labels = flat(labels[b])
    body_target = flat(target[b])
    aligned = width % CHUNK == 0 and ((labels.ptr | target.ptr) & wp.uint64(3)) == wp.uint64(0)
    total = float(0.0)
    for row in range(tile_row * TILE_ROWS, wp.min((tile_row + 1) * TILE_ROWS, labels.shape[1])):
        for start in range(lane * CHUNK, width, lanes * CHUNK):
            shown_chunk = load_chunk(body_labels, row * width + start, width - start, aligned)
            wanted_chunk = load_chunk(body_target, row * width + start, width - start, aligned)
            if shown_chunk == wanted_chunk:
                continue
            first = start  # of a run of pixels with the same two labels
            for k in range(CHUNK):
                shown = int(shown_chunk & wp.uint32(255))
                wanted = int(wanted_chunk & wp.uint32(255))
                shown_chunk = shown_chunk >> wp.uint32(8)
                wanted_chunk = wanted_chunk >> wp.uint32(8)
                end = start + k + 1
                wrong = shown != wanted and wanted != IGNORE
                if wrong:
                    total += label_weights[shown] + label_weights[wanted]
                is_last = k == CHUNK - 1
                if not is_last:
                    is_last = int(shown_chunk & wp.uint32(255)) != shown or int(wanted_chunk & wp.uint32(255)) != wanted
                if is_last:
                    if wrong:
                        reach = wp.vec4i(labels.shape[1] - row, row + 1, width - first, end)
                        note_wrong(extents, b, shown, wanted, reach)
                    first = end
    losses[b, tile_row, lane] = total


@wp.func
def load_chunk(image: wp.array[wp.uint8], at: int, count: int, aligned: bool):
    """Four pixels of a row in one number, the first one lowest; 0 past the row's end."""
    if aligned:
        words = wp.array(ptr=image.ptr, shape=(image.shape[0] // CHUNK,), dtype=wp.uint32)
        return words[at // CHUNK]
    chunk = wp.uint32(0)
    for k in range(CHUNK):
        if k < count:
            chunk = chunk | (wp.uint32(image[at + k]) << wp.uint32(8 * k))
    return chunk


@wp.func
def note_wrong(extents: wp.array3d[wp.vec4i], b: int, shown: int, wanted: int, reach: wp.vec4i):
    """Record pixels that show one label and should show the other."""
    if shown != 0:
        grow(extents, b, SURPLUS, shown, reach)
    if wanted != 0:
        grow(extents, b, MISSING, wanted, reach)
        if shown != 0:
            grow(extents, b, HIDDEN, wanted, reach)
            grow(extents, b, HIDDEN, 0, reach)


@wp.func
def grow(extents: wp.array3d[wp.vec4i], b: int, kind: int, label: int, reach: wp.vec4i):
    """Let a label's extent reach a pixel; all four count from a border of the picture, so that zero is empty."""
    if label >= extents.shape[2]:
        return
    have = extents[b, kind, label]
    # Extents only grow, so a stale value is safe; hardly any pixel needs the atomic.
    if reach[0] > have[0] or reach[1] > have[1] or reach[2] > have[2] or reach[3] > have[3]:
        wp.atomic_max(extents, b, kind, label, reach)


def launch_rasterize(
    vertices: wp.array,
    faces: wp.array,
    face_labels: wp.array,
    *,
    near: float,
    perspective: bool,
    zbuffer: ZBuffer,
    labels: wp.array,
    depth: wp.array | None = None,
    face_index: wp.array | None = None,
    background: bool = True,
) -> None:
    """Draw every face; write the label image and, where asked for, depth and face-index map, all of them contiguous.

    Without ``background`` these two stay as they were where nothing shows; the gradient does not look there.
    """
    labels.zero_()
    if background and depth is not None:
        depth.fill_(wp.inf)
    if background and face_index is not None:
        face_index.fill_(BACKGROUND)
    device = vertices.device
    lanes = row_lanes(vertices.shape[0] * faces.shape[0], device)
    zbuffer.touched.zero_()
    wp.launch(
        draw_faces,
        (vertices.shape[0], faces.shape[0], lanes),
        [vertices, faces, near, perspective, lanes],
        [zbuffer.touched, zbuffer.keys],
        device=device,
    )
    dim = pixel_lanes(labels.shape, device.is_cpu)
    wp.launch(
        resolve_keys,
        dim,
        [face_labels, zbuffer.touched, dim[2]],
        [zbuffer.keys, face_index, depth, labels],
        device=device,
    )


def launch_compare_labels(
    labels: wp.array, target: wp.array, label_weights: wp.array, *, extents: wp.array, losses: wp.array
) -> None:
    """Fill partial sums of the loss, shape ``pixel_lanes``, and the ``extents`` (B, 3, L) of wrong pixels.

    Both images are contiguous. Entry 0 of ``label_weights`` must be 0, as background has no part map. Labels from L on
    have no extent.
    """
    extents.zero_()
    lanes = losses.shape[2]
    wp.launch(
        compare_labels,
        losses.shape,
        [labels, target, label_weights, lanes],
        [extents, losses],
        device=labels.device,
    )


def row_lanes(count: int, device: wp.Device) -> int:
    """How many threads share the rows of one of ``count`` faces: the CPU device runs them one after another, so one."""
    if device.is_cpu:
        return 1
    return min(max(_THREADS_TO_FILL // max(count, 1), _MIN_ROW_LANES), _MAX_ROW_LANES)


def pixel_lanes(shape: tuple[int, ...], on_cpu: bool) -> tuple[int, int, int]:
    """Threads that visit all pixels of images (B, H, W): bodies, groups of ``TILE_ROWS`` rows, ``column_lanes``."""
    return (shape[0], -(-shape[1] // int(TILE_ROWS)), column_lanes(on_cpu))


def column_lanes(on_cpu: bool) -> int:
    """How many threads share pixel rows: a warp on CUDA, so that they read neighbouring pixels."""
    return 1 if on_cpu else int(TILE_COLUMNS)
