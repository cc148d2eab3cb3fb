"""Which ellipsoid each pixel shows, how deep, and what that costs: one algorithm for CUDA, one for the CPU device.

Both decide with the same functions: an ellipsoid covers a pixel where ``room_at`` its centre is positive, the nearest
shows, and of equal ones that with the lower index.
"""

import warp as wp

from .ellipsoids import Silhouette, lowest_bit, middle_at, room_at
from .surface_forces import rests
from .targets import LabelTarget, cost_at, flat, target_of

wp.set_module_options({"enable_backward": False, "fast_math": True})

# On CUDA a block draws a tile of the picture. Its threads side by side draw four neighbouring pixels of a row each, in
# as many passes of eight rows as it takes: few long threads cost least, but few bodies need many.
_TILE_WIDTH = wp.constant(32)
_PASS_ROWS = wp.constant(8)
_QUAD = wp.constant(4)
_QUADS = wp.constant(8)  # a row of a tile
_BLOCK = wp.constant(64)
_LONG_PASSES = 4
_MANY_PIXELS = 2**21  # in a batch: enough to fill the device with long threads
_Sets = wp.types.vector(length=8, dtype=wp.uint32)  # a bit for each of 255 ellipsoids


@wp.func
def depth_of(nearness: float, perspective: bool):
    """Depth [m] of a nearness."""
    return wp.where(perspective, 1.0 / nearness, -nearness)


@wp.func
def pack(values: wp.vec4i):
    """Four bytes as one word, in the order of memory."""
    return (
        wp.uint32(values[0])
        | (wp.uint32(values[1]) << wp.uint32(8))
        | (wp.uint32(values[2]) << wp.uint32(16))
        | (wp.uint32(values[3]) << wp.uint32(24))
    )


@wp.func
def write_bytes(image: wp.array3d[wp.uint8], b: int, row: int, column: int, values: wp.vec4i):
    """Write up to four pixels of a row."""
    for i in range(_QUAD):
        if column + i < image.shape[2]:
            image[b, row, column + i] = wp.uint8(values[i])


@wp.kernel(launch_bounds=(64, 16))  # 64 registers: 30 % faster with 1024 bodies, no slower with one
def draw_tiles(
    silhouettes: wp.array2d[Silhouette],  # (B, P)
    perspective: bool,
    target: LabelTarget,
    active: wp.array[int],  # (B,) 0: the body's picture stays as it is; empty: all are drawn
    passes: int,
    in_words: bool,  # whether the pictures below are read and written four pixels at once
    target_words: wp.array3d[wp.uint32],  # (B or 1, H, W / 4) ``target.target``, if in words
    parts: wp.array3d[wp.uint8],  # (B, H, W) index + 1 of the ellipsoid shown, 0 = background  OUTPUT
    parts_words: wp.array3d[wp.uint32],  # (B, H, W / 4) the same memory
    labels: wp.array3d[wp.uint8],  # (B, H, W) or empty  OUTPUT
    labels_words: wp.array3d[wp.uint32],
    depth: wp.array3d[float],  # (B, H, W) [m], inf = background, or empty  OUTPUT
    losses: wp.array2d[float],  # (B, T) L_seg of each tile, or empty  OUTPUT
):
    """CUDA: a block looks only at the ellipsoids whose boxes meet its tile."""
    # One dimension, split in 32 bits: Warp's own split takes 64-bit divisions for every dimension.
    thread = wp.tid()
    lane = thread % _BLOCK
    height = parts.shape[1]
    width = parts.shape[2]
    tile_height = passes * _PASS_ROWS
    tiles = (width + _TILE_WIDTH - 1) // _TILE_WIDTH
    in_picture = tiles * ((height + tile_height - 1) // tile_height)
    b = (thread // _BLOCK) // in_picture
    tile = (thread // _BLOCK) - b * in_picture
    if rests(active, b):
        return
    ellipsoids = silhouettes[b]
    left = (tile % tiles) * _TILE_WIDTH
    top = (tile // tiles) * tile_height
    column = left + (lane % _QUADS) * _QUAD
    x = float(column) + 0.5
    count = silhouettes.shape[1]
    t = target_of(target, b)
    loss = float(0.0)
    words = (count + 31) // 32
    sets = _Sets()
    for word in range(words):
        hit = wp.uint32(0)
        k = 32 * word + lane
        if lane < 32 and k < count:
            low = ellipsoids[k].low
            high = ellipsoids[k].high
            if (
                low[0] < float(left + _TILE_WIDTH)
                and high[0] > float(left)
                and low[1] < float(top + tile_height)
                and high[1] > float(top)
            ):
                hit = wp.uint32(1) << wp.uint32(lane)
        hits = wp.tile_sum(wp.tile(hit))
        sets[word] = hits[0]
    row = top + lane // _QUADS
    while row < wp.min(top + tile_height, height) and column < width:
        y = float(row) + 0.5
        best = wp.vec4(-wp.inf, -wp.inf, -wp.inf, -wp.inf)
        shown = wp.vec4i(0, 0, 0, 0)
        label = wp.vec4i(0, 0, 0, 0)
        for word in range(words):
            bits = sets[word]
            while bits != wp.uint32(0):
                k = 32 * word + lowest_bit(bits)
                bits &= bits - wp.uint32(1)
                s = ellipsoids[k]
                for i in range(_QUAD):
                    room = room_at(s, x + float(i), y)
                    if room > 0.0:
                        nearness = middle_at(s, x + float(i), y) + wp.sqrt(room)
                        if nearness > best[i]:
                            best[i] = nearness
                            shown[i] = k + 1
                            label[i] = s.label
        at = (row * width + column) // _QUAD
        if in_words:
            flat(parts_words[b])[at] = pack(shown)
            if labels.shape[0] > 0:
                flat(labels_words[b])[at] = pack(label)
        else:
            write_bytes(parts, b, row, column, shown)
            if labels.shape[0] > 0:
                write_bytes(labels, b, row, column, label)
        if depth.shape[0] > 0:
            for i in range(_QUAD):
                if column + i < width:
                    depth[b, row, column + i] = wp.where(shown[i] > 0, depth_of(best[i], perspective), wp.inf)
        if losses.shape[0] > 0:
            wrong = bool(True)
            if in_words:
                wrong = flat(target_words[t])[at] != pack(label)
            if wrong:
                for i in range(_QUAD):
                    if column + i < width:
                        loss += cost_at(target, t, label[i], row, column + i)
        row += _PASS_ROWS
    if losses.shape[0] > 0:
        total = wp.tile_sum(wp.tile(loss))
        if lane == 0:
            losses[b, tile] = total[0]


@wp.kernel
def draw_rows(
    silhouettes: wp.array2d[Silhouette],
    perspective: bool,
    target: LabelTarget,
    active: wp.array[int],
    nearest: wp.array3d[float],  # (B, H, W) scratch
    in_words: bool,
    target_words: wp.array3d[wp.uint32],
    parts: wp.array3d[wp.uint8],
    parts_words: wp.array3d[wp.uint32],
    labels: wp.array3d[wp.uint8],
    depth: wp.array3d[float],
    losses: wp.array2d[float],  # (B, H)
):
    """CPU: a row meets each outline in one closed-form interval, and visits no other pixel."""
    b, row = wp.tid()
    if rests(active, b):
        return
    width = parts.shape[2]
    begin = row * width
    image = flat(parts[b])
    fronts = flat(nearest[b])
    ellipsoids = silhouettes[b]
    y = float(row) + 0.5
    if in_words:
        words = flat(parts_words[b])
        for at in range(begin // _QUAD, (begin + width) // _QUAD):
            words[at] = wp.uint32(0)
    else:
        for at in range(begin, begin + width):
            image[at] = wp.uint8(0)
    first = int(width)
    last = int(-1)
    for k in range(ellipsoids.shape[0]):
        if y > ellipsoids[k].low[1] and y < ellipsoids[k].high[1]:
            s = ellipsoids[k]
            dy = y - s.mean[1]
            half_b = s.conic[1] * dy
            root = half_b * half_b + s.conic[0] * (s.room - s.conic[2] * dy * dy)
            if root > 0.0:
                middle = s.mean[0] - half_b / s.conic[0]
                reach = wp.sqrt(root) / s.conic[0]
                # One pixel more on either side: ``room_at`` has the last word.
                left = int(wp.clamp(middle - reach - 1.0, 0.0, float(width)))
                right = int(wp.clamp(middle + reach + 1.0, -1.0, float(width - 1)))
                # The nearness of background is set where an ellipsoid may be, and nowhere else.
                if last < first:
                    for column in range(left, right + 1):
                        fronts[begin + column] = -wp.inf
                    first = left
                    last = right
                else:
                    for column in range(left, first):
                        fronts[begin + column] = -wp.inf
                    for column in range(last + 1, right + 1):
                        fronts[begin + column] = -wp.inf
                    first = wp.min(first, left)
                    last = wp.max(last, right)
                for column in range(left, right + 1):
                    x = float(column) + 0.5
                    room = room_at(s, x, y)
                    if room > 0.0:
                        nearness = middle_at(s, x, y) + wp.sqrt(room)
                        if nearness > fronts[begin + column]:
                            fronts[begin + column] = nearness
                            image[begin + column] = wp.uint8(k + 1)
    whole_picture = labels.shape[0] > 0 or depth.shape[0] > 0
    if whole_picture or losses.shape[0] > 0:
        loss = float(0.0)
        t = target_of(target, b)
        together = wp.where(in_words, _QUAD, 1)
        column = int(0)
        while column < width:
            wrong_or_shown = bool(True)
            if in_words and not whole_picture:
                # Four pixels that show background and should.
                at = (begin + column) // _QUAD
                wrong_or_shown = (flat(parts_words[b])[at] | flat(target_words[t])[at]) != wp.uint32(0)
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
                        depth[b, row, column + i] = wp.inf
                        if part > 0:
                            depth[b, row, column + i] = depth_of(fronts[at], perspective)
                    if losses.shape[0] > 0:
                        loss += cost_at(target, t, label, row, column + i)
            column += together
        if losses.shape[0] > 0:
            losses[b, row] = loss


def num_partial_losses(device: wp.Device, batch: int, height: int, width: int) -> int:
    """T, how many sums of each picture's loss ``launch_draw`` fills."""
    if device.is_cpu:
        return height
    return -(-height // (_PASS_ROWS * _passes(batch, height, width))) * -(-width // _TILE_WIDTH)


def _passes(batch: int, height: int, width: int) -> int:
    return _LONG_PASSES if batch * height * width >= _MANY_PIXELS else 1


def launch_draw(
    silhouettes: wp.array,
    *,
    perspective: bool,
    target: LabelTarget,
    nearest: wp.array,
    parts: wp.array,
    labels: wp.array,
    depth: wp.array,
    losses: wp.array,
    active: wp.array | None = None,
) -> None:
    """Fill ``parts``, and of ``labels``, ``depth`` and ``losses`` those that are not empty.

    ``nearest`` is the CPU's scratch of the picture's size; ``target`` is read for ``losses`` only. Bodies whose flag in
    ``active`` is 0 stay as they are.
    """
    device = silhouettes.device
    batch, height, width = parts.shape
    moving = wp.empty(0, dtype=int, device=device) if active is None else active
    bytes_ = [target.target if losses.size else parts, parts, labels if labels.size else parts]
    in_words = width % _QUAD == 0 and all(image.ptr % 4 == 0 for image in bytes_)
    words = [_words(image) if in_words else wp.empty((0, 0, 0), dtype=wp.uint32, device=device) for image in bytes_]
    if device.is_cpu:
        inputs = [silhouettes, perspective, target, moving, nearest, in_words, words[0]]
        outputs = [parts, words[1], labels, depth, losses]
        wp.launch(draw_rows, (batch, height), inputs, outputs, device=device)
        return
    passes = _passes(batch, height, width)
    inputs = [silhouettes, perspective, target, moving, passes, in_words, words[0]]
    outputs = [parts, words[1], labels, words[2], depth, losses]
    dim = batch * num_partial_losses(device, batch, height, width) * _BLOCK
    wp.launch(draw_tiles, dim, inputs, outputs, device=device, block_dim=_BLOCK)


def _words(image: wp.array) -> wp.array:
    """The same memory, four pixels a word."""
    *rest, width = image.shape
    return wp.array(ptr=image.ptr, shape=(*rest, width // _QUAD), dtype=wp.uint32, device=image.device)
