"""Kernels that turn the z-buffer into labels, depth and faces (paper, eq. 8 and 9), and compute L_seg (eq. 6).

They also find where labels are wrong.
"""

from typing import Any

import warp as wp

from ..labels import (
    EACH_BYTE,
    HIDDEN,
    IGNORED,
    NUM_EXTENTS,
    QUAD,
    SURPLUS,
    Block,
    LabelTarget,
    are_words,
    first_pair,
    flat,
    hidden_pixels,
    load_block,
    unequal_bytes,
)
from ..lanes import LANES, ballot, highest_bit, lowest_bit, num_lanes, shuffle, sum_lanes, wait_for_lanes
from .rasterize import (
    BLOCKS_ACROSS,
    SQUARE_COLUMNS,
    SQUARE_ROWS,
    ZBuffer,
    launch_bodies,
)
from .triangles import EMPTY_KEY, ImageArrays, MeshArrays, empty_key, is_empty, key_depth, key_face

wp.set_module_options({"enable_backward": False, "fast_math": True})

# On CUDA, threads a block and blocks a multiprocessor: enough threads to hide the memory's latency.
_BOUNDS = (256, 4)
_KEYS_AT_ONCE = wp.constant(4)  # a divisor of ``SQUARE_ROWS``


@wp.func
def resolve_square(
    mesh: MeshArrays,
    touched: wp.array3d[wp.uint8],  # (B, squares down, squares across)  MODIFIED: cleared
    keys: wp.array3d[wp.uint64],  # (B, H, W)  MODIFIED: emptied, with the face
    images: ImageArrays,  # labels, which are 0; depth and face-index map may be null  OUTPUT
    b: int,
    square: int,
    lane: int,
    lanes: int,  # threads that share a square: a warp, or one
):
    """Split the keys of a square into labels, face-index map and depth where something shows.

    It returns true if something may show in the square.
    """
    height = keys.shape[1]
    width = keys.shape[2]
    first_row = square // touched.shape[2] * SQUARE_ROWS
    first_column = square % touched.shape[2] * SQUARE_COLUMNS
    flags = flat(touched[b])
    shows = flags[square] != wp.uint8(0)
    if shows:
        body_keys = flat(keys[b])
        for column in range(first_column + lane, wp.min(first_column + SQUARE_COLUMNS, width), lanes):
            row = first_row
            while row < wp.min(first_row + SQUARE_ROWS, height):
                # some loads first, so that their latencies overlap
                found = wp.vector(EMPTY_KEY, length=_KEYS_AT_ONCE, dtype=wp.uint64)
                nearest = EMPTY_KEY
                for k in range(_KEYS_AT_ONCE):
                    if row + k < height:
                        found[k] = body_keys[(row + k) * width + column]
                        nearest = wp.min(nearest, found[k])
                if not is_empty(nearest):
                    for k in range(_KEYS_AT_ONCE):
                        if not is_empty(found[k]):
                            at = (row + k) * width + column
                            face = key_face(found[k])
                            body_keys[at] = empty_key(face)
                            flat(images.labels[b])[at] = mesh.face_labels[face]
                            if images.face_index:
                                flat(images.face_index[b])[at] = face
                            if images.depth:
                                flat(images.depth[b])[at] = key_depth(found[k])
                row += _KEYS_AT_ONCE
        wait_for_lanes()  # for their labels, and until they have read the flag
        if lane == 0:
            flags[square] = wp.uint8(0)
    return shows


@wp.kernel(launch_bounds=_BOUNDS)
def resolve_keys(
    first_body: int,
    threads: int,
    mesh: MeshArrays,
    lanes: int,  # threads that share a square: a warp, or one
    touched: wp.array3d[wp.uint8],  # (B, squares down, squares across)  MODIFIED: cleared
    keys: wp.array3d[wp.uint64],  # (B, H, W)  MODIFIED: emptied
    faults: wp.array[float],  # (B,)  MODIFIED: 0 again
    images: ImageArrays,  # labels, which are 0; the others may be null  OUTPUT
):
    """Empty the z-buffer into the images."""
    thread = wp.tid()
    b = first_body + thread // threads
    if thread % threads == 0:
        if images.faults:
            images.faults[b] = faults[b]
        faults[b] = 0.0
    lane = (thread % threads) & (lanes - 1)
    resolve_square(mesh, touched, keys, images, b, thread % threads // lanes, lane, lanes)


@wp.func
def pair_of_blocks(shown: Any, expected: Any, wrong: Any):  # Blocks, in which mypy sees no type
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
    return first_pair(shown_word, target_word, bits)


@wp.func
def note_blocks(target: LabelTarget, b: int, kind: int, label: int, blocks: wp.uint32, top: int, left: int):
    """Record in which blocks of a square a label is wrong; (top, left) is the square's first pixel."""
    rows = wp.vec2i(lowest_bit(blocks) // BLOCKS_ACROSS, highest_bit(blocks) // BLOCKS_ACROSS)
    folded = blocks | (blocks >> wp.uint32(16))
    folded = (folded | (folded >> wp.uint32(8))) & wp.uint32(255)
    columns = wp.vec2i(lowest_bit(folded), highest_bit(folded))
    height = target.target.shape[1]
    width = target.target.shape[2]
    # all four count from a border of the picture, so that zero is empty
    reach = wp.vec4i(
        height - (top + rows[0] * QUAD),
        wp.min(top + (rows[1] + 1) * QUAD, height),
        width - (left + columns[0] * QUAD),
        wp.min(left + (columns[1] + 1) * QUAD, width),
    )
    if label < target.extents.shape[2]:
        wp.atomic_max(target.extents, b, kind, label, reach)  # a square has few: to look whether it has to takes longer


@wp.kernel(launch_bounds=_BOUNDS)
def compare_labels(
    first_body: int,
    threads: int,  # of one body
    mesh: MeshArrays,
    lanes: int,  # threads that share a square: a warp, or one
    touched: wp.array3d[wp.uint8],  # (B, squares down, squares across)  MODIFIED: cleared
    keys: wp.array3d[wp.uint64],  # (B, H, W)  MODIFIED: emptied
    faults: wp.array[float],  # (B,)  MODIFIED: 0 again
    images: ImageArrays,  # labels, which are 0; depth and face-index map may be null  OUTPUT
    target: LabelTarget,  # its extents, if it has any, are zeroed, as for ``grow``  MODIFIED
    hidden: wp.array3d[wp.uint32],  # (B, squares, 32) pixels of each block in which a part hides the target's  OUTPUT
    losses: wp.array2d[float],  # (B, squares)  OUTPUT
):
    """Empty the z-buffer into the images; L_seg (paper, eq. 6), and where labels differ from the target's."""
    thread = wp.tid()
    b = first_body + thread // threads
    lane = (thread % threads) & (lanes - 1)
    square = thread % threads // lanes
    across = touched.shape[2]
    first_row = square // across * SQUARE_ROWS
    first_column = square % across * SQUARE_COLUMNS
    drawn = resolve_square(mesh, touched, keys, images, b, square, lane, lanes)
    in_words = are_words(images.labels) and are_words(target.target)
    shown_image = images.labels[b]
    expected_image = target.target[b]
    loss = int(0)
    surplus = wp.uint32(0)  # blocks of the label whose number is the lane's
    missing = wp.uint32(0)
    behind = wp.uint32(0)
    for turn in range(LANES // lanes):
        block = turn * lanes + lane
        top = first_row + block // BLOCKS_ACROSS * QUAD
        left = first_column + block % BLOCKS_ACROSS * QUAD
        shown = Block()
        if drawn:
            shown = load_block(shown_image, top, left, in_words)
        expected = load_block(expected_image, top, left, in_words)
        pixels = wp.uint32(0)  # in which a part hides the target's
        different = wp.uint32(0)
        for k in range(QUAD):
            different |= shown[k] ^ expected[k]
        if ballot(different != wp.uint32(0)) != wp.uint32(0):  # most squares are background, and should be
            wrong = Block()
            for k in range(QUAD):
                shows = unequal_bytes(shown[k], wp.uint32(0))
                wants = unequal_bytes(expected[k], wp.uint32(0))
                wrong[k] = unequal_bytes(shown[k], expected[k]) & unequal_bytes(expected[k], IGNORED)
                pixels |= hidden_pixels(shown[k], expected[k]) >> wp.uint32(k)
                loss += wp.bit_count(wrong[k] & wants)
                loss += wp.bit_count(wrong[k] & shows & unequal_bytes(shown[k], IGNORED))
            # one pair of labels after another, the same for all threads
            pair = wp.uint32(0)
            if target.extents:
                pair = pair_of_blocks(shown, expected, wrong)
            waiting = ballot(pair != wp.uint32(0))
            while waiting != wp.uint32(0):
                pair = shuffle(pair, lowest_bit(waiting))
                some = wp.uint32(0)
                for k in range(QUAD):
                    other = unequal_bytes(shown[k], (pair & wp.uint32(255)) * EACH_BYTE)
                    other |= unequal_bytes(expected[k], (pair >> wp.uint32(8)) * EACH_BYTE)
                    some |= wrong[k] & ~other
                    wrong[k] &= other
                blocks = ballot(some != wp.uint32(0)) << wp.uint32(turn * lanes)
                shown_label = int(pair & wp.uint32(255))
                target_label = int(pair >> wp.uint32(8))
                # Each thread remembers the label of its number: to look at what is recorded takes long.
                surplus |= wp.where(shown_label == lane, blocks, wp.uint32(0))
                missing |= wp.where(target_label == lane, blocks, wp.uint32(0))
                behind |= wp.where(target_label == lane and shown_label != 0, blocks, wp.uint32(0))
                if lane == 0 and wp.max(shown_label, target_label) >= lanes:
                    kind = int(0)
                    while kind < NUM_EXTENTS:  # not unrolled, for the code is long
                        label = wp.where(kind == SURPLUS, shown_label, target_label)
                        if label >= lanes and (kind != HIDDEN or shown_label != 0):
                            note_blocks(target, b, kind, label, blocks, first_row, first_column)
                        kind += 1
                pair = pair_of_blocks(shown, expected, wrong)
                waiting = ballot(pair != wp.uint32(0))
        if hidden:
            hidden[b, square, block] = pixels
    if lane > 0:
        kind = int(0)
        while kind < NUM_EXTENTS:
            blocks = wp.where(kind == HIDDEN, behind, wp.where(kind == SURPLUS, surplus, missing))
            if blocks != wp.uint32(0):
                note_blocks(target, b, kind, lane, blocks, first_row, first_column)
            kind += 1
    total = sum_lanes(float(loss))
    if lane == 0:
        if square == 0:
            total += faults[b]
            images.faults[b] = faults[b]
            faults[b] = 0.0
        losses[b, square] = total


def launch_resolve_keys(mesh: MeshArrays, zbuffer: ZBuffer, images: ImageArrays, *, background: bool = True) -> None:
    """Empty a z-buffer into label image and, unless None, depth, face-index map and faults, all of them contiguous.

    The label image is 0 before. Without ``background``, depth and face-index map keep their values where nothing shows,
    which the gradient never reads.
    """
    if background and images.depth is not None:
        images.depth.fill_(wp.inf)
    if background and images.face_index is not None:
        images.face_index.fill_(-1)  # paper, eq. 8
    device = mesh.vertices.device
    batch, down, across = zbuffer.touched.shape
    lanes = num_lanes(device)
    outputs = [zbuffer.touched, zbuffer.keys, zbuffer.faults, images]
    launch_bodies(resolve_keys, batch, down * across * lanes, [mesh, lanes], outputs, device)


def launch_compare_labels(
    mesh: MeshArrays, zbuffer: ZBuffer, images: ImageArrays, target: Any, *, hidden: wp.array | None, losses: wp.array
) -> None:
    """Empty a z-buffer into images, as ``launch_resolve_keys`` without background, and compare them with a target.

    It fills partial sums of the loss (B, squares) and, unless None, ``hidden`` (B, squares, 32). It grows the
    LabelTarget's ``extents``, which are 0, unless they are None. The losses of bodies with faults become NaN. Labels
    from L on have no extent.
    """
    device = mesh.vertices.device
    batch, squares = losses.shape
    lanes = num_lanes(device)
    inputs = [mesh, lanes, zbuffer.touched, zbuffer.keys, zbuffer.faults, images, target]
    launch_bodies(compare_labels, batch, squares * lanes, inputs, [hidden, losses], device)
