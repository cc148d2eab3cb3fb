"""Vertices carried by affine maps of their own, as linear blend skinning has them, and the adjoint; both precisions."""

from typing import Any

import warp as wp

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
