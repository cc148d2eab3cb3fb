"""Pixels of pictures that are a person's own: those along their bones, and all that hangs together with them.

Of many people in many pictures; a picture has part labels, or tells whom each pixel shows. Only an area about each
person is looked at. Areas, and their rows, lie one after another in memory, of whatever sizes, and a thread has a row.
``reference.own_pixels`` says the same of one person.
"""

from collections.abc import Sequence
from typing import Any

import warp as wp

# NumPy doesn't fuse multiplications and additions either.
wp.set_module_options({"enable_backward": False, "fuse_fp": False})

NOBODYS = wp.constant(wp.uint8(0))
OWN = wp.constant(wp.uint8(1))  # group of a person of whom a mask is known
OTHERS = wp.constant(wp.uint8(255))  # or ignored
STEP = wp.constant(16)  # [px] of a row, of which the middle may tell that all are near, or none is
MIDDLE = wp.constant(wp.float64(8.0))  # of a step
# Judgements of a step, and kinds of a stretch of a row.
NOT_NEAR, MAYBE_NEAR, NEAR, UNLABELLED = wp.constant(0), wp.constant(1), wp.constant(2), wp.constant(3)
NUM_COUNTS = 4  # of a group's pixels: looked at, within flesh, far and farther

# Start (x, y), way to the end and its square; squared distance up to which pixels are near, and distance up to which
# they are seeds, -1 for none; box of the line: left, top, right, bottom; and distance beyond which nothing is near.
Bone: Any = wp.types.vector(length=12, dtype=wp.float64)
Flesh: Any = wp.types.vector(length=6, dtype=wp.float64)  # a bone's first five, then the radius as a share of height


@wp.struct
class PeopleArrays:
    """N people, and the pictures that show them, one after another."""

    labels: wp.array[wp.uint8]  # (Q,) group ids of the pictures with part labels
    owners: wp.array[int]  # (R,) whom each pixel of the others shows; 0: nobody
    pictures: wp.array2d[int]  # (N, 4) first pixel, height and width, and the person's number there; 0: part labels
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
    theirs: wp.array[Bone]  # (T,) of others who are near, one person's after another's
    first_theirs: wp.array[int]  # (N + 1,)
    reaches: wp.array2d[wp.float64]  # (N, 3) distances from bones and loose ends that are near, and that of seeds
    flesh: wp.array2d[Flesh]  # (N, F) of the groups, one after another; a radius below 0: not there
    first_flesh: wp.array[int]  # (G + 2,) of each group from 0 on
    complete: wp.array2d[wp.uint8]  # (N, G + 1) 1 where a group's keypoints are all known
    heights: wp.array[wp.float64]  # (N,)
    strides: wp.array[int]  # (N,) every so many-th row and column is counted


@wp.struct
class PixelArrays:
    """Pixels of the areas, and runs: pixels of a row, one after another, that may be kept or ignored together.

    Runs of a row stand from its first pixel's place on.
    """

    groups: wp.array[wp.uint8]  # (P,) of the person; ``NOBODYS`` and ``OTHERS``
    num_runs: wp.array[int]  # (R,) of each row
    starts: wp.array[int]  # (P,) first column of each run
    stops: wp.array[int]  # (P,) and that beyond the last
    parents: wp.array[int]  # (P,) a run that hangs together with this one, or itself
    seeded: wp.array[wp.uint8]  # (P,) 1 for runs without another parent that hang together with a seed


@wp.struct
class Row:
    """A row of an area."""

    person: int
    number: int  # among all
    index: int  # in the area
    begin: int  # first pixel
    width: int


@wp.func
def row_of(people: PeopleArrays, index: int) -> Row:
    found = Row()
    n = wp.lower_bound(people.first_rows, index + 1) - 1
    found.person = n
    found.number = index
    found.index = index - people.first_rows[n]
    found.width = people.areas[n, 3]
    found.begin = people.first_pixels[n] + found.index * found.width
    return found


@wp.func
def shows_part(group: wp.uint8) -> bool:
    return group != NOBODYS and group != OTHERS


@wp.func
def mask_group(owner: int, number: int) -> wp.uint8:
    """Group of a pixel that shows an owner, 0 being nobody, for the person with a number."""
    if owner == 0:
        return NOBODYS
    return wp.where(owner == number, OWN, OTHERS)


@wp.func
def group_of(people: PeopleArrays, number: int, pixel: int) -> wp.uint8:
    """Group of a pixel among all pictures'."""
    if number == 0:
        return people.labels[pixel]
    return mask_group(people.owners[pixel], number)


@wp.func
def group_at(people: PeopleArrays, n: int, row: int, column: int) -> wp.uint8:
    """Group of a pixel of a person's picture, as this tells it."""
    width = people.pictures[n, 2]
    if row < 0 or row >= people.pictures[n, 1] or column < 0 or column >= width:
        return OTHERS
    return group_of(people, people.pictures[n, 3], people.pictures[n, 0] + row * width + column)


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
def square_from(bone: Bone, x: wp.float64, y: wp.float64) -> wp.float64:
    return squared_distance(x - bone[0], y - bone[1], bone[2], bone[3], bone[4])


@wp.func
def may_be_within(bone: Bone, distance: wp.float64, x: wp.float64, y: wp.float64) -> bool:
    across = x >= bone[7] - distance and x <= bone[9] + distance
    return across and y >= bone[8] - distance and y <= bone[10] + distance


@wp.func
def near_bone(bodies: BodyArrays, n: int, last: int, x: wp.float64, y: wp.float64) -> int:
    """A bone that a place is near, of several the one that the ``last`` place was; -1 without."""
    bone = bodies.bones[n, last]
    if square_from(bone, x, y) <= bone[5]:
        return last
    for s in range(bodies.num_bones[n]):
        bone = bodies.bones[n, s]
        if may_be_within(bone, bone[11], x, y) and square_from(bone, x, y) <= bone[5]:
            return s
    return -1


@wp.func
def is_others(bodies: BodyArrays, n: int, x: wp.float64, y: wp.float64) -> bool:
    """True for a place within reach of others' bones, and nearer to them than to the person's."""
    reach = bodies.reaches[n, 0] * bodies.reaches[n, 0]
    other, own = wp.float64(wp.inf), wp.float64(wp.inf)
    for s in range(bodies.first_theirs[n], bodies.first_theirs[n + 1]):
        bone = bodies.theirs[s]
        if may_be_within(bone, bone[11], x, y):
            other = wp.min(other, square_from(bone, x, y))
    if other > reach:
        return False
    for s in range(bodies.num_bones[n]):
        bone = bodies.bones[n, s]
        if bone[6] >= wp.float64(0.0) and may_be_within(bone, bone[11], x, y):
            own = wp.min(own, square_from(bone, x, y))
    return wp.sqrt(own) > wp.sqrt(other)


@wp.struct
class Distances:
    """Distances of a place from the nearest of some lines."""

    own: wp.float64
    loose: wp.float64
    other: wp.float64


@wp.func
def distances_from(bodies: BodyArrays, n: int, x: wp.float64, y: wp.float64) -> Distances:
    found = Distances()
    own, loose, other = wp.float64(wp.inf), wp.float64(wp.inf), wp.float64(wp.inf)
    for s in range(bodies.num_bones[n]):
        bone = bodies.bones[n, s]
        squared = square_from(bone, x, y)
        if bone[6] >= wp.float64(0.0):
            own = wp.min(own, squared)
        else:
            loose = wp.min(loose, squared)
    for s in range(bodies.first_theirs[n], bodies.first_theirs[n + 1]):
        other = wp.min(other, square_from(bodies.theirs[s], x, y))
    found.own = wp.sqrt(own)
    found.loose = wp.sqrt(loose)
    found.other = wp.sqrt(other)
    return found


@wp.func
def judge_step(bodies: BodyArrays, n: int, crowded: bool, last: int, x: wp.float64, y: wp.float64):
    """Judge all pixels of a step by its middle: ``NEAR``, ``NOT_NEAR`` or ``MAYBE_NEAR``; and a bone that is near.

    The bone that was near last comes first, for it mostly is again.
    """
    off = MIDDLE + wp.float64(1e-6)
    reach, loose_reach = bodies.reaches[n, 0], bodies.reaches[n, 1]
    if crowded:
        far = distances_from(bodies, n, x, y)
        certain = far.own + off <= reach or far.loose + off <= loose_reach
        possible = far.own - off <= reach or far.loose - off <= loose_reach
        if certain and (far.other - off > reach or far.own + off < far.other - off):
            return NEAR, last
        if possible and not (far.other + off <= reach and far.other + off < far.own - off):
            return MAYBE_NEAR, last
        return NOT_NEAR, last
    judgement = int(NOT_NEAR)
    for k in range(-1, bodies.num_bones[n]):
        s = wp.where(k < 0, last, k)
        bone = bodies.bones[n, s]
        distance = wp.sqrt(square_from(bone, x, y))
        limit = wp.where(bone[6] >= wp.float64(0.0), reach, loose_reach)
        if distance + off <= limit:
            return NEAR, s
        if distance - off <= limit:
            judgement = MAYBE_NEAR
    return judgement, last


@wp.func
def beyond_flesh(bodies: BodyArrays, n: int, group: int, row: int, column: int) -> wp.float64:
    """Distance of a pixel from the flesh of a group, as a share of the height; at most 0 within."""
    x, y = wp.float64(column) + wp.float64(0.5), wp.float64(row) + wp.float64(0.5)
    nearest = wp.float64(wp.inf)
    for s in range(bodies.first_flesh[group], bodies.first_flesh[group + 1]):
        flesh = bodies.flesh[n, s]
        if nearest > wp.float64(0.0) and flesh[5] >= wp.float64(0.0):
            squared = squared_distance(x - flesh[0], y - flesh[1], flesh[2], flesh[3], flesh[4])
            nearest = wp.min(nearest, wp.sqrt(squared) / bodies.heights[n] - flesh[5])
    return nearest


@wp.func
def run_lies_along(bodies: BodyArrays, n: int, first_x: wp.float64, count: int, y: wp.float64) -> bool:
    """True if a pixel of a run of a row is a seed; the middle of its first pixel is at ``first_x``.

    Along a row the distance from a bone falls to one place and rises from there, so that only the pixels about this
    place are looked at. Where rounding may decide, all are.
    """
    half, one, slack = wp.float64(0.5), wp.float64(1.0), wp.float64(1e-6)
    last_x = first_x + wp.float64(count - 1)
    for s in range(bodies.num_bones[n]):
        bone = bodies.bones[n, s]
        radius = bone[6]
        above, below = bone[8] - radius - one, bone[10] + radius + one
        if radius >= wp.float64(0.0) and y >= above and y <= below:
            if last_x >= bone[7] - radius - one and first_x <= bone[9] + radius + one:
                share = wp.float64(0.0)
                if bone[3] != wp.float64(0.0):
                    share = wp.clamp((y - bone[1]) / bone[3], wp.float64(0.0), one)
                lowest = wp.clamp(bone[0] + share * bone[2], first_x, last_x)
                x = wp.float64(floor_index(lowest - half)) + half
                after = wp.min(x + one, last_x)
                distance = wp.sqrt(wp.min(square_from(bone, x, y), square_from(bone, after, y)))
                if distance <= radius:
                    return True
                if distance <= radius + slack:
                    for k in range(count):
                        if wp.sqrt(square_from(bone, first_x + wp.float64(k), y)) <= radius:
                            return True
    return False


@wp.func
def store_run(pixels: PixelArrays, row: Row, count: int, start: int, stop: int, seeded: bool):
    """Store a run of a row that has ``count`` runs so far."""
    i = row.begin + count
    pixels.starts[i] = start
    pixels.stops[i] = stop
    pixels.parents[i] = i
    pixels.seeded[i] = wp.uint8(wp.where(seeded, 1, 0))


@wp.func
def fill_row(people: PeopleArrays, row: Row, picture_row: int, groups: wp.array[wp.uint8]):
    """Fill the groups of a row as its picture tells them."""
    n, row_begin, width = row.person, int(row.begin), int(row.width)
    # Copies: whatever stands in an array would be read again for each pixel.
    labels, number, area_left = people.labels, int(people.pictures[n, 3]), int(people.areas[n, 1])
    left, step = wp.float64(people.boxes[n, 1]), wp.float64(people.boxes[n, 3])
    picture_width = int(people.pictures[n, 2])
    begin = people.pictures[n, 0] + picture_row * picture_width
    if picture_row < 0 or picture_row >= people.pictures[n, 1]:
        picture_width = 0
    shift = floor_index(left) + area_left
    same = number == 0 and step == wp.float64(1.0) and left == wp.float64(floor_index(left))
    if same and shift >= 0 and shift + width <= picture_width:  # pixels of the window are the picture's
        for column in range(width):
            groups[row_begin + column] = labels[begin + shift + column]
        return
    for column in range(width):
        picture_column = floor_index(left + (wp.float64(area_left + column) + wp.float64(0.5)) * step)
        group = OTHERS
        if picture_column >= 0 and picture_column < picture_width:
            group = group_of(people, number, begin + picture_column)
        groups[row_begin + column] = group


@wp.func
def end_stretch(
    bodies: BodyArrays, pixels: PixelArrays, row: Row, kind: int, start: int, stop: int, x: wp.float64, y: wp.float64
) -> bool:
    """Store a stretch of a row, from ``x`` on, that is near as the row's next run; true if a seed is in the stretch."""
    seeded = run_lies_along(bodies, row.person, x, stop - start, y)
    if kind == NEAR:
        count = pixels.num_runs[row.number]
        store_run(pixels, row, count, start, stop, seeded)
        pixels.num_runs[row.number] = count + 1
    return seeded


@wp.kernel
def find_near(
    people: PeopleArrays,
    bodies: BodyArrays,
    along: wp.array[int],  # (N,) 1 for people of whose bones a labelled pixel lies along one  MODIFIED
    first: int,
    pixels: PixelArrays,
):
    """Fill groups, as the pictures tell them near the bones, and find runs of what is labelled there.

    What is labelled elsewhere is ``OTHERS``. A row is a series of stretches: near, not near, and not labelled.
    """
    row = row_of(people, first + wp.tid())
    n, begin, width, groups = row.person, int(row.begin), int(row.width), pixels.groups
    window_row, area_left = people.areas[n, 0] + row.index, int(people.areas[n, 1])
    fill_row(people, row, picture_index(people, n, 0, window_row), groups)
    pixels.num_runs[row.number] = 0
    half, y = wp.float64(0.5), wp.float64(window_row) + wp.float64(0.5)
    crowded = bodies.first_theirs[n + 1] > bodies.first_theirs[n]
    last, judged, judgement = int(0), int(-1), int(NOT_NEAR)
    told = bool(False)  # the row has a labelled pixel along a bone
    start, kind = int(0), int(UNLABELLED)  # of the stretch that is open
    column = int(0)
    while column < width:
        piece, own = int(column), int(UNLABELLED)
        if shows_part(groups[begin + column]):
            if column // STEP != judged:
                judged = column // STEP
                middle = wp.float64(area_left + judged * STEP) + MIDDLE
                judgement, last = judge_step(bodies, n, crowded, last, middle, y)
            own, stop = int(judgement), wp.min((judged + 1) * STEP, width)
            if judgement == MAYBE_NEAR:
                own, stop = int(NOT_NEAR), column + 1
                x = wp.float64(area_left + column) + half
                found = near_bone(bodies, n, last, x, y)
                if found >= 0:
                    last = found
                    if not crowded or not is_others(bodies, n, x, y):
                        own = int(NEAR)
            while column < stop and shows_part(groups[begin + column]):
                if own == NOT_NEAR:
                    groups[begin + column] = OTHERS
                column += 1
        else:
            while column < width and not shows_part(groups[begin + column]):
                column += 1
        if own != kind:
            if kind == NEAR or (kind == NOT_NEAR and not told):
                x = wp.float64(area_left + start) + half
                told = end_stretch(bodies, pixels, row, kind, start, piece, x, y) or told
            start, kind = piece, own
    if kind == NEAR or (kind == NOT_NEAR and not told):
        told = end_stretch(bodies, pixels, row, kind, start, width, wp.float64(area_left + start) + half, y) or told
    if told:
        along[n] = 1


@wp.kernel
def find_stray(
    people: PeopleArrays,
    bodies: BodyArrays,
    far: wp.float64,
    chosen: wp.array[int],  # (N,) a group of each person; 0: none
    first: int,
    pixels: PixelArrays,
):
    """Find runs of chosen groups that lie beyond the flesh; pixels ``far`` are seeds."""
    row = row_of(people, first + wp.tid())
    n = row.person
    group, start, count = int(chosen[n]), int(-1), int(0)
    seeded = bool(False)
    for column in range(row.width + 1):
        beyond = bool(False)
        if column < row.width and group != 0 and int(pixels.groups[row.begin + column]) == group:
            distance = beyond_flesh(bodies, n, group, people.areas[n, 0] + row.index, people.areas[n, 1] + column)
            beyond = distance > wp.float64(0.0)
            if beyond:
                seeded = (seeded and start >= 0) or distance > far
                start = wp.where(start < 0, column, start)
        if start >= 0 and not beyond:
            store_run(pixels, row, count, start, column, seeded)
            start, count = int(-1), count + 1
    pixels.num_runs[row.number] = count


@wp.func
def root_of(parents: wp.array[int], index: int) -> int:
    while parents[index] != index:
        index = parents[index]
    return index


@wp.func
def join(parents: wp.array[int], one: int, other: int):
    """Let two runs have one root, the lower; also while other threads join others."""
    a, b = root_of(parents, one), root_of(parents, other)
    while a != b:
        low, high = wp.min(a, b), wp.max(a, b)
        before = wp.atomic_min(parents, high, low)
        if before == high:
            return
        a, b = root_of(parents, before), root_of(parents, low)


@wp.kernel
def join_runs(people: PeopleArrays, first: int, pixels: PixelArrays):
    """Join runs that touch those of the row above, at a corner at least."""
    row = row_of(people, first + wp.tid())
    if row.index == 0:
        return
    above = row.begin - row.width
    k, stop = int(above), above + pixels.num_runs[row.number - 1]
    for i in range(row.begin, row.begin + pixels.num_runs[row.number]):
        while k < stop and pixels.stops[k] < pixels.starts[i]:
            k += 1
        other = int(k)
        while other < stop and pixels.starts[other] <= pixels.stops[i]:
            join(pixels.parents, other, i)
            other += 1


@wp.kernel
def reach_roots(people: PeopleArrays, first: int, pixels: PixelArrays):
    """Tell roots that a seed hangs together with them."""
    row = row_of(people, first + wp.tid())
    for i in range(row.begin, row.begin + pixels.num_runs[row.number]):
        if pixels.seeded[i] != wp.uint8(0):
            root = root_of(pixels.parents, i)
            if root != i:
                pixels.seeded[root] = wp.uint8(1)


@wp.struct
class Counts:
    """Numbers of a group's pixels, as ``NUM_COUNTS`` has them."""

    looked: int
    within: int
    far: int
    farther: int


@wp.func
def add_counts(counts: wp.array3d[int], n: int, group: wp.uint8, found: Counts):
    g = int(group)
    if found.looked > 0 and g < counts.shape[1]:
        wp.atomic_add(counts, n, g, 0, found.looked)
        wp.atomic_add(counts, n, g, 1, found.within)
        wp.atomic_add(counts, n, g, 2, found.far)
        wp.atomic_add(counts, n, g, 3, found.farther)


@wp.kernel
def settle(
    people: PeopleArrays,
    bodies: BodyArrays,
    kept: bool,
    far: wp.float64,
    farther: wp.float64,
    first: int,
    pixels: PixelArrays,
    limits: wp.array2d[int],  # (N, 4) first and last row, first and last column  MODIFIED
    counts: wp.array3d[int],  # (N, G + 1, NUM_COUNTS)  MODIFIED
):
    """Ignore all that is labelled but what hangs together with a seed (``kept``), or that; and measure the rest."""
    row = row_of(people, first + wp.tid())
    n = row.person
    for k in range(row.begin, row.begin + pixels.num_runs[row.number]):
        if (pixels.seeded[root_of(pixels.parents, k)] != wp.uint8(0)) != kept:
            for column in range(pixels.starts[k], pixels.stops[k]):
                pixels.groups[row.begin + column] = OTHERS
    left, right = int(0), row.width - 1
    while left <= right and not shows_part(pixels.groups[row.begin + left]):
        left += 1
    if left > right:
        return
    while not shows_part(pixels.groups[row.begin + right]):
        right -= 1
    window_row, area_left = people.areas[n, 0] + row.index, people.areas[n, 1]
    wp.atomic_min(limits, n, 0, window_row)
    wp.atomic_max(limits, n, 1, window_row)
    wp.atomic_min(limits, n, 2, area_left + left)
    wp.atomic_max(limits, n, 3, area_left + right)
    stride = int(bodies.strides[n])
    if window_row % stride != 0:
        return
    current, found = wp.uint8(255), Counts()  # group of the pixels counted last, and their numbers
    next_column = ((area_left + left + stride - 1) // stride) * stride - area_left  # to be counted
    for column in range(next_column, right + 1, stride):
        group = pixels.groups[row.begin + column]
        if shows_part(group):
            if group != current:
                add_counts(counts, n, current, found)
                current, found = group, Counts()
            found.looked += 1
            if int(group) < counts.shape[1] and bodies.complete[n, int(group)] != wp.uint8(0):
                distance = beyond_flesh(bodies, n, int(group), window_row, area_left + column)
                found.within += wp.where(distance <= wp.float64(0.0), 1, 0)
                found.far += wp.where(distance > far, 1, 0)
                found.farther += wp.where(distance > farther, 1, 0)
    add_counts(counts, n, current, found)


@wp.kernel
def fill_mask_groups(owners: wp.array2d[int], number: int, groups: wp.array2d[wp.uint8]):
    """Fill groups of a picture's pixels for one person; ``owners`` tell whom each pixel shows."""
    row, column = wp.tid()
    groups[row, column] = mask_group(owners[row, column], number)


def gather(struct: Any, arrays: Sequence[wp.array]) -> Any:
    """A structure of arrays in its order."""
    found = struct()
    for name, array in zip(struct.vars, arrays, strict=True):
        setattr(found, name, array)
    return found


def launch_near(people: Any, bodies: Any, pixels: Any, along: wp.array, rows: slice) -> None:
    """Fill groups, and find runs near bones, in some of the rows of areas, those of whole people, here and below."""
    _launch(find_near, [people, bodies, along], rows, pixels)
    _launch_joined(people, rows, pixels)


def launch_stray(people: Any, bodies: Any, pixels: Any, far: float, chosen: wp.array, rows: slice) -> None:
    """Find runs beyond the flesh of chosen groups, with seeds so ``far`` from it."""
    _launch(find_stray, [people, bodies, wp.float64(far), chosen], rows, pixels)
    _launch_joined(people, rows, pixels)


def launch_settled(
    people: Any,
    bodies: Any,
    pixels: Any,
    kept: bool,
    far: tuple[float, float],
    measures: Sequence[wp.array],
    rows: slice,
) -> None:
    """Keep what hangs together with seeds, or ignore it, and measure what is left in ``settle``'s limits and counts.

    These begin as the largest and smallest row and column, and 0.
    """
    inputs = [people, bodies, kept, *map(wp.float64, far), rows.start, pixels, *measures]
    wp.launch(settle, rows.stop - rows.start, inputs, device=pixels.groups.device)


def launch_mask_groups(owners: wp.array, number: int, groups: wp.array) -> None:
    """Fill groups (H, W) of a picture's pixels for the person with a number among its ``owners`` (H, W)."""
    wp.launch(fill_mask_groups, owners.shape, [owners, number, groups], device=groups.device)


def _launch_joined(people: Any, rows: slice, pixels: Any) -> None:
    _launch(join_runs, [people], rows, pixels)
    _launch(reach_roots, [people], rows, pixels)


def _launch(kernel: wp.Kernel, inputs: list[Any], rows: slice, pixels: Any) -> None:
    wp.launch(kernel, rows.stop - rows.start, [*inputs, rows.start, pixels], device=pixels.groups.device)
