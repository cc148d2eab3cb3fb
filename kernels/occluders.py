"""Strangers and things before people in pictures of part labels, all of them in one pass over the pixels."""

import warp as wp

from .label_noise import looked_up
from .labels import IGNORE
from .lanes import num_lanes
from .own_pixels import gather

# Torch doesn't fuse multiplications and additions of different operations.
wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@wp.struct
class StrangerArrays:
    """The person of the sample before each of B, moved to the side."""

    shifts: wp.array[int]  # (B,), to the right [px]
    there: wp.array[wp.bool]  # (B,)
    behind: wp.array[wp.bool]  # (B,), the person hides what overlaps
    unknown: wp.array[wp.bool]  # (B,), labels say 255, else what they call the stranger's parts
    tables: wp.array2d[wp.uint8]  # (B, 22), this


@wp.struct
class ThingArrays:
    """T things before each of B people, each before those ahead of it."""

    places: wp.array2d[wp.vec2]  # (B, T), middles, crop coordinates
    radii: wp.array2d[wp.vec2]  # (B, T), or half sides
    there: wp.array2d[wp.bool]  # (B, T)
    boxes: wp.array2d[wp.bool]  # (B, T), else ellipses
    groups: wp.array2d[wp.uint8]  # (B, T), what labels say of them


@wp.struct
class OccluderArrays:
    """Pixels with something before B people, see ``lab.synthetic.occluders.Occluders``."""

    mask: wp.array3d[wp.bool]  # (B, S, S)
    hiding: wp.array3d[wp.bool]  # (B, S, S)
    groups: wp.array3d[wp.uint8]  # (B, S, S)


@wp.func
def is_part(label: wp.uint8, num_parts: int) -> bool:
    return int(label) >= 1 and int(label) <= num_parts


@wp.kernel
def find_columns(
    labels: wp.array3d[wp.uint8],  # (B, S, S)
    num_parts: int,
    first: wp.array[int],  # (B,), column that shows a part, S before  OUTPUT
    last: wp.array[int],  # (B,), -1 before  OUTPUT
):
    """Find the columns that people span. One thread a column."""
    n, column = wp.tid()
    for row in range(labels.shape[1]):
        if is_part(labels[n, row, column], num_parts):
            wp.atomic_min(first, n, column)
            wp.atomic_max(last, n, column)
            break


@wp.func
def thing_covers(things: ThingArrays, n: int, t: int, x: float, y: float) -> bool:
    """True if a thing covers a place (x, y)."""
    place, radii = things.places[n, t], things.radii[n, t]
    across, down = (x - place[0]) / radii[0], (y - place[1]) / radii[1]
    across, down = across * across, down * down
    if things.boxes[n, t]:
        return across < 1.0 and down < 1.0
    return across + down < 1.0


@wp.kernel
def draw_before(
    labels: wp.array3d[wp.uint8],  # (N, S, S), parts of all samples
    first: int,  # of the B samples, among all
    strangers: StrangerArrays,
    things: ThingArrays,
    centres: wp.array[float],  # (S,), of pixels, crop coordinates
    num_parts: int,
    holes: int,  # so many things, the first ones, hide nobody
    lanes: int,
    found: OccluderArrays,  # OUTPUT
):
    """Draw all that is before people. One thread a row, or some of its columns."""
    n, row, lane = wp.tid()
    size = labels.shape[2]
    other = (first + n + labels.shape[0] - 1) % labels.shape[0]
    shift = strangers.shifts[n]
    present = int(0)  # a bit for each thing: most are not there
    for t in range(things.there.shape[1]):
        present |= wp.where(things.there[n, t], 1 << t, 0)
    for column in range(lane, size, lanes):
        source = column - shift
        label = labels[other, row, wp.clamp(source, 0, size - 1)]
        hiding = strangers.there[n] and source >= 0 and source < size and is_part(label, num_parts)
        if hiding and strangers.behind[n]:
            hiding = labels[first + n, row, column] == wp.uint8(0)
        covered = hiding
        group = wp.uint8(IGNORE)
        if not strangers.unknown[n]:
            group = looked_up(strangers.tables, n, label)
        if present != 0:
            for t in range(things.there.shape[1]):
                if (present >> t) & 1 == 1 and thing_covers(things, n, t, centres[column], centres[row]):
                    group = things.groups[n, t]
                    covered = True
                    hiding = hiding or t >= holes
        found.mask[n, row, column] = covered
        found.hiding[n, row, column] = hiding
        found.groups[n, row, column] = group


def launch_columns(labels: wp.array, num_parts: int, first: wp.array, last: wp.array) -> None:
    """Launch ``find_columns``."""
    dim = labels.shape[0], labels.shape[2]
    wp.launch(find_columns, dim, [labels, num_parts], [first, last], device=labels.device)


def launch_drawing(
    labels: wp.array,
    numbers: tuple[int, int, int],
    strangers: list[wp.array],
    things: list[wp.array],
    centres: wp.array,
    found: list[wp.array],
) -> None:
    """Launch ``draw_before``, with arrays in the order of the structures, for as many samples as they have.

    The numbers are the first sample, that of parts, and that of things that hide nobody.
    """
    first, num_parts, holes = numbers
    given = [gather(struct, arrays) for struct, arrays in ((StrangerArrays, strangers), (ThingArrays, things))]
    drawn, lanes = gather(OccluderArrays, found), num_lanes(labels.device)
    inputs = [labels, first, *given, centres, num_parts, holes, lanes, drawn]
    wp.launch(draw_before, (*drawn.mask.shape[:2], lanes), inputs, device=labels.device)
