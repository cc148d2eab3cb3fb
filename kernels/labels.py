"""Gradient of a loss with respect to part maps: dense, or found from a target label image.

A label target takes 1/80 of the bytes of K float maps: L_seg and its gradient at a pixel follow from two labels, the
one shown and the target's.
"""

from typing import Any

import warp as wp

wp.set_module_options({"enable_backward": False})

IGNORE = wp.constant(255)  # a target pixel that neither attracts nor repels
EACH_BYTE = wp.constant(wp.uint32(0x01010101))  # times a label: four pixels that show it
HIGH_BITS = wp.constant(wp.uint32(0x80808080))  # of each byte
QUAD = wp.constant(4)  # pixels a word
_LOW_BITS = wp.constant(wp.uint32(0x7F7F7F7F))

# Kinds of wrong pixels of a label: the second index of ``extents``.
MISSING = wp.constant(0)  # should show the label and do not
SURPLUS = wp.constant(1)  # show it and should not
HIDDEN = wp.constant(2)  # should show it and show another part
NUM_EXTENTS = 3


@wp.func
def flat(image: wp.array2d[Any]):
    """Pixels of a contiguous image row by row.

    With strides known to the compiler, reading one takes a fraction of the instructions, and these kernels are bound by
    instructions.
    """
    return wp.array(ptr=image.ptr, shape=(image.shape[0] * image.shape[1],), dtype=image.dtype)


@wp.func
def words_of(image: wp.array2d[wp.uint8]):
    """Four pixels a word, row by row, where ``are_words``."""
    return wp.array(ptr=image.ptr, shape=(image.shape[0] * image.shape[1] // 4,), dtype=wp.uint32)


@wp.func
def are_words(images: wp.array3d[wp.uint8]):
    """True if contiguous images can be read four pixels at once."""
    return images.shape[2] % 4 == 0 and images.ptr % wp.uint64(4) == wp.uint64(0)


@wp.func
def load_word(image: wp.array2d[wp.uint8], row: int, column: int, in_words: bool):
    """Four pixels of a row in one number, the first one lowest; 0 outside the image."""
    width = image.shape[1]
    word = wp.uint32(0)
    if row < image.shape[0] and column < width:
        begin = row * width + column
        if in_words:
            word = words_of(image)[begin // QUAD]
        else:
            for i in range(QUAD):
                if column + i < width:
                    word |= wp.uint32(flat(image)[begin + i]) << wp.uint32(8 * i)
    return word


@wp.func
def unequal_bytes(a: wp.uint32, b: wp.uint32):
    """Highest bit of each byte in which two words differ."""
    difference = a ^ b
    return (((difference & _LOW_BITS) + _LOW_BITS) | difference) & HIGH_BITS


@wp.func
def map_weight(label: int):
    """Weight of a label's map in L_seg: 0 for background and for IGNORE, which have no map."""
    return wp.where(label == 0 or label == IGNORE, 0.0, 1.0)


@wp.struct
class LabelTarget:
    """L_seg (paper, eq. 6) against a label image; a wrong pixel misses one map and dirties another.

    The last three members are read by one renderer each, and stay empty for the other.
    """

    target: wp.array3d[wp.uint8]  # (N, H, W), 255 = ignore
    reach: wp.array4d[wp.vec2i]  # ellipsoids: (N, 2, L, max(H, W)) from ``find_reach``
    scale: wp.array[float]  # mesh: (B,) gradient of the loss itself
    extents: wp.array3d[wp.vec4i]  # mesh: (B, 3, L) where pixels are wrong, from ``launch_compare_labels``


@wp.struct
class DenseGradient:
    """Any gradient with respect to the part maps."""

    maps: wp.array4d[float]  # (B, K, H, W)
    label: int  # mesh: the z pass looks for one map's part at a time


def overload_gradients(*kernels: wp.Kernel) -> None:
    """Register both types of ``gradient`` up front: an overload that appears later would compile the module again."""
    for kernel in kernels:
        for gradient in (LabelTarget, DenseGradient):
            wp.overload(kernel, {"gradient": gradient})


@wp.func
def target_of(g: LabelTarget, b: int):
    """Index of body b's target among N: b % N."""
    return b % wp.max(g.target.shape[0], 1)


@wp.func
def target_of(g: DenseGradient, b: int):
    """Index of body b's maps: its own."""
    return b


@wp.func
def gradient_at(g: LabelTarget, t: int, label: int, pixel: int, shown: int):
    """dL/dA of map ``label`` at a pixel that shows ``shown``; pixels are counted row by row."""
    expected = int(flat(g.target[t])[pixel])
    if expected == IGNORE or expected == shown:
        return 0.0
    value = 0.0
    if shown == label:
        value = 2.0
    elif expected == label:
        value = -2.0
    return value * map_weight(label)


@wp.func
def gradient_at(g: DenseGradient, t: int, label: int, pixel: int, shown: int):
    """dL/dA of map ``label`` at a pixel; labels past the last map have none."""
    if label > g.maps.shape[1]:
        return 0.0
    return flat(g.maps[t, label - 1])[pixel]


@wp.func
def may_have_gradient(g: LabelTarget, t: int, label: int, pixel: int):
    """True if a pixel that does not show a label may have a gradient of its map: cheaper than the gradient."""
    return int(flat(g.target[t])[pixel]) == label


@wp.func
def may_have_gradient(g: DenseGradient, t: int, label: int, pixel: int):
    """True for any pixel."""
    return True


@wp.func
def cost_of(g: LabelTarget, expected: int, label: int):
    """Cost of one pixel of area that shows ``label`` where the target shows ``expected``; 0 = background."""
    if expected == IGNORE or expected == label:
        return 0.0
    return map_weight(label) + map_weight(expected)


@wp.func
def excess_at(g: LabelTarget, t: int, inside: int, outside: int, pixel: int):
    """Cost of a pixel of area that shows ``inside``, less its cost if it shows ``outside``."""
    expected = int(flat(g.target[t])[pixel])
    return cost_of(g, expected, inside) - cost_of(g, expected, outside)


@wp.func
def excess_at(g: DenseGradient, t: int, inside: int, outside: int, pixel: int):
    """Cost to first order, from the gradient of the maps."""
    excess = float(0.0)
    if inside > 0 and inside <= g.maps.shape[1]:
        excess = flat(g.maps[t, inside - 1])[pixel]
    if outside > 0 and outside <= g.maps.shape[1]:
        excess -= flat(g.maps[t, outside - 1])[pixel]
    return excess


@wp.func
def pull_range(g: LabelTarget, t: int, axis: int, label: int, line: int, count: int):
    """First and last pixel of a scan line that can pull this label's edges out: those whose target it is."""
    if label >= g.reach.shape[2]:
        return wp.vec2i(count, -1)  # no pixel's target
    return g.reach[t, axis, label, line]


@wp.func
def pull_range(g: DenseGradient, t: int, axis: int, label: int, line: int, count: int):
    """All pixels of the scan line."""
    return wp.vec2i(0, count - 1)


@wp.func
def pixels_of(g: LabelTarget, b: int, label: int):
    """Pixels that ``pixel_gradient`` reads for a label: the target's."""
    return flat(g.target[b])


@wp.func
def pixels_of(g: DenseGradient, b: int, label: int):
    """Pixels that ``pixel_gradient`` reads for a label: its map's."""
    return flat(g.maps[b, label - 1])


@wp.func
def pixel_gradient(target: wp.array[wp.uint8], at: int, label: int, shows_it: bool):
    """dL/dA of map ``label`` at a pixel that shows this label or another, but for the factor ``weight_of``."""
    expected = int(target[at])
    if shows_it:
        return wp.where(expected == label or expected == IGNORE, 0.0, 2.0)
    return wp.where(expected == label, -2.0, 0.0)


@wp.func
def pixel_gradient(map: wp.array[float], at: int, label: int, shows_it: bool):
    """dL/dA of map ``label`` at a pixel."""
    return map[at]


@wp.func
def weight_of(g: LabelTarget, b: int, label: int):
    """Factor of ``pixel_gradient`` for a label."""
    return map_weight(label) * g.scale[b]


@wp.func
def weight_of(g: DenseGradient, b: int, label: int):
    """Factor 1: dense maps are weighted already."""
    return 1.0


@wp.func
def target_label_at(g: LabelTarget, b: int, at: int):
    """Label that may come forward at a pixel: the target's."""
    return int(flat(g.target[b])[at])


@wp.func
def target_label_at(g: DenseGradient, b: int, at: int):
    """Label that may come forward at a pixel: the one whose turn it is, by the gradient of its map."""
    return g.label


@wp.func
def extent(g: LabelTarget, b: int, kind: int, label: int):
    """First and last row and column of a label's wrong pixels of this kind; last < first if there are none."""
    if label >= g.extents.shape[2]:
        return wp.vec4i(0, -1, 0, -1)
    reach = g.extents[b, kind, label]
    return wp.vec4i(g.target.shape[1] - reach[0], reach[1] - 1, g.target.shape[2] - reach[2], reach[3] - 1)


@wp.func
def extent(g: DenseGradient, b: int, kind: int, label: int):
    """First and last row and column of the picture, for any pixel can have a gradient."""
    if label > g.maps.shape[1]:
        return wp.vec4i(0, -1, 0, -1)
    return wp.vec4i(0, g.maps.shape[2] - 1, 0, g.maps.shape[3] - 1)


@wp.func
def all_wrong(gradient: Any, b: int, label: int):
    """Union of the ``extent`` of pixels that miss a label and of those that show it wrongly."""
    missing = extent(gradient, b, MISSING, label)
    surplus = extent(gradient, b, SURPLUS, label)
    return wp.vec4i(
        wp.min(missing[0], surplus[0]),
        wp.max(missing[1], surplus[1]),
        wp.min(missing[2], surplus[2]),
        wp.max(missing[3], surplus[3]),
    )


@wp.kernel
def find_reach(
    target: wp.array3d[wp.uint8],  # (B, H, W)
    chunks: int,  # threads that share a line
    reach: wp.array4d[int],  # (B, 2, L, 2 max(H, W)) first and last pixel by turns; with several chunks empty  OUTPUT
):
    """Find the first and last pixel of each label in the target's rows (axis 0) and columns (axis 1).

    Run by run: most pixels show what the one before them shows, and of a row four are one word.
    """
    thread = wp.tid()
    lines = reach.shape[3] // 2
    image = thread // (lines * chunks)
    place = thread - image * (lines * chunks)
    b = image // 2
    axis = image - 2 * b
    # Neighbours in a warp read neighbouring pixels: of a row its chunks, of columns the same chunk of the next one.
    line = wp.where(axis == 0, place // chunks, place % lines)
    chunk = wp.where(axis == 0, place % chunks, place // lines)
    if line >= target.shape[1 + axis]:
        return
    count = target.shape[2 - axis]
    if chunks == 1:
        for label in range(reach.shape[2]):
            reach[b, axis, label, 2 * line] = count
            reach[b, axis, label, 2 * line + 1] = -1
    size = (count + chunks - 1) // chunks
    pixel = int(chunk * size)
    end = wp.min(pixel + size, count)
    in_words = axis == 0 and are_words(target)
    run = int(-1)
    first = int(0)
    while pixel < end:
        skip = in_words and run >= 0 and pixel % QUAD == 0 and pixel + QUAD <= end
        if skip:
            skip = load_word(target[b], line, pixel, True) == wp.uint32(run) * EACH_BYTE
        if skip:
            pixel += QUAD
        else:
            label = int(target[b, wp.where(axis == 0, line, pixel), wp.where(axis == 0, pixel, line)])
            if label != run:
                extend_reach(reach, wp.vec4i(b, axis, run, line), first, pixel - 1)
                run = label
                first = pixel
            pixel += 1
    extend_reach(reach, wp.vec4i(b, axis, run, line), first, end - 1)


@wp.func
def extend_reach(reach: wp.array4d[int], at: wp.vec4i, first: int, last: int):
    """Extend a label's reach in a line by a run; ``at`` is the body, the axis, the label and the line."""
    if at[2] >= 0 and at[2] < reach.shape[2]:
        wp.atomic_min(reach, at[0], at[1], at[2], 2 * at[3], first)
        wp.atomic_max(reach, at[0], at[1], at[2], 2 * at[3] + 1, last)


@wp.kernel
def empty_reach(
    height: int,
    width: int,
    reach: wp.array4d[wp.vec2i],  # (B, 2, L, max(H, W))  OUTPUT
):
    """Set no pixel at all, the first one after the last."""
    thread = wp.tid()
    lines, labels = reach.shape[3], reach.shape[2]
    line = thread % lines
    rest = thread // lines
    label = rest % labels
    image = rest // labels
    reach[image // 2, image % 2, label, line] = wp.vec2i(wp.where(image % 2 == 0, width, height), -1)


_CHUNK = 16  # pixels of a line a thread on CUDA, or more
_THREADS = 2**18  # that fill a GPU; more chunks only add work


def launch_find_reach(target: wp.array, reach: wp.array) -> None:
    """Fill ``reach``, of shape (B, 2, L, max(H, W)) for labels 0 to L - 1."""
    batch, height, width = target.shape
    device = target.device
    lines = max(height, width)
    chunks = 1 if device.is_cpu else max(min(-(-lines // _CHUNK), _THREADS // max(2 * batch * lines, 1)), 1)
    if chunks > 1:
        wp.launch(empty_reach, reach.size, [height, width], [reach], device=device)
    numbers = wp.array(ptr=reach.ptr, dtype=int, shape=(*reach.shape[:3], 2 * lines), device=device)
    wp.launch(find_reach, batch * 2 * lines * chunks, [target, chunks], [numbers], device=device)
