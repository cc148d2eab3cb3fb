"""Backward pass of the mesh renderer in x and y: change of the part maps with silhouette edges (paper, eq. 10 and 11).

The definition is docs/explanation/mesh_renderer.md; ``reference/mesh.py`` is the same in slow float64. The result is
linear in the loss gradient of the part maps.
"""

from typing import Any, NamedTuple, Self

import warp as wp

from ..labels import MISSING, SURPLUS, all_wrong, extent, flat, overload_gradients, pixel_gradient, pixels_of, weight_of
from ..lanes import AT_ONCE, at_once
from .forces import Forces, push_vertex, units_of
from .rasterize import launch_bodies
from .triangles import ImageArrays, MeshArrays, first_pixel

wp.set_module_options({"enable_backward": False, "fast_math": True})

# On CUDA, threads a block and blocks a multiprocessor: some registers spill, but the memory's latency is hidden.
_PUSH_EDGES_BOUNDS = (256, 4)

# Threads on CUDA for one body: about one for each way of each scan line that a silhouette crosses, in a picture of
# 256 x 256.
_LINE_THREADS = 4096

COUNT_STRIDE = 16  # counters of two bodies lie in different cache lines, or their atomics would queue


@wp.func
def along_and_across(axis: int, p: wp.vec3):
    """Coordinates of a point along the scan lines, across them, and in depth."""
    return wp.vec3(wp.where(axis == 0, p[0], p[1]), wp.where(axis == 0, p[1], p[0]), p[2])


@wp.func
def lines_between(start: float, end: float, first: int, last: int, size: int):
    """First scan line that an edge crosses, between ``first`` and ``last``, and the number of them."""
    low = wp.max(first_pixel(wp.min(start, end), size), first)
    high = wp.min(first_pixel(wp.max(start, end), size), last + 1)
    return wp.vec2i(low, wp.max(high - low, 0))


@wp.func
def side_of(p0: wp.vec3, p1: wp.vec3, q: wp.vec3):
    """Side of an edge on which a face with the vertex q lies: 1, -1, or 0 for one that is seen edge-on."""
    # two products, not their difference, which a fused multiply-add rounds once: not to 0 where q is p1
    left = (p1[0] - p0[0]) * (q[1] - p0[1])
    right = (p1[1] - p0[1]) * (q[0] - p0[0])
    return wp.where(left > right, 1, 0) - wp.where(left < right, 1, 0)


@wp.kernel
def find_silhouettes(
    first_body: int,
    threads: int,  # of one body: E
    mesh: MeshArrays,
    size: wp.vec2i,  # width, height
    gradient: Any,
    counts: wp.array2d[wp.uint64],  # (B, 16), zeroed  MODIFIED: column 0, edges in the high half, lines in the low one
    silhouettes: wp.array2d[wp.vec2i],  # (B, E)  OUTPUT: edge and its sides as one number; lines of those before it
):
    """List the silhouette edges that cross a scan line with wrong pixels of their part."""
    thread = wp.tid()
    b = first_body + thread // threads
    ends = mesh.edges[thread % threads]
    points = mesh.vertices[b]
    p0 = points[ends[0]]
    p1 = points[ends[1]]
    q = points[ends[4]]
    side = side_of(p0, p1, q)
    other_side = side
    nearest = wp.min(wp.min(p0[2], p1[2]), q[2])
    if ends[3] >= 0:
        r = points[ends[5]]
        other_side = side_of(p0, p1, r)
        nearest = wp.min(nearest, r[2])
    if side + other_side == 0 or nearest <= mesh.near:
        return  # the faces lie on either side: no silhouette
    wrong = all_wrong(gradient, b, int(mesh.face_labels[ends[2]]))
    rows = lines_between(p0[1], p1[1], wrong[0], wrong[1], size[1])
    columns = lines_between(p0[0], p1[0], wrong[2], wrong[3], size[0])
    lines = rows[1] + columns[1]
    if lines > 0:
        # one number, so that lines are counted in the order of the list
        before = wp.atomic_add(counts, b, 0, (wp.uint64(1) << wp.uint64(32)) + wp.uint64(lines))
        edge_and_sides = 8 * (thread % threads) + side + other_side + 2
        silhouettes[b, int(before >> wp.uint64(32))] = wp.vec2i(edge_and_sides, int(before & wp.uint64(0xFFFFFFFF)))


@wp.func
def last_before(found: wp.array[wp.vec2i], count: int, line: int):
    """Index of the silhouette edge that a scan line belongs to."""
    low = int(0)
    high = int(count)
    while high - low > 1:
        middle = (low + high) // 2
        if found[middle][1] <= line:
            low = middle
        else:
            high = middle
    return low


@wp.func
def reach_out(
    picture: wp.array[wp.uint8],
    depth: wp.array[float],
    asked: Any,
    label: int,
    edge_depth: float,
    first: int,  # pixel
    step: int,  # to the next
    count: int,  # how many there are
    distance: float,  # of the first [px]
):
    """Sum of the outer pixels' gradients, each over its distance, that pulls an edge outward."""
    pull = float(0.0)
    done = int(0)
    while done < count:
        shown = wp.vec4i()
        values = wp.vec4()
        for i in range(AT_ONCE):
            if i < at_once():
                at = first + wp.min(done + i, count - 1) * step
                shown[i] = int(picture[at])
                values[i] = pixel_gradient(asked, at, label, False)
        for i in range(AT_ONCE):
            if i < at_once() and done + i < count and shown[i] == label:
                count = done + i
            if i < at_once() and done + i < count and values[i] != 0.0:
                switches = shown[i] == 0
                if not switches:
                    switches = depth[first + (done + i) * step] > edge_depth
                if switches:
                    pull += values[i] / wp.max(distance + float(done + i), 1.0)
        done += at_once()
    return pull


@wp.func
def draw_in(picture: wp.array[wp.uint8], asked: Any, label: int, first: int, step: int, count: int, distance: float):
    """Sum of the inner pixels' gradients, each over its distance, that pushes an edge inward."""
    pull = float(0.0)
    done = int(0)
    while done < count:
        shown = wp.vec4i()
        values = wp.vec4()
        for i in range(AT_ONCE):
            if i < at_once():
                at = first + wp.min(done + i, count - 1) * step
                shown[i] = int(picture[at])
                values[i] = pixel_gradient(asked, at, label, True)
        for i in range(AT_ONCE):
            if i < at_once() and done + i < count and shown[i] == 0:
                count = done + i
            if i < at_once() and done + i < count and shown[i] == label:
                pull += values[i] / wp.max(distance + float(done + i), 1.0)
        done += at_once()
    return pull


@wp.kernel(launch_bounds=_PUSH_EDGES_BOUNDS)
def push_edges(
    first_body: int,
    threads: int,  # of one body
    mesh: MeshArrays,
    images: ImageArrays,
    counts: wp.array2d[wp.uint64],  # (B, 16), column 0
    silhouettes: wp.array2d[wp.vec2i],  # (B, E)
    max_distance: float,  # [px] pixels farther from the edge do nothing; the paper's rule: inf
    gradient: Any,
    forces: Forces,  # MODIFIED: x and y are added to
):
    """Gradient in x and y (paper, eq. 10 and 11), along each pixel row and column that an edge crosses.

    Pixels of background that should show the part pull the edge out, pixels of the part that should not push it in,
    others do nothing. Threads share the lines of all edges, outward first: neighbours do the same for about as long.
    """
    thread = wp.tid()
    b = first_body + thread // threads
    found = silhouettes[b]
    count = int(counts[b, 0] >> wp.uint64(32))
    lines = int(counts[b, 0] & wp.uint64(0xFFFFFFFF))
    share = (2 * lines + threads - 1) // threads
    task = thread % threads * share
    end = wp.min(task + share, 2 * lines)
    size = wp.vec2i(images.labels.shape[2], images.labels.shape[1])
    picture = flat(images.labels[b])
    depth = flat(images.depth[b])
    while task < end:
        outward = task < lines
        line = task - wp.where(outward, 0, lines)
        silhouette = found[last_before(found, count, line)]
        line -= silhouette[1]
        ends = mesh.edges[silhouette[0] >> 3]
        sides = (silhouette[0] & 7) - 2
        label = int(mesh.face_labels[ends[2]])
        p0 = mesh.vertices[b, ends[0]]
        p1 = mesh.vertices[b, ends[1]]
        wrong = all_wrong(gradient, b, label)
        rows = lines_between(p0[1], p1[1], wrong[0], wrong[1], size[1])
        columns = lines_between(p0[0], p1[0], wrong[2], wrong[3], size[0])
        wrong = extent(gradient, b, wp.where(outward, MISSING, SURPLUS), label)
        asked = pixels_of(gradient, b, label)
        # an edge of a face that is seen edge-on counts half, for the face has another where the part ends as well
        factor = units_of(forces, b) * weight_of(gradient, b, label) * 0.5 * float(wp.abs(sides))
        while task < end and line < rows[1] + columns[1]:
            axis = wp.where(line < rows[1], 0, 1)  # 0: along a row, x moves; 1: along a column, y moves
            across = wp.where(axis == 0, rows[0] + line, columns[0] + line - rows[1])
            task += 1
            line += 1
            q0 = along_and_across(axis, p0)
            q1 = along_and_across(axis, p1)
            length = q1[1] - q0[1]
            inward = 1
            if (length > 0.0) == ((sides > 0) == (axis == 0)):
                inward = -1
            step = wp.where(outward, -inward, inward)
            last = wp.where(axis == 0, wrong[2], wrong[0])
            if step > 0:
                last = wp.where(axis == 0, wrong[3], wrong[1])
            count_along = wp.where(axis == 0, size[0], size[1])
            pitch = wp.where(axis == 0, 1, size[0])  # from one pixel of a scan line to the next
            start = across * wp.where(axis == 0, size[0], 1)
            w1 = (float(across) + 0.5 - q0[1]) / length
            w0 = 1.0 - w1
            crossing = w0 * q0[0] + w1 * q1[0]
            edge_depth = w0 * q0[2] + w1 * q1[2]
            if mesh.perspective:
                edge_depth = 1.0 / (w0 / q0[2] + w1 / q1[2])
            # first pixel centres strictly outside and at or inside the crossing, clamped in float against overflow
            place = wp.clamp(crossing, -1.0, float(count_along) + 1.0)
            inside = int(wp.ceil(place - 0.5))
            outside = inside - 1
            if inward < 0:
                inside = int(wp.floor(place - 0.5))
                outside = inside + 1

            going = bool(True)
            if outside >= 0 and outside < count_along:
                # an edge inside its own part's picture bounds nothing
                going = int(picture[start + outside * pitch]) != label

            pixel = wp.where(outward, outside, inside)
            pixel = wp.where(step > 0, wp.max(pixel, 0), wp.min(pixel, count_along - 1))
            distance = wp.abs(float(pixel) + 0.5 - crossing)
            left = (last - pixel) * step + 1
            if float(left) > max_distance - distance:
                left = int(wp.floor(max_distance - distance)) + 1
            if not going:
                left = 0
            at = start + pixel * pitch
            pull = float(0.0)
            if outward:
                pull = reach_out(picture, depth, asked, label, edge_depth, at, step * pitch, left, distance)
            else:
                pull = draw_in(picture, asked, label, at, step * pitch, left, distance)
            if pull != 0.0:
                pull *= float(-inward) * factor
                # either end, by how much it moves the crossing
                push_vertex(forces, b, ends[0], axis, w0 * pull)
                push_vertex(forces, b, ends[1], axis, w1 * pull)


overload_gradients(find_silhouettes, push_edges)


class SilhouetteList(NamedTuple):
    """Scratch: the silhouette edges of each body.

    Attributes:
        counts: Number of each body's edges, and of the scan lines they cross, in column 0, shape (B, 16), uint64.
        silhouettes: Edge and lines before it, shape (B, E), vec2i.
    """

    counts: wp.array
    silhouettes: wp.array

    @classmethod
    def make(cls, batch: int, num_edges: int, device: str | wp.Device) -> Self:
        """Allocate an empty list for a batch."""
        return cls(
            counts=wp.zeros((batch, COUNT_STRIDE), dtype=wp.uint64, device=device),
            silhouettes=wp.empty((batch, num_edges), dtype=wp.vec2i, device=device),
        )


def launch_push_edges(
    mesh: MeshArrays, images: ImageArrays, gradient: Any, max_distance: float, found: SilhouetteList, forces: Any
) -> None:
    """Add to the forces on vertices in x and y, by a LabelTarget or DenseGradient.

    Images are contiguous; what is ``found`` is an empty list, whose counts are 0.
    """
    device = mesh.vertices.device
    batch, height, width = images.labels.shape
    inputs = [mesh, wp.vec2i(width, height), gradient]
    launch_bodies(find_silhouettes, batch, mesh.edges.shape[0], inputs, [*found], device)
    threads = 1 if device.is_cpu else _LINE_THREADS
    launch_bodies(push_edges, batch, threads, [mesh, images, *found, max_distance, gradient], [forces], device)
