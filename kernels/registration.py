"""Closest points and penetration between ellipsoids and a detailed mesh (paper, eq. 16 to 18).

The mesh of a batch is one Warp mesh: part by part and body by body, each part's faces in a cell of their own, so far
from all others that the closest point to a part's sample is on the same part of the same body.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

DEEP = wp.constant(0.02)  # share of the way from an ellipsoid's centre to its surface


@wp.struct
class PartArrays:
    """Posed ellipsoids of all bodies, one after another."""

    centres: wp.array[wp.vec3]  # (B P,) [m]
    axes: wp.array[wp.mat33]  # (B P,) columns
    semi_axes: wp.array[wp.vec3]  # (B P,) [m]
    count: int  # P


@wp.func
def radius(point: wp.vec3, centre: wp.vec3, axes: wp.mat33, semi_axes: wp.vec3) -> float:
    """The paper's e: 1 on the ellipsoid's surface, less inside."""
    return wp.length(wp.cw_div(wp.transpose(axes) * (point - centre), semi_axes))


@wp.kernel
def find_skin(
    mesh: wp.uint64,
    vertices: wp.array[wp.vec3],  # (V,) [m]
    directions: wp.array[wp.vec3],  # (D,) unit
    start: float,  # [m] from the vertex, where rays begin
    skin: wp.array[float],  # (V,) 1 where a ray leaves the body, else 0  OUTPUT
):
    i = wp.tid()
    skin[i] = 0.0
    for k in range(directions.shape[0]):
        found = wp.mesh_query_ray(mesh, vertices[i] + directions[k] * start, directions[k], 1.0e3)
        if not found.result:
            skin[i] = 1.0
            break


@wp.kernel
def cover_samples(
    samples: wp.array[wp.vec3],  # (B P N,) on the surfaces [m]
    posed: PartArrays,
    num_samples: int,  # N
    seen: wp.array[float],  # (B P N,) 0 where another ellipsoid covers the sample, else 1  OUTPUT
):
    i = wp.tid()
    own = i // num_samples
    first = own // posed.count * posed.count
    outside = float(1.0)
    for k in range(first, first + posed.count):
        if k != own and radius(samples[i], posed.centres[k], posed.axes[k], posed.semi_axes[k]) < 1.0:
            outside = 0.0
    seen[i] = outside


@wp.kernel
def place_cells(
    vertices: wp.array[wp.vec3],  # (B V,) [m]
    cell_vertices: wp.array[int],  # (M,) vertex of the model that each cell vertex is
    cell_parts: wp.array[int],  # (M,) part 0 to 19 of each cell vertex
    origins: wp.array[wp.vec3],  # (B P,) of the cells, less the body's position [m]
    num_vertices: int,
    num_parts: int,
    points: wp.array[wp.vec3],  # (B M,) [m]  OUTPUT
):
    i = wp.tid()
    body = i // cell_vertices.shape[0]
    m = i - body * cell_vertices.shape[0]
    points[i] = vertices[body * num_vertices + cell_vertices[m]] + origins[body * num_parts + cell_parts[m]]


@wp.kernel
def closest_on_cells(
    mesh: wp.uint64,
    samples: wp.array[wp.vec3],  # (B P N,) [m]
    seen: wp.array[float],  # (B P N,)
    origins: wp.array[wp.vec3],  # (B P,) [m]
    num_samples: int,
    faces_per_body: int,
    max_distance: float,
    faces: wp.array[int],  # (B P N,) face of the cells' mesh of one body, -1 = none near  OUTPUT
    places: wp.array[wp.vec3],  # (B P N,) barycentric coordinates  OUTPUT
):
    i = wp.tid()
    faces[i] = -1
    places[i] = wp.vec3(1.0, 0.0, 0.0)
    if seen[i] > 0.0:
        found = wp.mesh_query_point_no_sign(mesh, samples[i] + origins[i // num_samples], max_distance)
        if found.result:
            faces[i] = found.face % faces_per_body
            places[i] = wp.vec3(found.u, found.v, 1.0 - found.u - found.v)


@wp.kernel
def vertex_costs(
    vertices: wp.array[wp.vec3],  # (B V,) [m]
    parts: wp.array[int],  # (V,) part 0 to 19 of each vertex
    areas: wp.array[float],  # (V,) weight of each vertex
    posed: PartArrays,
    band: float,  # share of its bone's length, from the middle, where a vertex is drawn to its own ellipsoid
    scale: float,  # [m] distance from which on it is drawn ever less
    fit: wp.array[float],  # (B V,) [m²]  OUTPUT
    penetration: wp.array[float],  # (B V,)  OUTPUT
    fit_gradient: wp.array[wp.vec3],  # (B V,)  OUTPUT
    penetration_gradient: wp.array[wp.vec3],  # (B V,)  OUTPUT
):
    """One thread a vertex: its distance from its own ellipsoid, and eq. 18 over all 20."""
    i = wp.tid()
    num_vertices = parts.shape[0]
    body = i // num_vertices
    v = i - body * num_vertices
    point = vertices[i]
    area = areas[v]
    first = body * posed.count
    fit_cost, inside_cost = float(0.0), float(0.0)
    fit_slope, inside_slope = wp.vec3(), wp.vec3()
    for k in range(first, first + posed.count):
        offset = point - posed.centres[k]
        size = posed.semi_axes[k]
        axes = posed.axes[k]
        own = k - first == parts[v]
        if own or wp.length_sq(offset) < wp.max(size) * wp.max(size):
            unit = wp.cw_div(wp.transpose(axes) * offset, size)
            e = wp.length(unit)
            # Of e; at the centre it has no direction, and any will do.
            towards = axes * wp.cw_div(unit, size) / wp.max(e, 1.0e-6)
            if e < 1.0:
                inside_cost += (1.0 - e) * (1.0 - e)
                inside_slope -= towards * (2.0 * (1.0 - e))
            if own and wp.abs(unit[0]) < band:
                # To first order; Geman and McClure's cost.
                steep = wp.max(wp.length(towards), 1.0e-6)
                distance = (e - 1.0) / steep
                share = 1.0 / (1.0 + distance * distance / (scale * scale))
                fit_cost += distance * distance * share
                # The steepness has a slope as well. Near the centre, where a vertex hardly comes, the sum has no bound.
                deep = wp.max(e, DEEP)
                bend = axes * wp.cw_div(wp.cw_div(unit, size), wp.cw_mul(size, size))
                slope = (towards * (2.0 * e - 1.0) - bend * ((e - 1.0) / (deep * steep * steep))) / deep
                fit_slope += slope * (2.0 * distance * share * share / steep)
    fit[i] = area * fit_cost
    penetration[i] = area * inside_cost
    fit_gradient[i] = fit_slope * area
    penetration_gradient[i] = inside_slope * area
