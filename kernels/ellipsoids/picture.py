"""Picture of ellipsoids: nearest ellipsoid, depth and L_seg at each pixel, by one algorithm for CUDA and one for CPU.

Both decide with the same functions: an ellipsoid covers a pixel where ``inside_at`` its centre is positive, the nearest
shows, and of equal ones that with the lower index.
"""

from collections.abc import Sequence
from typing import Any

import warp as wp

from ..labels import (
    EACH_BYTE,
    IGNORE,
    IGNORED,
    QUAD,
    LabelTarget,
    are_words,
    byte_of,
    cost_of,
    flat,
    load_word,
    note_wrong,
    target_of,
    unequal_bytes,
    words_of,
    write_word,
)
from ..lanes import LANES, ballot, lowest_bit, shuffle, sum_lanes
from .silhouette import Silhouette, along_row, depth_of, find_fault, inside_at, middle_at, row_lean, row_root, to_disc

wp.set_module_options({"enable_backward": False, "fast_math": True})

# On CUDA a warp draws a tile of the picture strip by strip. Its threads draw four neighbouring pixels of a row each.
# Fewer, longer warps cost least, but small batches need many to fill the GPU.
_STRIP_WIDTH = wp.constant(16)
_STRIP_ROWS = wp.constant(8)
_QUADS = wp.constant(4)  # a row of a strip
_BLOCK = 128
_MAX_STRIPS = 8  # 64 bits hold one for each strip and each of a thread's 8 ellipsoids
_Strips: Any = wp.types.vector(length=_MAX_STRIPS, dtype=wp.uint32)
_WARPS_TO_FILL = 4096  # of 132 multiprocessors
_EACH_WORD = wp.constant(wp.uint64(0x0101010101010101))  # bit 0 of each byte
_SLACK = wp.constant(1.0e-5)  # relative margin of bounds in float32


@wp.func
def pack(values: wp.vec4i):
    """Four bytes as one word, in the order of memory."""
    word = wp.uint32(values[0])
    for i in range(1, QUAD):
        word |= wp.uint32(values[i]) << wp.uint32(8 * i)
    return word


@wp.func
def note_pixel(target: LabelTarget, b: int, row: int, column: int, expected: int, label: int):
    """Record where a pixel is wrong, if the gradient asks for it."""
    if target.extents.shape[0] > 0 and expected != label and expected != IGNORE:
        height, width = target.target.shape[1], target.target.shape[2]
        note_wrong(target.extents, b, label, expected, wp.vec4i(height - row, row + 1, width - column, column + 1))


@wp.func
def may_meet(s: Silhouette, left: float, right: float, top: float, bottom: float):
    """False if an outline surely misses a rectangle of pixels."""
    if not (s.low[0] < right and s.high[0] > left and s.low[1] < bottom and s.high[1] > top):
        return False
    # Within these rows the outline is farthest right in the row nearest to that of its rightmost point.
    half = s.high[0] - s.mean[0]
    tilt = s.factor[1] / s.factor[2] * half
    dy = wp.clamp(-tilt, top - s.mean[1], bottom - s.mean[1])
    along = along_row(s)
    root = wp.max(row_root(s, dy), 0.0)
    slack = 0.5 + _SLACK * half
    if s.mean[0] + (wp.sqrt(root) - row_lean(s, dy)) / along + slack < left:
        return False
    dy = wp.clamp(tilt, top - s.mean[1], bottom - s.mean[1])
    root = wp.max(row_root(s, dy), 0.0)
    # ``not ... >``, for a root that overflowed must not leave anything out.
    return not s.mean[0] - (wp.sqrt(root) + row_lean(s, dy)) / along - slack > right


@wp.func
def draw_quad(ellipsoids: wp.array[Silhouette], meets: wp.uint64, words: int, x: float, y: float):
    """Index + 1 of the nearest ellipsoid at four pixels, and its nearness, of those that any thread says may meet them.

    Bit 8 word of ``meets`` says it of the thread's ellipsoid in that word.
    """
    shown = wp.vec4i(0, 0, 0, 0)
    best = wp.vec4(-wp.inf, -wp.inf, -wp.inf, -wp.inf)
    for word in range(words):
        bits = ballot((meets >> wp.uint64(8 * word)) & wp.uint64(1) == wp.uint64(1))
        while bits != wp.uint32(0):
            k = LANES * word + lowest_bit(bits)
            bits &= bits - wp.uint32(1)
            s = ellipsoids[k]
            place = to_disc(s, x - s.mean[0], y - s.mean[1])
            first_middle = middle_at(s, x, y)
            for i in range(QUAD):
                # Selects, not branches: neighbours disagree.
                u = place[0] + float(i) * s.factor[0]
                v = place[1] + float(i) * s.factor[1]
                inside = 1.0 - u * u - v * v
                nearness = first_middle + float(i) * s.slope[0] + s.bulge * wp.sqrt(wp.max(inside, 0.0))
                nearer = inside > 0.0 and nearness > best[i]
                best[i] = wp.where(nearer, nearness, best[i])
                shown[i] = wp.where(nearer, k + 1, shown[i])
    return shown, best


@wp.func
def note_strip(target: LabelTarget, b: int, label_word: wp.uint32, expected: wp.uint32, left: int, top: int):
    """Record where a strip is wrong, one pair of labels after another, the same for all threads."""
    height, width = target.target.shape[1], target.target.shape[2]
    wrong = unequal_bytes(label_word, expected) & unequal_bytes(expected, IGNORED)
    waiting = ballot(wrong != wp.uint32(0))
    while waiting != wp.uint32(0):
        finder = lowest_bit(waiting)
        shift = wp.uint32(lowest_bit(shuffle(wrong, finder)) & 24)
        label = shuffle(label_word, finder) >> shift & wp.uint32(255)
        wanted = shuffle(expected, finder) >> shift & wp.uint32(255)
        other = unequal_bytes(label_word, label * EACH_BYTE) | unequal_bytes(expected, wanted * EACH_BYTE)
        if wrong & ~other != wp.uint32(0):  # each of these threads says the same
            reach = wp.vec4i(
                height - top, wp.min(top + _STRIP_ROWS, height), width - left, wp.min(left + _STRIP_WIDTH, width)
            )
            note_wrong(target.extents, b, int(label), int(wanted), reach)
        wrong &= other
        waiting = ballot(wrong != wp.uint32(0))


@wp.kernel(launch_bounds=(_BLOCK, 8))  # 64 registers
def draw_tiles(
    silhouettes: wp.array2d[Silhouette],  # (B, P)
    perspective: bool,
    target: LabelTarget,
    strips: int,  # a tile
    parts: wp.array3d[wp.uint8],  # (B, H, W) index + 1 of the ellipsoid shown, 0 = background  OUTPUT
    labels: wp.array3d[wp.uint8],  # (B, H, W) or empty  OUTPUT
    depth: wp.array3d[float],  # (B, H, W) [m], inf = background, or empty  OUTPUT
    losses: wp.array2d[float],  # (B, T) L_seg of each tile, or empty  OUTPUT
    faults: wp.array[float],  # (B,) NaN: an ellipsoid is BROKEN, so that loss and depths are NaN; else 0  OUTPUT
):
    """Draw on CUDA: a warp reads only the ellipsoids that may meet its strip, after each thread tested one of them."""
    # One dimension, split in 32 bits: Warp's own split takes 64-bit divisions for every dimension.
    thread = wp.tid()
    lane = thread % LANES
    height = parts.shape[1]
    width = parts.shape[2]
    tile_height = strips * _STRIP_ROWS
    tiles = (width + _STRIP_WIDTH - 1) // _STRIP_WIDTH
    num_tiles = tiles * ((height + tile_height - 1) // tile_height)
    b = (thread // LANES) // num_tiles
    tile = (thread // LANES) - b * num_tiles
    if b >= parts.shape[0]:
        return
    ellipsoids = silhouettes[b]
    left = (tile % tiles) * _STRIP_WIDTH
    top = (tile // tiles) * tile_height
    column = left + (lane % _QUADS) * QUAD
    x = float(column) + 0.5
    right = float(left + _STRIP_WIDTH)
    count = silhouettes.shape[1]
    words = (count + LANES - 1) // LANES
    t = target_of(target, b)
    has_labels = labels.shape[0] > 0
    has_losses = losses.shape[0] > 0
    in_words = are_words(parts) and (are_words(labels) or not has_labels)
    in_words = in_words and (are_words(target.target) or not has_losses)
    # Views and places are found once: for each strip they would be half of the instructions.
    part_words = words_of(parts[b])
    label_words = words_of(labels[b])
    target_words = words_of(target.target[t])
    first_word = ((top + lane // _QUADS) * width + column) // QUAD
    fault = float(0.0)
    if tile == 0 or depth.shape[0] > 0:  # one tile spoils the sum of losses
        fault = find_fault(ellipsoids, lane, LANES)
        if tile == 0 and lane == 0:
            faults[b] = fault
    # Which strips each thread's own ellipsoids may meet: bit 8 word + strip.
    meets = wp.uint64(0)
    for word in range(words):
        k = LANES * word + lane
        if k < count:
            own = ellipsoids[k]
            if may_meet(own, float(left), right, float(top), float(top + tile_height)):
                for strip in range(strips):
                    first = float(top + strip * _STRIP_ROWS)
                    if may_meet(own, float(left), right, first, first + float(_STRIP_ROWS)):
                        meets |= wp.uint64(1) << wp.uint64(8 * word + strip)
    pitch = _STRIP_ROWS * width // QUAD
    if ballot(meets != wp.uint64(0)) == wp.uint32(0) and in_words and depth.shape[0] == 0:
        # Most tiles are background, and should be. All loads come before any store, which might be to the same place.
        wanted = _Strips()
        for strip in range(_MAX_STRIPS):
            if strip < strips and column < width and top + strip * _STRIP_ROWS + lane // _QUADS < height:
                if has_losses:
                    wanted[strip] = target_words[first_word + strip * pitch]
        some = wp.uint32(0)
        for strip in range(_MAX_STRIPS):
            some |= wanted[strip]
            if strip < strips and column < width and top + strip * _STRIP_ROWS + lane // _QUADS < height:
                part_words[first_word + strip * pitch] = wp.uint32(0)
                if has_labels:
                    label_words[first_word + strip * pitch] = wp.uint32(0)
        if ballot(some != wp.uint32(0)) == wp.uint32(0):
            if has_losses and lane == 0:
                losses[b, tile] = fault
            return
    loss = fault
    for strip in range(strips):
        row = top + strip * _STRIP_ROWS + lane // _QUADS
        in_picture = row < height and column < width
        at = first_word + strip * pitch
        best = wp.vec4()
        shown_word = wp.uint32(0)
        label_word = wp.uint32(0)
        mine = meets >> wp.uint64(strip)
        if ballot((mine & _EACH_WORD) != wp.uint64(0)) != wp.uint32(0):
            shown, best = draw_quad(ellipsoids, mine, words, x, float(row) + 0.5)
            shown_word = pack(shown)
            for i in range(QUAD):
                if shown[i] > 0 and column + i < width:
                    label_word |= wp.uint32(ellipsoids[shown[i] - 1].label) << wp.uint32(8 * i)
        expected = wp.uint32(0)
        if in_picture:
            if in_words:
                part_words[at] = shown_word
                if has_labels:
                    label_words[at] = label_word
                if has_losses:
                    expected = target_words[at]
            else:
                write_word(parts, b, row, column, shown_word, False)
                if has_labels:
                    write_word(labels, b, row, column, label_word, False)
                if has_losses:
                    expected = load_word(target.target[t], row, column, False)
            if depth.shape[0] > 0:
                for i in range(QUAD):
                    if column + i < width:
                        shows = byte_of(shown_word, i) > 0
                        depth[b, row, column + i] = fault + wp.where(shows, depth_of(best[i], perspective), wp.inf)
        if has_losses:
            if not in_picture:
                label_word = wp.uint32(0)
            if expected != label_word:
                for i in range(QUAD):
                    loss += cost_of(target, byte_of(expected, i), byte_of(label_word, i))
            if target.extents.shape[0] > 0:
                note_strip(target, b, label_word, expected, left, top + strip * _STRIP_ROWS)
    if has_losses:
        total = sum_lanes(loss)
        if lane == 0:
            losses[b, tile] = total


@wp.kernel
def draw_rows(
    silhouettes: wp.array2d[Silhouette],
    perspective: bool,
    target: LabelTarget,
    nearest: wp.array3d[float],  # (B, H, W) scratch
    parts: wp.array3d[wp.uint8],
    labels: wp.array3d[wp.uint8],
    depth: wp.array3d[float],
    losses: wp.array2d[float],  # (B, H)
    faults: wp.array[float],
):
    """Draw on the CPU: a row meets each outline in one closed-form interval, and visits no other pixel."""
    b, row = wp.tid()
    width = parts.shape[2]
    begin = row * width
    image = flat(parts[b])
    fronts = flat(nearest[b])
    ellipsoids = silhouettes[b]
    y = float(row) + 0.5
    words = words_of(parts[b])
    in_words = are_words(parts)
    if in_words:
        for at in range(begin // QUAD, (begin + width) // QUAD):
            words[at] = wp.uint32(0)
    else:
        for at in range(begin, begin + width):
            image[at] = wp.uint8(0)
    fault = float(0.0)
    if row == 0 or depth.shape[0] > 0:
        fault = find_fault(ellipsoids, 0, 1)
        if row == 0:
            faults[b] = fault
    first = int(width)
    last = int(-1)
    for k in range(ellipsoids.shape[0]):
        if y > ellipsoids[k].low[1] and y < ellipsoids[k].high[1]:
            s = ellipsoids[k]
            dy = y - s.mean[1]
            root = row_root(s, dy)
            if root > 0.0:
                along = along_row(s)
                middle = s.mean[0] - row_lean(s, dy) / along
                reach = wp.sqrt(root) / along
                # One pixel more on either side, since ``inside_at`` decides.
                left = int(wp.clamp(middle - reach - 1.0, 0.0, float(width)))
                right = int(wp.clamp(middle + reach + 1.0, -1.0, float(width - 1)))
                # The nearness of background is set where an ellipsoid may be, and nowhere else.
                if last < first:
                    first = left
                    last = left - 1
                for column in range(left, first):
                    fronts[begin + column] = -wp.inf
                for column in range(last + 1, right + 1):
                    fronts[begin + column] = -wp.inf
                first = wp.min(first, left)
                last = wp.max(last, right)
                for column in range(left, right + 1):
                    x = float(column) + 0.5
                    inside = inside_at(s, x, y)
                    if inside > 0.0:
                        nearness = middle_at(s, x, y) + s.bulge * wp.sqrt(inside)
                        if nearness > fronts[begin + column]:
                            fronts[begin + column] = nearness
                            image[begin + column] = wp.uint8(k + 1)
    whole_picture = labels.shape[0] > 0 or depth.shape[0] > 0
    if whole_picture or losses.shape[0] > 0:
        loss = fault
        t = target_of(target, b)
        if losses.shape[0] > 0:
            in_words = in_words and are_words(target.target)
        together = wp.where(in_words, QUAD, 1)
        column = int(0)
        while column < width:  # a range with a step that varies took 20 us a picture more
            wrong_or_shown = bool(True)
            if in_words and not whole_picture:
                # Four pixels that show background and should.
                at = (begin + column) // QUAD
                wrong_or_shown = (words[at] | words_of(target.target[t])[at]) != wp.uint32(0)
            if wrong_or_shown:
                for i in range(together):
                    at = begin + column + i
                    part = int(image[at])
                    label = int(0)
                    if part > 0:
                        label = ellipsoids[part - 1].label
                    if labels.shape[0] > 0:
                        labels[b, row, column + i] = wp.uint8(label)
                    if depth.shape[0] > 0:
                        depth[b, row, column + i] = fault + wp.inf
                        if part > 0:
                            depth[b, row, column + i] = fault + depth_of(fronts[at], perspective)
                    if losses.shape[0] > 0:
                        expected = int(target.target[t, row, column + i])
                        loss += cost_of(target, expected, label)
                        note_pixel(target, b, row, column + i, expected, label)
            column += together
        if losses.shape[0] > 0:
            losses[b, row] = loss


def num_partial_losses(device: wp.Device, batch: int, height: int, width: int) -> int:
    """Number of partial sums of each picture's loss that ``launch_draw`` fills, T."""
    if device.is_cpu:
        return height
    return -(-height // (_STRIP_ROWS * _strips(batch, height, width))) * -(-width // _STRIP_WIDTH)


def _strips(batch: int, height: int, width: int) -> int:
    """Number of strips that a warp draws."""
    warps = batch * -(-height // _STRIP_ROWS) * -(-width // _STRIP_WIDTH)
    return max(min(warps // _WARPS_TO_FILL, _MAX_STRIPS), 1)


def launch_draw(
    silhouettes: wp.array, target: LabelTarget, nearest: wp.array, outputs: Sequence[wp.array], *, perspective: bool
) -> None:
    """Fill parts and faults, and of labels, depth and losses those that are not empty.

    All images are contiguous. ``nearest`` is the CPU's scratch of the picture's size; ``target`` is read for losses
    only.
    """
    device = silhouettes.device
    batch, height, width = outputs[0].shape
    inputs = [silhouettes, perspective, target]
    if device.is_cpu:
        wp.launch(draw_rows, (batch, height), [*inputs, nearest], [*outputs], device=device)
        return
    warps = batch * num_partial_losses(device, batch, height, width)
    dim = -(-warps * int(LANES) // _BLOCK) * _BLOCK
    wp.launch(draw_tiles, dim, [*inputs, _strips(batch, height, width)], [*outputs], device=device, block_dim=_BLOCK)
