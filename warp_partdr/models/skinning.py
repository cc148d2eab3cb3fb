"""Linear blend skinning, by kernels or, to be differentiated again, by torch."""

from __future__ import annotations

from functools import partial
from typing import Any

import torch
import warp as wp

from ..interop.arrays import warp_array
from ..interop.captured_function import Fixed, call_captured
from ..interop.derivatives import differentiate_again, is_transformed
from ..interop.graph_cache import Launch
from ..interop.layouts import Tensors
from ..interop.sparse import sparse_matrix
from ..kernels import skinning as kernels


def blend_skin(
    weights: torch.Tensor, maps: torch.Tensor, places: torch.Tensor, rest: torch.Tensor, vertices: torch.Tensor
) -> torch.Tensor:
    """Vertices (B, V, 3) that follow maps (B, N, 3, 3) of ``rest`` to ``places``, (B, N, 3), by weights (V, N)."""
    return carry_skin(weights, map_rows(maps, places, rest), vertices)


def map_rows(maps: torch.Tensor, places: torch.Tensor, rest: torch.Tensor) -> torch.Tensor:
    """Maps (B, N, 3, 3) of ``rest`` to ``places``, (B, N, 3), by rows of 3 x 4 matrices, shape (B, 12, N)."""
    moves = places - (maps * rest[..., None, :]).sum(-1)
    # Vertices come last, for sums over three or four numbers of each are slow where these lie side by side.
    return torch.cat([maps, moves[..., None]], dim=-1).flatten(2).mT.contiguous()


def carry_skin(weights: torch.Tensor, rows: torch.Tensor, vertices: torch.Tensor) -> torch.Tensor:
    """Vertices (B, V, 3) that follow maps, as ``map_rows`` gives them, by weights (V, N)."""
    fixed = rows.dtype == vertices.dtype == weights.dtype == torch.float32 and not weights.requires_grad
    # The CPU is faster at one product of dense matrices.
    if rows.is_cuda and fixed and not torch.compiler.is_compiling() and not is_transformed(rows, vertices, weights):
        return carry_sparsely(weights, rows, vertices)
    own = torch.nn.functional.linear(rows, weights)  # one product for all bodies
    if torch.compiler.is_compiling() or is_transformed(own, vertices):
        return _carry(own, vertices)
    carried: torch.Tensor = _Carried.apply(own, vertices)
    return carried


def _carry(maps: torch.Tensor, vertices: torch.Tensor) -> torch.Tensor:
    *columns, carried = maps.unflatten(1, (3, 4)).unbind(2)
    for column, coordinate in zip(columns, vertices.mT.unsqueeze(2).unbind(1), strict=True):
        carried = torch.addcmul(carried, column, coordinate)
    return carried.mT.contiguous()


def _blend(weights: torch.Tensor, rows: torch.Tensor, vertices: torch.Tensor) -> torch.Tensor:
    return _carry(torch.nn.functional.linear(rows, weights), vertices)


def carry_sparsely(weights: torch.Tensor, rows: torch.Tensor, vertices: torch.Tensor) -> torch.Tensor:
    """Vertices as in ``carry_skin``, float32, by fixed weights, most of which are zero."""
    blended: torch.Tensor = _Blended.apply(rows, vertices, weights)
    return blended


class _Blended(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, rows: torch.Tensor, vertices: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
        ctx.save_for_backward(rows, vertices, weights)
        return call_captured(_prepare_blend, (rows, vertices), (vertices.shape,), Fixed(weights))[0]

    @staticmethod
    def backward(ctx: Any, *adjoints: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        rows, vertices, weights = ctx.saved_tensors
        if torch.is_grad_enabled():
            again = differentiate_again(partial(_blend, weights), (rows, vertices), adjoints[0])
            return *again, None
        given, shapes = (rows, vertices, adjoints[0]), (rows.shape, vertices.shape)
        return *call_captured(_prepare_blend_adjoint, given, shapes, Fixed(weights)), None


def _prepare_blend(inputs: Tensors, outputs: Tensors, weights: Fixed) -> Launch:
    """Launch that fills carried vertices from joints' maps and vertices."""
    maps, rest = warp_array(inputs[0]), warp_array(inputs[1], wp.vec3)
    return partial(kernels.launch_blend, sparse_matrix(weights).rows, maps, rest, warp_array(outputs[0], wp.vec3))


def _prepare_blend_adjoint(inputs: Tensors, outputs: Tensors, weights: Fixed) -> Launch:
    """Launch that fills gradients of joints' maps and vertices from these and the adjoint of what was carried."""
    maps, (rest, adjoint, grad_rest) = (
        warp_array(inputs[0]),
        (warp_array(t, wp.vec3) for t in (*inputs[1:], outputs[1])),
    )
    found = warp_array(outputs[0]), grad_rest
    return partial(kernels.launch_blend_adjoint, sparse_matrix(weights), maps, rest, adjoint, found)


class _Carried(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, maps: torch.Tensor, vertices: torch.Tensor) -> torch.Tensor:
        ctx.save_for_backward(maps, vertices)
        return call_captured(_prepare, (maps, vertices), (vertices.shape,))[0]

    @staticmethod
    def backward(ctx: Any, *adjoints: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        maps, vertices = ctx.saved_tensors
        if torch.is_grad_enabled():
            return differentiate_again(_carry, (maps, vertices), adjoints[0])
        return call_captured(_prepare_adjoint, (maps, vertices, adjoints[0]), (maps.shape, vertices.shape))


def _prepare(inputs: Tensors, outputs: Tensors) -> Launch:
    """Launch that fills carried vertices from maps and vertices."""
    return partial(kernels.launch_carry, *map(warp_array, (*inputs, *outputs)))


def _prepare_adjoint(inputs: Tensors, outputs: Tensors) -> Launch:
    """Launch that fills gradients of maps and vertices from these and the adjoint of what was carried."""
    return partial(kernels.launch_carry_adjoint, *map(warp_array, (*inputs, *outputs)))
