"""Z-buffer of a part-labelled mesh (paper, eq. 8), repeatable to the bit."""

from dataclasses import dataclass
from typing import Any, Self

import warp as wp

from ..labels import QUAD, flat
from .triangles import (
    EMPTY_KEY,
    MeshArrays,
    covers,
    depth_at,
    depth_key,
    edge_values,
    is_finite,
    load_triangle,
    make_edges,
    pixel_columns,
    pixels_between,
    weights_3d,
)

wp.set_module_options({"enable_backward": False, "fast_math": True})

# Pictures are read in squares of 8 by 4 blocks of 4 x 4 pixels, so that squares without a face cost next to nothing. On
# CUDA a warp has a square, and a thread a block of it or a column.
BLOCKS_ACROSS = wp.constant(8)
BLOCKS_DOWN = wp.constant(4)
SQUARE_ROWS = wp.constant(int(BLOCKS_DOWN) * int(QUAD))
SQUARE_COLUMNS = wp.constant(int(BLOCKS_ACROSS) * int(QUAD))

# On CUDA the rows of one face are shared by some threads, so that a large face does not hold up its warp: by more where
# few faces would leave the device idle, by none where there are so many that a face's own work counts. On an H200 (Warp
# 1.19, 2026-11-27) 0.8 to 3.3 million faces of 3 to 13 px take 70 to 97 % of the time of two threads a face.
_MIN_ROW_LANE_BITS = 1
_MAX_ROW_LANE_BITS = 4
_THREADS_TO_FILL = 1 << 17
_ONE_THREAD_EACH = 1 << 19  # faces

# On CUDA, threads a block and blocks a multiprocessor: enough threads to hide the memory's latency.
_DRAW_FACES_BOUNDS = (256, 5)

_MAX_THREADS = 2**31 - 2**16  # of a launch


@dataclass(frozen=True)
class ZBuffer:
    """Scratch of a z-buffer, for one launch at a time.

    Attributes:
        keys: Nearest face at a pixel as ``depth_key``, shape (B, H, W). Each ``is_empty`` between launches: each
            reader of a key makes it so, so that a picture costs only the pixels that show something.
        touched: Flag that is 1 where a face may lie in a square, shape (B, squares down, squares across), uint8. It is
            0 between launches.
        faults: Faults as in ``ImageArrays``, shape (B,). They are 0 between launches.
    """

    keys: wp.array
    touched: wp.array
    faults: wp.array

    @classmethod
    def make(cls, batch: int, height: int, width: int, device: str | wp.Device) -> Self:
        """Allocate an empty z-buffer."""
        keys, squares = empty_keys((batch, height, width), device), (batch, *num_squares(height, width))
        touched, faults = wp.zeros(squares, dtype=wp.uint8, device=device), wp.zeros(batch, dtype=float, device=device)
        return cls(keys, touched, faults)


def num_squares(height: int, width: int) -> tuple[int, int]:
    """Squares that cover a picture: down and across."""
    return -(-height // int(SQUARE_ROWS)), -(-width // int(SQUARE_COLUMNS))


def empty_keys(shape: tuple[int, ...], device: str | wp.Device) -> wp.array:
    """Keys behind every face, shape (B, H, W)."""
    return wp.full(shape, EMPTY_KEY, dtype=wp.uint64, device=device)


@wp.kernel(launch_bounds=_DRAW_FACES_BOUNDS)
def draw_faces(
    first_body: int,
    threads: int,  # of one body
    mesh: MeshArrays,
    lane_bits: int,  # 2 ** lane_bits threads share a face's rows
    touched: wp.array3d[wp.uint8],  # (B, squares down, squares across)  MODIFIED
    keys: wp.array3d[wp.uint64],  # (B, H, W)  MODIFIED: the nearest face's key
    faults: wp.array[float],  # (B,)  MODIFIED: NaN if a face is not finite
):
    """Nearest face at every pixel centre; a tie in depth goes to the lower face index."""
    thread = wp.tid()
    b = first_body + thread // threads
    lanes = 1 << lane_bits
    face = (thread % threads) >> lane_bits
    t = load_triangle(mesh, b, face)
    if not is_finite(t):
        faults[b] = wp.nan  # all who find one write the same
        return
    if t.valid == 0:
        return
    width = keys.shape[2]
    rows = pixels_between(t, 1, keys.shape[1])
    bounds = pixels_between(t, 0, width)
    lane = (thread % threads) & (lanes - 1)
    first_row = rows[0] + lane
    if first_row > rows[1] or bounds[0] > bounds[1]:
        return
    if lane == 0:
        for down in range(rows[0] // SQUARE_ROWS, rows[1] // SQUARE_ROWS + 1):
            for across in range(bounds[0] // SQUARE_COLUMNS, bounds[1] // SQUARE_COLUMNS + 1):
                touched[b, down, across] = wp.uint8(1)
    e = make_edges(t)
    body_keys = flat(keys[b])
    for row in range(first_row, rows[1] + 1, lanes):
        y = float(row) + 0.5
        columns = pixel_columns(e, y, width)
        for column in range(columns[0], columns[1] + 1):
            values = edge_values(e, float(column) + 0.5, y)
            if covers(e, values):
                depth = depth_at(t, weights_3d(t, values, mesh.perspective))
                wp.atomic_min(body_keys, row * width + column, depth_key(depth, face))


def launch_draw_faces(mesh: MeshArrays, zbuffer: ZBuffer) -> None:
    """Draw every face into an empty z-buffer."""
    device = mesh.vertices.device
    batch, faces = mesh.vertices.shape[0], mesh.faces.shape[0]
    bits = row_lane_bits(batch * faces, device)
    outputs = [zbuffer.touched, zbuffer.keys, zbuffer.faults]
    launch_bodies(draw_faces, batch, faces << bits, [mesh, bits], outputs, device)


def launch_bodies(
    kernel: wp.Kernel,
    batch: int,
    threads: int,
    inputs: list[Any],
    outputs: list[Any],
    device: wp.Device,
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
    if device.is_cpu or count >= _ONE_THREAD_EACH:
        return 0
    return min(max((_THREADS_TO_FILL // max(count, 1)).bit_length() - 1, _MIN_ROW_LANE_BITS), _MAX_ROW_LANE_BITS)
