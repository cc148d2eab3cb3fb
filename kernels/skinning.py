"""Vertices carried by affine maps of their own, as linear blend skinning has them, and the adjoint; both precisions.

Of float32, and where each vertex follows few joints, its map is blended where it is needed and written nowhere.
"""

from typing import Any

import warp as wp

from .lanes import num_lanes, sum_lanes
from .sparse import SparseRows

wp.set_module_options({"enable_backward": False})


@wp.kernel
def carry_vertices(
    maps: wp.array3d[Any],  # (B, 12, V) rows of each vertex's 3 x 4 matrix, vertices last
    rest: wp.array3d[Any],  # (B, V, 3)
    carried: wp.array3d[Any],  # (B, V, 3)  OUTPUT
):
    """One thread a vertex of a body."""
    b, v = wp.tid()
    for i in range(3):
        place = maps[b, 4 * i + 3, v]
        for c in range(3):
            place += maps[b, 4 * i + c, v] * rest[b, v, c]
        carried[b, v, i] = place


@wp.kernel
def carry_vertices_adjoint(
    maps: wp.array3d[Any],
    rest: wp.array3d[Any],
    adj_carried: wp.array3d[Any],  # (B, V, 3)
    grad_maps: wp.array3d[Any],  # (B, 12, V)  OUTPUT
    grad_rest: wp.array3d[Any],  # (B, V, 3)  OUTPUT
):
    """One thread a vertex of a body."""
    b, v = wp.tid()
    for c in range(3):
        pull = maps[b, c, v] * adj_carried[b, v, 0]
        for i in range(1, 3):
            pull += maps[b, 4 * i + c, v] * adj_carried[b, v, i]
        grad_rest[b, v, c] = pull
        for i in range(3):
            grad_maps[b, 4 * i + c, v] = adj_carried[b, v, i] * rest[b, v, c]
    for i in range(3):
        grad_maps[b, 4 * i + 3, v] = adj_carried[b, v, i]


@wp.func
def blend_maps(weights: SparseRows, maps: wp.array3d[float], b: int, v: int):
    """The map of a vertex: columns of its turn as rows, and its move."""
    columns, move = wp.mat33(), wp.vec3()
    for k in range(weights.starts[v], weights.starts[v + 1]):
        joint, weight = weights.columns[k], weights.values[k]
        for i in range(3):
            for c in range(3):
                columns[c, i] += weight * maps[b, 4 * i + c, joint]
            move[i] += weight * maps[b, 4 * i + 3, joint]
    return columns, move


@wp.kernel
def blend_vertices(
    weights: SparseRows,  # of joints, by vertices
    maps: wp.array3d[float],  # (B, 12, J) rows of each joint's 3 x 4 matrix
    rest: wp.array2d[wp.vec3],  # (B, V)
    carried: wp.array2d[wp.vec3],  # (B, V)  OUTPUT
):
    """One thread a vertex of a body."""
    b, v = wp.tid()
    columns, place = blend_maps(weights, maps, b, v)
    for c in range(3):
        place += rest[b, v][c] * columns[c]
    carried[b, v] = place


@wp.kernel
def blend_vertices_adjoint(
    weights: SparseRows,
    maps: wp.array3d[float],
    adj_carried: wp.array2d[wp.vec3],  # (B, V)
    grad_rest: wp.array2d[wp.vec3],  # (B, V)  OUTPUT
):
    """One thread a vertex of a body."""
    b, v = wp.tid()
    columns, _ = blend_maps(weights, maps, b, v)
    grad_rest[b, v] = columns * adj_carried[b, v]


@wp.kernel
def blend_maps_adjoint(
    vertices: SparseRows,  # weights of vertices, by joints
    rest: wp.array2d[wp.vec3],
    adj_carried: wp.array2d[wp.vec3],
    lanes: int,
    grad_maps: wp.array3d[float],  # (B, 12, J)  OUTPUT
):
    """A warp a joint of a body on CUDA."""
    thread = wp.tid()
    place = thread // lanes
    lane = thread - place * lanes
    b = place // grad_maps.shape[2]
    joint = place - b * grad_maps.shape[2]
    turn, move = wp.mat33(), wp.vec3()
    k = vertices.starts[joint] + lane
    while k < vertices.starts[joint + 1]:
        v = vertices.columns[k]
        pull = vertices.values[k] * adj_carried[b, v]
        turn += wp.outer(pull, rest[b, v])
        move += pull
        k += lanes
    for i in range(3):
        for c in range(3):
            turn[i, c] = sum_lanes(turn[i, c])
        move[i] = sum_lanes(move[i])
    if lane == 0:
        for i in range(3):
            for c in range(3):
                grad_maps[b, 4 * i + c, joint] = turn[i, c]
            grad_maps[b, 4 * i + 3, joint] = move[i]


for scalar in (wp.float32, wp.float64):  # up front: an overload that appears later would compile the module again
    wp.overload(carry_vertices, [wp.array3d[scalar]] * 3)
    wp.overload(carry_vertices_adjoint, [wp.array3d[scalar]] * 5)


def launch_carry(maps: wp.array, rest: wp.array, carried: wp.array) -> None:
    """Fill ``carried``."""
    wp.launch(carry_vertices, carried.shape[:2], [maps, rest, carried], device=carried.device)


def launch_carry_adjoint(
    maps: wp.array, rest: wp.array, adjoint: wp.array, grad_maps: wp.array, grad_rest: wp.array
) -> None:
    """Fill gradients with respect to maps and rest from the ``adjoint`` of what ``launch_carry`` filled."""
    inputs = [maps, rest, adjoint, grad_maps, grad_rest]
    wp.launch(carry_vertices_adjoint, adjoint.shape[:2], inputs, device=adjoint.device)


def launch_blend(weights: Any, maps: wp.array, rest: wp.array, carried: wp.array) -> None:
    """Fill ``carried`` by joints' maps and the rows of ``weights``."""
    wp.launch(blend_vertices, carried.shape, [weights, maps, rest, carried], device=carried.device)


def launch_blend_adjoint(
    weights: tuple[Any, Any], maps: wp.array, rest: wp.array, adjoint: wp.array, gradients: tuple[wp.array, wp.array]
) -> None:
    """Fill ``gradients`` with respect to maps and rest from the ``adjoint`` of what ``launch_blend`` filled.

    Args:
        weights: Skin weights by vertices, and by joints.
        maps: Maps of joints that ``launch_blend`` was given.
        rest: Vertices at rest that ``launch_blend`` was given.
        adjoint: Adjoint of the vertices that ``launch_blend`` filled.
        gradients: Gradients of maps and rest. They are filled.
    """
    (rows, columns), (grad_maps, grad_rest) = weights, gradients
    wp.launch(blend_vertices_adjoint, adjoint.shape, [rows, maps, adjoint, grad_rest], device=adjoint.device)
    lanes = num_lanes(adjoint.device)
    inputs = [columns, rest, adjoint, lanes, grad_maps]
    wp.launch(blend_maps_adjoint, maps.shape[0] * maps.shape[2] * lanes, inputs, device=adjoint.device)
