"""Gradient of a loss with respect to part maps: dense, or found from a target label image.

A label target takes 1/80 of the bytes of K float maps: L_seg and its gradient at a pixel follow from two labels, the
one shown and the target's.
"""

from typing import Any

import warp as wp

from .lanes import lowest_bit

wp.set_module_options({"enable_backward": False})

IGNORE = wp.constant(255)  # a target pixel that neither attracts nor repels
IGNORED = wp.constant(wp.uint32(0xFFFFFFFF))  # four such pixels
EACH_BYTE = wp.constant(wp.uint32(0x01010101))  # times a label: four pixels that show it
HIGH_BITS = wp.constant(wp.uint32(0x80808080))  # of each byte
QUAD = wp.constant(4)  # pixels a word
Block: Any = wp.types.vector(length=4, dtype=wp.uint32)  # 4 by 4 pixels, a word a row
_LOW_BITS = wp.constant(wp.uint32(0x7F7F7F7F))

# Kinds of wrong pixels of a label: the second index of ``extents``.
MISSING = wp.constant(0)  # should show the label and do not
SURPLUS = wp.constant(1)  # show it and should not
HIDDEN = wp.constant(2)  # should show it and show another part; recorded for meshes alone
NUM_EXTENTS = wp.constant(3)


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


@wp.func_native("""
    wp::vec_t<4, wp::uint32> block;
    // not unrolled: few images need this, and all kernels would keep more registers for it
#pragma unroll 1
    for (int k = 0; k < 4; ++k) {
        unsigned int word = 0;
#pragma unroll 1
        for (int i = 0; i < 4; ++i)
            if (top + k < height && left + i < width)
                word |= (unsigned int)((const unsigned char*)image)[(top + k) * width + left + i] << (8 * i);
        block[k] = word;
    }
    return block;
""")
def load_bytes(image: wp.uint64, height: int, width: int, top: int, left: int) -> Block:
    """Four rows of four pixels, as ``load_word``, byte by byte."""
    ...


@wp.func
def load_block(image: wp.array2d[wp.uint8], top: int, left: int, in_words: bool):
    """Four rows of four pixels, as ``load_word``; all four loads come at once, so that their latencies overlap."""
    height = image.shape[0]
    width = image.shape[1]
    block = Block()
    if in_words and left < width and top + QUAD <= height:
        words = words_of(image)
        first = (top * width + left) // QUAD
        for k in range(QUAD):
            block[k] = words[first + k * (width // QUAD)]
    else:
        block = load_bytes(image.ptr, image.shape[0], image.shape[1], top, left)
    return block


@wp.func
def byte_of(word: wp.uint32, i: int):
    """Byte i of a word, the first one in memory lowest."""
    return int(word >> wp.uint32(8 * i)) & 255


@wp.func
def first_pair(shown: wp.uint32, expected: wp.uint32, wrong: wp.uint32):
    """Label shown and, times 256, label wanted at the first of four pixels that is wrong."""
    shift = wp.uint32(lowest_bit(wrong) & 24)
    return (shown >> shift & wp.uint32(255)) | (expected >> shift & wp.uint32(255)) << wp.uint32(8)


@wp.func
def unequal_bytes(a: wp.uint32, b: wp.uint32):
    """Highest bit of each byte in which two words differ."""
    difference = a ^ b
    return (((difference & _LOW_BITS) + _LOW_BITS) | difference) & HIGH_BITS


@wp.func
def first_bytes(count: int):
    """Word of which the first ``count`` bytes, up to four, have all bits set."""
    return wp.where(count >= QUAD, ~wp.uint32(0), (wp.uint32(1) << wp.uint32(8 * wp.clamp(count, 0, 3))) - wp.uint32(1))


@wp.func
def map_weight(label: int):
    """Weight of a label's map in L_seg: 0 for background and for IGNORE, which have no map."""
    return wp.where(label == 0 or label == IGNORE, 0.0, 1.0)


@wp.struct
class LabelTarget:
    """L_seg (paper, eq. 6) against a label image; a wrong pixel misses one map and dirties another.

    The last member stays empty where nothing reads it.
    """

    target: wp.array3d[wp.uint8]  # (N, H, W), 255 = ignore
    extents: wp.array3d[wp.vec4i]  # (B, 3, L) where pixels are wrong, zeroed and then grown by ``note_wrong``


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
def hidden_gradient(g: LabelTarget, t: int, label: int, pixel: int):
    """dL/dA of map ``label`` at a pixel that shows another; pixels are counted row by row."""
    return wp.where(int(flat(g.target[t])[pixel]) == label, -2.0 * map_weight(label), 0.0)


@wp.func
def hidden_gradient(g: DenseGradient, t: int, label: int, pixel: int):
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
    return map_weight(label)


@wp.func
def weight_of(g: DenseGradient, b: int, label: int):
    """Factor 1: dense maps are weighted already."""
    return 1.0


@wp.func
def expected_block(g: LabelTarget, b: int, top: int, left: int):
    """Target labels of 4 by 4 pixels."""
    return load_block(g.target[b], top, left, are_words(g.target))


@wp.func
def expected_block(g: DenseGradient, b: int, top: int, left: int):
    """Label whose turn it is at all of 4 by 4 pixels."""
    word = wp.uint32(g.label) * EACH_BYTE
    return Block(word, word, word, word)


@wp.func
def hidden_pixels(shown: wp.uint32, expected: wp.uint32):
    """Highest bit of each of four pixels where a part hides the one that should be seen."""
    some = unequal_bytes(shown, wp.uint32(0)) & unequal_bytes(expected, wp.uint32(0))
    return some & unequal_bytes(shown, expected) & unequal_bytes(expected, IGNORED)


@wp.func
def target_label_at(g: LabelTarget, b: int, at: int):
    """Label that may come forward at a pixel: the target's."""
    return int(flat(g.target[b])[at])


@wp.func
def target_label_at(g: DenseGradient, b: int, at: int):
    """Label that may come forward at a pixel: the one whose turn it is, by the gradient of its map."""
    return g.label


@wp.func
def may_come_forward(g: LabelTarget, label: int):
    """True for a label that a target can ask for."""
    return label != IGNORE


@wp.func
def may_come_forward(g: DenseGradient, label: int):
    """True for the label whose turn it is."""
    return label == g.label


@wp.func
def has_extent(g: LabelTarget, label: int):
    """True if wrong pixels of a label are recorded; they are not of IGNORE, which may hide others."""
    return label < g.extents.shape[2]


@wp.func
def has_extent(g: DenseGradient, label: int):
    """True if a label has a map."""
    return label <= g.maps.shape[1]


@wp.func
def extent(g: LabelTarget, b: int, kind: int, label: int):
    """First and last row and column of a label's wrong pixels of this kind; last < first if there are none."""
    if not has_extent(g, label):
        return wp.vec4i(0, -1, 0, -1)
    reach = g.extents[b, kind, label]
    return wp.vec4i(g.target.shape[1] - reach[0], reach[1] - 1, g.target.shape[2] - reach[2], reach[3] - 1)


@wp.func
def extent(g: DenseGradient, b: int, kind: int, label: int):
    """First and last row and column of the picture, for any pixel can have a gradient."""
    if not has_extent(g, label):
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


@wp.func
def wrong_on_line(reach: wp.vec4i, axis: int, line: int, count: int):
    """First and last pixel of an extent on a row (axis 0) or column (axis 1) of ``count``; none: the last is -1."""
    rows = wp.vec2i(reach[0], reach[1])
    columns = wp.vec2i(reach[2], reach[3])
    lines = wp.where(axis == 0, rows, columns)
    if line < lines[0] or line > lines[1]:
        return wp.vec2i(count, -1)
    return wp.where(axis == 0, columns, rows)


@wp.func
def note_wrong(extents: wp.array3d[wp.vec4i], b: int, shown: int, target: int, reach: wp.vec4i):
    """Record a block with pixels that show one label and should show the other."""
    if shown != 0:
        grow(extents, b, SURPLUS, shown, reach)
    if target != 0:
        grow(extents, b, MISSING, target, reach)


@wp.func
def grow(extents: wp.array3d[wp.vec4i], b: int, kind: int, label: int, reach: wp.vec4i):
    """Extend a label's extent to a block; all four numbers count from a border of the picture, so that 0 is empty."""
    if label >= extents.shape[2]:
        return
    have = extents[b, kind, label]
    # Extents only grow, so a stale value is safe; hardly any block needs the atomic.
    if reach[0] > have[0] or reach[1] > have[1] or reach[2] > have[2] or reach[3] > have[3]:
        wp.atomic_max(extents, b, kind, label, reach)
