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
    MISSING,
    QUAD,
    SURPLUS,
    LabelTarget,
    are_words,
    cost_of,
    first_pair,
    flat,
    note_wrong,
    target_of,
    unequal_bytes,
    words_of,
)
from ..lanes import LANES, ballot, highest_bit, lowest_bit, shuffle, sum_lanes
from .silhouette import Silhouette, along_row, depth_of, find_fault, inside_at, middle_at, row_lean, row_root, to_disc

wp.set_module_options({"enable_backward": False, "fast_math": True})

# On CUDA a warp draws a tile of the picture strip by strip. Its threads draw eight neighbouring pixels of a row each.
# Fewer, longer warps cost least, but small batches need many to fill the GPU.
_STRIP_WIDTH = wp.constant(32)  # pixels, a sector of memory
_STRIP_ROWS = wp.constant(8)
_RUN = wp.constant(8)  # pixels a thread
_RUNS = wp.constant(4)  # a row of a strip
_BLOCK = 128
_MAX_STRIPS = 4  # at most 8: 64 bits hold one for each strip and each of a thread's 8 ellipsoids
_Strips: Any = wp.types.vector(length=_MAX_STRIPS, dtype=wp.uint64)
_Indices: Any = wp.types.vector(length=8, dtype=wp.int32)
_Numbers: Any = wp.types.vector(length=8, dtype=wp.float32)
_WARPS_TO_FILL = 4096  # of 132 multiprocessors
_EACH_WORD = wp.constant(wp.uint64(0x0101010101010101))  # bit 0 of each byte
_SLACK = wp.constant(1.0e-5)  # relative margin of bounds in float32


@wp.func
def are_runs(images: wp.array3d[wp.uint8]):
    """True if contiguous images can be read eight pixels at once."""
    return images.shape[2] % _RUN == 0 and images.ptr % wp.uint64(8) == wp.uint64(0)


@wp.func
def row_of_pixels(images: wp.array3d[wp.uint8], row: int):
    """Row of contiguous images; rows are counted over all images."""
    width = images.shape[2]
    return wp.array(ptr=images.ptr + wp.uint64(row) * wp.uint64(width), shape=(width,), dtype=wp.uint8)


@wp.func
def runs_of(images: wp.array3d[wp.uint8], row: int):
    """Row of images that ``are_runs``, eight pixels a number; rows are counted over all images."""
    width = images.shape[2]
    return wp.array(ptr=images.ptr + wp.uint64(row) * wp.uint64(width), shape=(width // 8,), dtype=wp.uint64)


@wp.func
def read_run(images: wp.array3d[wp.uint8], row: int, column: int, in_runs: bool):
    """Eight pixels of a row, those of them that are in the picture, the first one lowest."""
    run = wp.uint64(0)
    if in_runs:
        run = runs_of(images, row)[column // _RUN]
    else:
        for i in range(wp.min(_RUN, images.shape[2] - column)):
            run |= wp.uint64(row_of_pixels(images, row)[column + i]) << wp.uint64(8 * i)
    return run


@wp.func
def write_run(images: wp.array3d[wp.uint8], row: int, column: int, run: wp.uint64, in_runs: bool):
    """Write eight pixels of a row, those of them that are in the picture."""
    if in_runs:
        runs_of(images, row)[column // _RUN] = run
    else:
        for i in range(wp.min(_RUN, images.shape[2] - column)):
            row_of_pixels(images, row)[column + i] = wp.uint8(pixel_of(run, i))


@wp.func
def row_of_numbers(images: wp.array3d[float], row: int):
    """Row of contiguous images; rows are counted over all images."""
    width = images.shape[2]
    return wp.array(ptr=images.ptr + wp.uint64(4) * wp.uint64(row) * wp.uint64(width), shape=(width,), dtype=float)


@wp.func
def pixel_of(run: wp.uint64, i: int):
    """Pixel i of a run."""
    return int(run >> wp.uint64(8 * i)) & 255


@wp.func
def note_pixel(target: LabelTarget, b: int, row: int, column: int, expected: int, label: int):
    """Record where a pixel is wrong, if the gradient asks for it."""
    if target.extents.shape[0] > 0 and expected != label and expected != IGNORE:
        height, width = target.target.shape[1], target.target.shape[2]
        note_wrong(target.extents, b, label, expected, wp.vec4i(height - row, row + 1, width - column, column + 1))


@wp.func
def box_meets(s: Silhouette, left: float, right: float, top: float, bottom: float):
    """True if an outline's bounding box meets a rectangle of pixels: cheaper than ``may_meet``."""
    return s.low[0] < right and s.high[0] > left and s.low[1] < bottom and s.high[1] > top


@wp.func
def may_meet(s: Silhouette, left: float, right: float, top: float, bottom: float):
    """False if an outline surely misses a rectangle of pixels."""
    if not box_meets(s, left, right, top, bottom):
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
def draw_run(ellipsoids: wp.array[Silhouette], meets: wp.uint64, words: int, x: float, y: float):
    """Index + 1 of the nearest ellipsoid at eight pixels, plus 256 times its label, and its nearness.

    It is one of those that a thread says may meet them: bit 8 word of ``meets`` says it of the thread's ellipsoid in
    that word.
    """
    shown = _Indices()
    best = _Numbers(-wp.inf)
    for word in range(words):
        bits = ballot((meets >> wp.uint64(8 * word)) & wp.uint64(1) == wp.uint64(1))
        while bits != wp.uint32(0):
            k = LANES * word + lowest_bit(bits)
            bits &= bits - wp.uint32(1)
            s = ellipsoids[k]
            entry = k + 1 + 256 * s.label
            place = to_disc(s, x - s.mean[0], y - s.mean[1])
            first_middle = middle_at(s, x, y)
            for i in range(_RUN):
                # Selects, not branches: neighbours disagree.
                u = place[0] + float(i) * s.factor[0]
                v = place[1] + float(i) * s.factor[1]
                inside = 1.0 - u * u - v * v
                nearness = first_middle + float(i) * s.slope[0] + s.bulge * wp.sqrt(wp.max(inside, 0.0))
                nearer = inside > 0.0 and nearness > best[i]
                best[i] = wp.where(nearer, nearness, best[i])
                shown[i] = wp.where(nearer, entry, shown[i])
    return shown, best


@wp.func
def words_cost(shown: wp.uint32, expected: wp.uint32):
    """Sum of ``cost_of`` of four pixels."""
    wrong = unequal_bytes(shown, expected) & unequal_bytes(expected, IGNORED)
    dirtied = wrong & unequal_bytes(shown, wp.uint32(0)) & unequal_bytes(shown, IGNORED)
    return wp.bit_count(dirtied) + wp.bit_count(wrong & unequal_bytes(expected, wp.uint32(0)))


@wp.func
def without_pair(wrong: wp.uint32, shown: wp.uint32, expected: wp.uint32, pair: wp.uint32):
    """Wrong pixels of four but those with a pair of labels."""
    label = (pair & wp.uint32(255)) * EACH_BYTE
    wanted = (pair >> wp.uint32(8)) * EACH_BYTE
    return wrong & (unequal_bytes(shown, label) | unequal_bytes(expected, wanted))


@wp.func
def note_strip(target: LabelTarget, b: int, labels: wp.uint64, wanted: wp.uint64, left: int, top: int, lane: int):
    """Record where a strip is wrong, one pair of labels after another, the same for all threads."""
    low = wp.uint32(labels)
    high = wp.uint32(labels >> wp.uint64(32))
    low_wanted = wp.uint32(wanted)
    high_wanted = wp.uint32(wanted >> wp.uint64(32))
    low_wrong = unequal_bytes(low, low_wanted) & unequal_bytes(low_wanted, IGNORED)
    high_wrong = unequal_bytes(high, high_wanted) & unequal_bytes(high_wanted, IGNORED)
    waiting = ballot((low_wrong | high_wrong) != wp.uint32(0))
    while waiting != wp.uint32(0):
        pair = first_pair(high, high_wanted, high_wrong)
        if low_wrong != wp.uint32(0):
            pair = first_pair(low, low_wanted, low_wrong)
        pair = shuffle(pair, lowest_bit(waiting))
        low_left = without_pair(low_wrong, low, low_wanted, pair)
        high_left = without_pair(high_wrong, high, high_wanted, pair)
        runs = ballot(low_left != low_wrong or high_left != high_wrong)
        note_pair(target, b, int(pair & wp.uint32(255)), int(pair >> wp.uint32(8)), runs, left, top, lane)
        low_wrong = low_left
        high_wrong = high_left
        waiting = ballot((low_wrong | high_wrong) != wp.uint32(0))


@wp.func
def note_pair(target: LabelTarget, b: int, shown: int, expected: int, runs: wp.uint32, left: int, top: int, lane: int):
    """Record runs of a strip for two labels as ``note_wrong`` does, by a thread for each of eight numbers.

    ``runs`` has a bit for each thread whose run has such a pixel.
    """
    extents = target.extents
    height, width = target.target.shape[1], target.target.shape[2]
    side = lane % 4
    columns = runs | runs >> wp.uint32(16)
    columns |= columns >> wp.uint32(8)
    columns = (columns | columns >> wp.uint32(4)) & wp.uint32(15)
    first_row = lowest_bit(runs) // _RUNS
    last_row = highest_bit(runs) // _RUNS
    reach = wp.where(side == 0, height - top - first_row, top + last_row + 1)
    if side >= 2:
        first_column = left + _RUN * lowest_bit(columns)
        last_column = left + _RUN * highest_bit(columns) + _RUN
        reach = wp.where(side == 2, width - first_column, wp.min(last_column, width))
    label = wp.where(lane < 4, shown, expected)
    kind = wp.where(lane < 4, SURPLUS, MISSING)
    if lane < 8 and label > 0 and label < extents.shape[2]:
        numbers = wp.array(ptr=extents.ptr, shape=(4 * extents.shape[2],), dtype=int)
        wp.atomic_max(numbers, 4 * ((b * extents.shape[1] + kind) * extents.shape[2] + label) + side, reach)


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
    first_row = top + lane // _RUNS
    column = left + (lane % _RUNS) * _RUN
    x = float(column) + 0.5
    right = float(left + _STRIP_WIDTH)
    count = silhouettes.shape[1]
    words = (count + LANES - 1) // LANES
    t = target_of(target, b)
    has_labels = labels.shape[0] > 0
    has_losses = losses.shape[0] > 0
    in_runs = are_runs(parts) and (are_runs(labels) or not has_labels) and (are_runs(target.target) or not has_losses)
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
            if box_meets(own, float(left), right, float(top), float(top + tile_height)):
                for strip in range(strips):
                    first = float(top + strip * _STRIP_ROWS)
                    if may_meet(own, float(left), right, first, first + float(_STRIP_ROWS)):
                        meets |= wp.uint64(1) << wp.uint64(8 * word + strip)
    if ballot(meets != wp.uint64(0)) == wp.uint32(0) and in_runs and depth.shape[0] == 0:
        # Most tiles are background, and should be. All loads come before any store, which might be to the same place.
        wanted = _Strips()
        for strip in range(_MAX_STRIPS):
            if strip < strips and column < width and first_row + strip * _STRIP_ROWS < height:
                if has_losses:
                    wanted[strip] = read_run(target.target, t * height + first_row + strip * _STRIP_ROWS, column, True)
        some = wp.uint64(0)
        for strip in range(_MAX_STRIPS):
            some |= wanted[strip]
            if strip < strips and column < width and first_row + strip * _STRIP_ROWS < height:
                row = b * height + first_row + strip * _STRIP_ROWS
                write_run(parts, row, column, wp.uint64(0), True)
                if has_labels:
                    write_run(labels, row, column, wp.uint64(0), True)
        if ballot(some != wp.uint64(0)) == wp.uint32(0):
            if has_losses and lane == 0:
                losses[b, tile] = fault
            return
    loss = fault
    for strip in range(strips):
        row = first_row + strip * _STRIP_ROWS
        in_picture = row < height and column < width
        expected = wp.uint64(0)
        if has_losses and in_picture:
            # Read early, not to wait for it later.
            expected = read_run(target.target, t * height + row, column, in_runs)
        shown = _Indices()
        best = _Numbers()
        shown_run = wp.uint64(0)
        label_run = wp.uint64(0)
        mine = meets >> wp.uint64(strip)
        if ballot((mine & _EACH_WORD) != wp.uint64(0)) != wp.uint32(0):
            shown, best = draw_run(ellipsoids, mine, words, x, float(row) + 0.5)
            for i in range(_RUN):
                shown_run |= wp.uint64(shown[i] & 255) << wp.uint64(8 * i)
                label_run |= wp.uint64(shown[i] >> 8) << wp.uint64(8 * i)
        if in_picture:
            write_run(parts, b * height + row, column, shown_run, in_runs)
            if has_labels:
                write_run(labels, b * height + row, column, label_run, in_runs)
            if depth.shape[0] > 0:
                numbers = row_of_numbers(depth, b * height + row)
                for i in range(_RUN):
                    if column + i < width:
                        numbers[column + i] = fault + wp.where(shown[i] > 0, depth_of(best[i], perspective), wp.inf)
        if has_losses:
            if not in_picture:
                label_run = wp.uint64(0)
            elif column + _RUN > width:
                label_run &= (wp.uint64(1) << wp.uint64(8 * (width - column))) - wp.uint64(1)
            low = wp.uint32(label_run)
            high = wp.uint32(label_run >> wp.uint64(32))
            low_wanted = wp.uint32(expected)
            high_wanted = wp.uint32(expected >> wp.uint64(32))
            loss += float(words_cost(low, low_wanted) + words_cost(high, high_wanted))
            if target.extents.shape[0] > 0:
                note_strip(target, b, label_run, expected, left, top + strip * _STRIP_ROWS, lane)
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
