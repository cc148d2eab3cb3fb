"""Pixels of people's masks that are theirs: those along their bones, and all that hangs together with them.

For many people of many pictures the same, to the bit, as ``inputs.person``, ``inputs.agreement`` and
``inputs.ignored_labels`` say of one person's labels. Only an area about each person is looked at; areas, and their
rows, lie one after another in memory, of whatever sizes, and a thread has a row.
"""

from collections.abc import Sequence
from typing import Any

import warp as wp

# NumPy doesn't fuse multiplications and additions either.
wp.set_module_options({"enable_backward": False, "fuse_fp": False})

NOBODYS = wp.constant(wp.uint8(0))
OWN = wp.constant(wp.uint8(1))
OTHERS = wp.constant(wp.uint8(255))
NEAR = wp.constant(wp.uint8(1))  # a mark: may be kept
SEED = wp.constant(wp.uint8(2))  # is kept, with all that hangs together with it
NUM_COUNTS = 8  # first and last row, first and last column; then pixels: looked at, within flesh, far and farther

# Start (x, y), way to the end and its square; then squared distance that is near, and distance that is a seed.
Bone: Any = wp.types.vector(length=7, dtype=wp.float32)
Flesh: Any = wp.types.vector(length=6, dtype=wp.float64)  # the same, then the radius as a share of the height


@wp.struct
class PeopleArrays:
    """N people, and the pictures that show them, one after another."""

    owners: wp.array[int]  # (Q,) whom each pixel of the pictures shows; 0: nobody
    pictures: wp.array2d[int]  # (N, 4) first pixel of the picture, its height and width, and the person's number there
    windows: wp.array2d[int]  # (N, 2) height and width of the part of the picture that is looked at, made smaller
    boxes: wp.array2d[wp.float64]  # (N, 4) the window's top and left in the picture, height and width of its pixels
    areas: wp.array2d[int]  # (N, 4) of the window: top, left, height and width
    first_rows: wp.array[int]  # (N + 1,) number of rows of areas before each, and in all
    first_pixels: wp.array[int]  # (N,) the same of pixels


@wp.struct
class BodyArrays:
    """Bodies of N people as their keypoints tell them, in pixels of the windows."""

    bones: wp.array2d[Bone]  # (N, S)
    num_bones: wp.array[int]  # (N,) that are there
    flesh: wp.array2d[Flesh]  # (N, F)
    num_flesh: wp.array[int]  # (N,) that are there; 0: not known of all parts
    heights: wp.array[wp.float64]  # (N,)
    strides: wp.array[int]  # (N,) every so many-th row and column is counted


@wp.struct
class PixelArrays:
    """Pixels of the areas."""

    groups: wp.array[wp.uint8]  # (R,) ``OWN``, ``NOBODYS`` or ``OTHERS``
    marks: wp.array[wp.uint8]  # (R,) ``NEAR``, ``SEED`` or 0
    parents: wp.array[int]  # (R,) of marked ones: a pixel that hangs together with this one, or itself
    reached: wp.array[wp.uint8]  # (R,) 1 at pixels without another parent that hang together with a seed


@wp.struct
class Row:
    """A row of an area."""

    person: int
    index: int  # in the area
    begin: int  # first pixel
    width: int


@wp.func
def row_of(people: PeopleArrays, index: int) -> Row:
    found = Row()
    n = wp.lower_bound(people.first_rows, index + 1) - 1
    found.person = n
    found.index = index - people.first_rows[n]
    found.width = people.areas[n, 3]
    found.begin = people.first_pixels[n] + found.index * found.width
    return found


@wp.func
def group_at(people: PeopleArrays, n: int, row: int, column: int) -> wp.uint8:
    """Group of a pixel of a picture, as the mask tells it."""
    if row < 0 or row >= people.pictures[n, 1] or column < 0 or column >= people.pictures[n, 2]:
        return OTHERS
    owner = people.owners[people.pictures[n, 0] + row * people.pictures[n, 2] + column]
    if owner == 0:
        return NOBODYS
    return wp.where(owner == people.pictures[n, 3], OWN, OTHERS)


@wp.func
def floor_index(place: wp.float64) -> int:
    """The whole number at or below; a call of ``floor`` takes longer."""
    index = int(place)
    return index - wp.where(place < wp.float64(index), 1, 0)


@wp.func
def picture_index(people: PeopleArrays, n: int, axis: int, index: int) -> int:
    """Row (axis 0) or column of the picture in the middle of one of the window."""
    return floor_index(people.boxes[n, axis] + (wp.float64(index) + wp.float64(0.5)) * people.boxes[n, axis + 2])


@wp.func
def squared_distance(u: Any, v: Any, along_x: Any, along_y: Any, squared_length: Any):
    """Squared distance of a place from a segment; (u, v) is the way from the segment's start to the place."""
    zero = type(u)(0.0)
    share = wp.min(wp.max((u * along_x + v * along_y) / squared_length, zero), type(u)(1.0))
    x, y = u - share * along_x, v - share * along_y
    return x * x + y * y


@wp.func
def mark_of(bodies: BodyArrays, n: int, row: int, column: int) -> wp.uint8:
    """Mark of a pixel by its distance from the bones."""
    mark = wp.uint8(0)
    x, y = float(column) + 0.5, float(row) + 0.5
    for s in range(bodies.num_bones[n]):
        bone = bodies.bones[n, s]
        squared = squared_distance(x - bone[0], y - bone[1], bone[2], bone[3], bone[4])
        if squared <= bone[5]:
            mark = NEAR
            if wp.sqrt(squared) <= bone[6]:
                return SEED
    return mark


@wp.func
def beyond_flesh(bodies: BodyArrays, n: int, row: int, column: int) -> wp.float64:
    """Distance of a pixel from the flesh about the bones, as a share of the height; at most 0 within."""
    x, y = wp.float64(column) + wp.float64(0.5), wp.float64(row) + wp.float64(0.5)
    nearest = wp.float64(wp.inf)
    for s in range(bodies.num_flesh[n]):
        if nearest > wp.float64(0.0):
            flesh = bodies.flesh[n, s]
            squared = squared_distance(x - flesh[0], y - flesh[1], flesh[2], flesh[3], flesh[4])
            nearest = wp.min(nearest, wp.sqrt(squared) / bodies.heights[n] - flesh[5])
    return nearest


@wp.func
def set_mark(pixels: PixelArrays, row: Row, column: int, mark: wp.uint8, start: int) -> int:
    """Mark a pixel; gives the first of the marked ones on end that it belongs to, or -1, as ``start`` of the last."""
    i = row.begin + column
    pixels.marks[i] = mark
    pixels.reached[i] = wp.uint8(0)
    if mark == wp.uint8(0):
        return -1
    first = wp.where(start < 0, i, start)
    pixels.parents[i] = first
    return first


@wp.kernel
def mark_near(people: PeopleArrays, bodies: BodyArrays, first: int, pixels: PixelArrays):
    """Fill groups, all of the mask still ignored, and marks of the person's pixels by their distance from the bones."""
    row = row_of(people, first + wp.tid())
    n = row.person
    window_row = people.areas[n, 0] + row.index
    picture_row = picture_index(people, n, 0, window_row)
    # Copies: whatever stands in an array would be read again for each pixel.
    half, left, step = wp.float64(0.5), wp.float64(people.boxes[n, 1]), wp.float64(people.boxes[n, 3])
    area_left, number, width = int(people.areas[n, 1]), int(people.pictures[n, 3]), int(people.pictures[n, 2])
    begin = people.pictures[n, 0] + picture_row * width
    if picture_row < 0 or picture_row >= people.pictures[n, 1]:
        width = 0
    start = int(-1)
    for column in range(row.width):
        picture_column = floor_index(left + (wp.float64(area_left + column) + half) * step)
        group, mark = OTHERS, wp.uint8(0)
        if picture_column >= 0 and picture_column < width:
            owner = people.owners[begin + picture_column]
            if owner == 0:
                group = NOBODYS
            elif owner == number:
                mark = mark_of(bodies, n, window_row, area_left + column)
        pixels.groups[row.begin + column] = group
        start = set_mark(pixels, row, column, mark, start)


@wp.kernel
def mark_stray(
    people: PeopleArrays,
    bodies: BodyArrays,
    far: wp.float64,
    chosen: wp.array[wp.uint8],
    first: int,
    pixels: PixelArrays,
):
    """Mark pixels of chosen people that lie beyond the flesh; those ``far`` are seeds."""
    row = row_of(people, first + wp.tid())
    n = row.person
    start = int(-1)
    for column in range(row.width):
        mark = wp.uint8(0)
        if chosen[n] != wp.uint8(0) and pixels.groups[row.begin + column] == OWN:
            distance = beyond_flesh(bodies, n, people.areas[n, 0] + row.index, people.areas[n, 1] + column)
            if distance > wp.float64(0.0):
                mark = wp.where(distance > far, SEED, NEAR)
        start = set_mark(pixels, row, column, mark, start)


@wp.func
def root_of(parents: wp.array[int], index: int) -> int:
    while parents[index] != index:
        index = parents[index]
    return index


@wp.func
def join(parents: wp.array[int], one: int, other: int):
    """Let two pixels have one root, the lower; also while other threads join others."""
    a, b = root_of(parents, one), root_of(parents, other)
    while a != b:
        low, high = wp.min(a, b), wp.max(a, b)
        before = wp.atomic_min(parents, high, low)
        if before == high:
            return
        a, b = root_of(parents, before), root_of(parents, low)


@wp.kernel
def join_rows(people: PeopleArrays, first: int, pixels: PixelArrays):
    """Join marked pixels that touch those of the row above (8 neighbours); within a row they are joined."""
    row = row_of(people, first + wp.tid())
    if row.index == 0:
        return
    left = bool(False)  # whether the pixel on the left is marked
    for column in range(row.width):
        i = row.begin + column
        here = pixels.marks[i] != wp.uint8(0)
        if here:
            above = i - row.width
            before = column > 0 and pixels.marks[above - 1] != wp.uint8(0)
            # The pixel on the left has joined what touches both.
            if pixels.marks[above] != wp.uint8(0):
                if not (left and before):
                    join(pixels.parents, above, i)
            else:
                if before and not left:
                    join(pixels.parents, above - 1, i)
                if column + 1 < row.width and pixels.marks[above + 1] != wp.uint8(0):
                    join(pixels.parents, above + 1, i)
        left = here


@wp.kernel
def reach_seeds(people: PeopleArrays, first: int, pixels: PixelArrays):
    """Tell roots that a seed hangs together with them."""
    row = row_of(people, first + wp.tid())
    told = bool(False)  # of the marked ones on end
    for i in range(row.begin, row.begin + row.width):
        mark = pixels.marks[i]
        if mark == SEED and not told:
            pixels.reached[root_of(pixels.parents, i)] = wp.uint8(1)
        told = mark != wp.uint8(0) and (told or mark == SEED)


@wp.kernel
def set_reached(people: PeopleArrays, group: wp.uint8, first: int, pixels: PixelArrays):
    """Set the group of pixels that hang together with a seed."""
    row = row_of(people, first + wp.tid())
    root = int(-1)  # of the marked ones on end
    for i in range(row.begin, row.begin + row.width):
        if pixels.marks[i] == wp.uint8(0):
            root = -1
        else:
            if root < 0:
                root = root_of(pixels.parents, i)
            if pixels.reached[root] != wp.uint8(0):
                pixels.groups[i] = group


@wp.kernel
def count_own(
    people: PeopleArrays,
    bodies: BodyArrays,
    pixels: PixelArrays,
    far: wp.float64,
    farther: wp.float64,
    first: int,
    counts: wp.array2d[int],  # (N, NUM_COUNTS)  MODIFIED
):
    """Measure the person's pixels."""
    row = row_of(people, first + wp.tid())
    n = row.person
    window_row = people.areas[n, 0] + row.index
    left, right = int(-1), int(-1)
    known, within, beyond, away = int(0), int(0), int(0), int(0)
    counted = window_row % bodies.strides[n] == 0
    for column in range(row.width):
        if pixels.groups[row.begin + column] == OWN:
            window_column = people.areas[n, 1] + column
            left = wp.where(left < 0, window_column, left)
            right = window_column
            if counted and window_column % bodies.strides[n] == 0:
                distance = beyond_flesh(bodies, n, window_row, window_column)
                known += 1
                within += wp.where(distance <= wp.float64(0.0), 1, 0)
                beyond += wp.where(distance > far, 1, 0)
                away += wp.where(distance > farther, 1, 0)
    if left >= 0:
        wp.atomic_min(counts, n, 0, window_row)
        wp.atomic_max(counts, n, 1, window_row)
        wp.atomic_min(counts, n, 2, left)
        wp.atomic_max(counts, n, 3, right)
        wp.atomic_add(counts, n, 4, known)
        wp.atomic_add(counts, n, 5, within)
        wp.atomic_add(counts, n, 6, beyond)
        wp.atomic_add(counts, n, 7, away)


def gather(struct: Any, arrays: Sequence[wp.array]) -> Any:
    """A structure of arrays in its order."""
    found = struct()
    for name, array in zip(struct.vars, arrays, strict=True):
        setattr(found, name, array)
    return found


def launch_own(people: Any, bodies: Any, pixels: Any, rows: slice) -> None:
    """Fill groups in some of the rows of areas, those of whole people, here and below."""
    _launch(mark_near, [people, bodies], rows, pixels)
    _launch_reached(people, OWN, rows, pixels)


def launch_stray(people: Any, bodies: Any, pixels: Any, far: float, chosen: wp.array, rows: slice) -> None:
    """Ignore what hangs together with pixels ``far`` beyond the flesh, of chosen people."""
    _launch(mark_stray, [people, bodies, wp.float64(far), chosen], rows, pixels)
    _launch_reached(people, OTHERS, rows, pixels)


def launch_counts(
    people: Any, bodies: Any, pixels: Any, far: tuple[float, float], counts: wp.array, rows: slice
) -> None:
    """Measure what is the people's own; ``counts`` begin as the largest and smallest row and column, and 0."""
    inputs = [people, bodies, pixels, *map(wp.float64, far), rows.start, counts]
    wp.launch(count_own, rows.stop - rows.start, inputs, device=counts.device)


def _launch_reached(people: Any, group: Any, rows: slice, pixels: Any) -> None:
    _launch(join_rows, [people], rows, pixels)
    _launch(reach_seeds, [people], rows, pixels)
    _launch(set_reached, [people, group], rows, pixels)


def _launch(kernel: wp.Kernel, inputs: list[Any], rows: slice, pixels: Any) -> None:
    wp.launch(kernel, rows.stop - rows.start, [*inputs, rows.start, pixels], device=pixels.groups.device)
