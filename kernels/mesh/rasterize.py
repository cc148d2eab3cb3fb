"""Forward pass of the mesh renderer: z-buffer of a part-labelled mesh (paper, eq. 8 and 9), repeatable to the bit."""

from dataclasses import dataclass
from typing import Any, Self

import warp as wp

from ..labels import EACH_BYTE, IGNORED, QUAD, are_words, flat, load_word, map_weight, note_wrong, unequal_bytes
from ..lanes import LANES, ballot, lowest_bit, shuffle
from .triangles import (
    ImageArrays,
    MeshArrays,
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

wp.set_module_options({"enable_backward": False, "fast_math": True})

EMPTY_KEY = wp.constant(wp.uint64(0xFFFFFFFFFFFFFFFF))  # behind every face

# Keys are read in tiles, so that tiles without a face cost next to nothing. On CUDA a warp has a row of tiles, a thread
# a column of each, whose rows it loads together.
TILE_ROWS = wp.constant(4)
TILE_COLUMNS = wp.constant(32)

# Label images are compared in blocks of 4 x 4 pixels, as high as a tile, each by one thread.
_Words = wp.types.vector(length=4, dtype=wp.uint32)  # a block's labels, a row each, the leftmost lowest

# On CUDA the rows of one face are shared by some threads, so that a large face does not hold up its warp: by more where
# few faces would leave the device idle. Measured on an H200: docs/performance.md.
_MIN_ROW_LANE_BITS = 1
_MAX_ROW_LANE_BITS = 4
_THREADS_TO_FILL = 1 << 17

# On CUDA, threads a block and blocks a multiprocessor: enough threads to hide the memory's latency.
_DRAW_FACES_BOUNDS = (256, 5)
_COMPARE_LABELS_BOUNDS = (256, 4)

_MAX_THREADS = 2**31 - 2**16  # of a launch


@dataclass(frozen=True)
class ZBuffer:
    """Scratch of a z-buffer, for one launch at a time.

    Attributes:
        keys: Nearest face at a pixel as ``depth_key``, shape (B, H, W). ``EMPTY_KEY`` between launches: who reads a key
            puts it back, so that a picture costs only the pixels that show something.
        touched: 1 where a face may lie in a tile, shape (B, tiles down, tiles across), uint8. 0 between launches,
            likewise.
    """

    keys: wp.array
    touched: wp.array

    @classmethod
    def make(cls, batch: int, height: int, width: int, device: str | wp.Device) -> Self:
        """Allocate an empty z-buffer."""
        tiles = (batch, -(-height // int(TILE_ROWS)), -(-width // int(TILE_COLUMNS)))
        keys = empty_keys((batch, height, width), device)
        return cls(keys=keys, touched=wp.zeros(tiles, dtype=wp.uint8, device=device))


def empty_keys(shape: tuple[int, ...], device: str | wp.Device) -> wp.array:
    """Keys behind every face, shape (B, H, W)."""
    return wp.full(shape, EMPTY_KEY, dtype=wp.uint64, device=device)


@wp.kernel(launch_bounds=_DRAW_FACES_BOUNDS)
def draw_faces(
    first_body: int,
    threads: int,  # of one body
    mesh: MeshArrays,
    lane_bits: int,  # 2 ** lane_bits threads share a face's rows
    touched: wp.array3d[wp.uint8],  # (B, tiles down, tiles across)  MODIFIED
    keys: wp.array3d[wp.uint64],  # (B, H, W)  MODIFIED: the nearest face's key
):
    """Nearest face at every pixel centre; a tie in depth goes to the lower face index."""
    thread = wp.tid()
    b = first_body + thread // threads
    lanes = 1 << lane_bits
    face = (thread % threads) >> lane_bits
    t = load_triangle(mesh, b, face)
    if t.valid == 0:
        return
    rows = pixel_rows(t, keys.shape[1])
    first_row = rows[0] + ((thread % threads) & (lanes - 1))
    if first_row > rows[1]:
        return
    e = make_edges(t)
    width = keys.shape[2]
    tiles = touched.shape[2]
    body_keys = flat(keys[b])
    body_touched = flat(touched[b])
    for row in range(first_row, rows[1] + 1, lanes):
        y = float(row) + 0.5
        columns = pixel_columns(e, y, width)
        for tile in range(columns[0] // TILE_COLUMNS, columns[1] // TILE_COLUMNS + 1):
            body_touched[row // TILE_ROWS * tiles + tile] = wp.uint8(1)
        for column in range(columns[0], columns[1] + 1):
            values = edge_values(e, float(column) + 0.5, y)
            if covers(e, values):
                depth = depth_at(t, weights_3d(t, values, mesh.perspective))
                wp.atomic_min(body_keys, row * width + column, depth_key(depth, face))


@wp.kernel
def resolve_keys(
    first_body: int,
    threads: int,
    mesh: MeshArrays,
    lanes: int,  # threads that share a row of tiles: a warp, or one
    touched: wp.array3d[wp.uint8],  # (B, tiles down, tiles across)  MODIFIED: cleared
    keys: wp.array3d[wp.uint64],  # (B, H, W)  MODIFIED: emptied
    images: ImageArrays,  # all but the labels may be null  OUTPUT
):
    """Split the keys into face-index map, depth and label image, where something shows."""
    thread = wp.tid()
    b = first_body + thread // threads
    lane = (thread % threads) & (lanes - 1)
    tile_row = thread % threads // lanes
    width = keys.shape[2]
    tiles = touched.shape[2]
    rows = wp.min(TILE_ROWS, keys.shape[1] - tile_row * TILE_ROWS)
    body_keys = flat(keys[b])
    body_touched = flat(touched[b])
    body_labels = flat(images.labels[b])
    for first in range(0, tiles, lanes):
        show = bool(False)  # something, in this thread's tile
        if first + lane < tiles:
            mine = tile_row * tiles + first + lane
            show = body_touched[mine] != wp.uint8(0)
            if show:
                body_touched[mine] = wp.uint8(0)
        waiting = ballot(show)
        while waiting != wp.uint32(0):
            tile = first + lowest_bit(waiting)
            waiting &= waiting - wp.uint32(1)
            for column in range(tile * TILE_COLUMNS + lane, wp.min((tile + 1) * TILE_COLUMNS, width), lanes):
                top = tile_row * TILE_ROWS * width + column
                # all loads of a tile's column first, so that their latencies overlap
                found = wp.vector(EMPTY_KEY, length=TILE_ROWS, dtype=wp.uint64)
                for k in range(TILE_ROWS):
                    if k < rows:
                        found[k] = body_keys[top + k * width]
                for k in range(TILE_ROWS):
                    if found[k] != EMPTY_KEY:
                        at = top + k * width
                        body_keys[at] = EMPTY_KEY
                        face = key_face(found[k])
                        body_labels[at] = mesh.face_labels[face]
                        if images.face_index:
                            flat(images.face_index[b])[at] = face
                        if images.depth:
                            flat(images.depth[b])[at] = key_depth(found[k])


@wp.kernel(launch_bounds=_COMPARE_LABELS_BOUNDS)
def compare_labels(
    first_body: int,
    threads: int,
    labels: wp.array3d[wp.uint8],  # (B, H, W)
    target: wp.array3d[wp.uint8],  # (B, H, W), 255 = ignore
    lanes: int,  # threads that share a row of blocks: a warp, or one
    extents: wp.array3d[wp.vec4i],  # (B, 3, L), zeroed, as ``grow``  MODIFIED
    losses: wp.array3d[float],  # ``pixel_lanes``  OUTPUT
):
    """L_seg (paper, eq. 6) from two label images, and the extents in which they differ."""
    thread = wp.tid()
    b = first_body + thread // threads
    lane = (thread % threads) & (lanes - 1)
    block_row = thread % threads // lanes
    height = labels.shape[1]
    width = labels.shape[2]
    top = block_row * QUAD
    in_words = are_words(labels) and are_words(target)
    loss = float(0.0)
    for first in range(0, width, lanes * QUAD):
        left = first + lane * QUAD
        shown = _Words()
        expected = _Words()
        for k in range(QUAD):
            shown[k] = load_word(labels[b], top + k, left, in_words)
            expected[k] = load_word(target[b], top + k, left, in_words)
        wrong = _Words()
        for k in range(QUAD):
            wrong[k] = unequal_bytes(shown[k], expected[k]) & unequal_bytes(expected[k], IGNORED)
        # all four count from a border of the picture, so that zero is empty
        reach = wp.vec4i(height - top, wp.min(top + QUAD, height), width - left, wp.min(left + QUAD, width))
        # one pair of labels after another, the same for all threads
        pair = first_pair(shown, expected, wrong)
        waiting = ballot(pair != wp.uint32(0))
        while waiting != wp.uint32(0):
            pair = shuffle(pair, lowest_bit(waiting))
            shown_label = pair & wp.uint32(255)
            target_label = pair >> wp.uint32(8)
            count = int(0)
            for k in range(QUAD):
                other = unequal_bytes(shown[k], shown_label * EACH_BYTE)
                other |= unequal_bytes(expected[k], target_label * EACH_BYTE)
                count += wp.bit_count(wrong[k] & ~other)
                wrong[k] &= other
            loss += float(count) * (map_weight(int(shown_label)) + map_weight(int(target_label)))
            concerned = ballot(count > 0)
            # the first of these blocks and the last one reach as far as all of them
            if lane == lowest_bit(concerned) or concerned >> wp.uint32(lane) == wp.uint32(1):
                note_wrong(extents, b, int(shown_label), int(target_label), reach)
            pair = first_pair(shown, expected, wrong)
            waiting = ballot(pair != wp.uint32(0))
    losses[b, block_row, lane] = loss


@wp.func
def first_pair(shown: Any, expected: Any, wrong: Any):  # _Words, in which mypy sees no type
    """Label that one of the wrong pixels shows, plus 256 times its target; 0 if none is wrong."""
    bits = wrong[0]
    shown_word = shown[0]
    target_word = expected[0]
    for k in range(1, QUAD):
        if bits == wp.uint32(0):
            bits = wrong[k]
            shown_word = shown[k]
            target_word = expected[k]
    if bits == wp.uint32(0):
        return wp.uint32(0)
    shift = wp.uint32(lowest_bit(bits) & 24)
    return (shown_word >> shift & wp.uint32(255)) | ((target_word >> shift & wp.uint32(255)) << wp.uint32(8))


def launch_rasterize(mesh: MeshArrays, images: ImageArrays, *, zbuffer: ZBuffer, background: bool = True) -> None:
    """Draw every face: the label image and, unless None, depth and face-index map, all of them contiguous.

    Without ``background`` these two keep their values where nothing shows, which the gradient never reads.
    """
    images.labels.zero_()
    if background and images.depth is not None:
        images.depth.fill_(wp.inf)
    if background and images.face_index is not None:
        images.face_index.fill_(-1)  # paper, eq. 8
    device = mesh.vertices.device
    batch, faces = mesh.vertices.shape[0], mesh.faces.shape[0]
    bits = row_lane_bits(batch * faces, device)
    buffers = [zbuffer.touched, zbuffer.keys]
    launch_bodies(draw_faces, batch, faces << bits, [mesh, bits], buffers, device)
    _, tile_rows, lanes = pixel_lanes(images.labels.shape, device.is_cpu)
    launch_bodies(resolve_keys, batch, tile_rows * lanes, [mesh, lanes], [*buffers, images], device)


def launch_compare_labels(labels: wp.array, target: wp.array, *, extents: wp.array, losses: wp.array) -> None:
    """Fill partial sums of the loss, shape ``pixel_lanes``, and the ``extents`` (B, 3, L) of wrong pixels.

    Both images are contiguous. Labels from L on have no extent.
    """
    extents.zero_()
    batch, block_rows, lanes = losses.shape
    launch_bodies(compare_labels, batch, block_rows * lanes, [labels, target, lanes], [extents, losses], labels.device)


def launch_bodies(
    kernel: wp.Kernel, batch: int, threads: int, inputs: list[Any], outputs: list[Any], device: wp.Device
) -> None:
    """Launch ``threads`` for each body.

    In one dimension, which a kernel splits in 32 bits by its first two arguments: Warp's own split takes 64-bit
    divisions. A batch of more threads than that takes several launches.
    """
    at_once = max(_MAX_THREADS // max(threads, 1), 1)
    for first in range(0, batch, at_once):
        dim = min(batch - first, at_once) * threads
        wp.launch(kernel, dim, [first, threads, *inputs], outputs, device=device)


def row_lane_bits(count: int, device: wp.Device) -> int:
    """Base-2 logarithm of the number of threads that share the rows of one of ``count`` faces: 0 on the CPU."""
    if device.is_cpu:
        return 0
    return min(max((_THREADS_TO_FILL // max(count, 1)).bit_length() - 1, _MIN_ROW_LANE_BITS), _MAX_ROW_LANE_BITS)


def pixel_lanes(shape: tuple[int, ...], on_cpu: bool) -> tuple[int, int, int]:
    """Threads that visit all pixels of images (B, H, W): bodies, groups of ``TILE_ROWS`` rows, and a warp on CUDA."""
    return (shape[0], -(-shape[1] // int(TILE_ROWS)), 1 if on_cpu else int(LANES))
