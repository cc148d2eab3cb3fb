"""Linear blend skinning, by kernels or, to be differentiated again, by torch."""

from __future__ import annotations

from functools import partial

import torch
import warp as wp

from ..interop.arrays import warp_array, warp_arrays
from ..interop.captured_function import Fixed, call_captured
from ..interop.graph_cache import Launch
from ..interop.layouts import Tensors
from ..interop.operation import Gradients, OperationWithTwin
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
    if rows.is_cuda and fixed:
        return carry_sparsely(weights, rows, vertices)
    # The CPU is faster at one product of dense matrices, for all bodies.
    return _Carried()(torch.nn.functional.linear(rows, weights), vertices)[0]


def _carry(maps: torch.Tensor, vertices: torch.Tensor) -> torch.Tensor:
    *columns, carried = maps.unflatten(1, (3, 4)).unbind(2)
    for column, coordinate in zip(columns, vertices.mT.unsqueeze(2).unbind(1), strict=True):
        carried = torch.addcmul(carried, column, coordinate)
    return carried.mT.contiguous()


def carry_sparsely(weights: torch.Tensor, rows: torch.Tensor, vertices: torch.Tensor) -> torch.Tensor:
    """Vertices as in ``carry_skin``, float32, by fixed weights, most of which are zero."""
    return _Blended()(rows, vertices, weights)[0]


class _Blended(OperationWithTwin):
    def forward(self, inputs: Tensors) -> tuple[Tensors, Tensors]:
        rows, vertices, weights = inputs
        return call_captured(_prepare_blend, (rows, vertices), (vertices.shape,), Fixed(weights)), ()

    def adjoint(self, saved: Tensors, adjoints: Tensors) -> Gradients:
        rows, vertices, weights = saved
        given, shapes = (rows, vertices, *adjoints), (rows.shape, vertices.shape)
        return call_captured(_prepare_blend_adjoint, given, shapes, Fixed(weights))

    def plain(self, inputs: Tensors) -> Tensors:
        rows, vertices, weights = inputs
        return (_carry(torch.nn.functional.linear(rows, weights), vertices),)


def _prepare_blend(inputs: Tensors, outputs: Tensors, weights: Fixed) -> Launch:
    """Launch that fills carried vertices from joints' maps and vertices."""
    maps, rest = warp_arrays(inputs, (None, wp.vec3))
    return partial(kernels.launch_blend, sparse_matrix(weights).rows, maps, rest, warp_array(outputs[0], wp.vec3))


def _prepare_blend_adjoint(inputs: Tensors, outputs: Tensors, weights: Fixed) -> Launch:
    """Launch that fills gradients of joints' maps and vertices from these and the adjoint of what was carried."""
    maps, rest, adjoint = warp_arrays(inputs, (None, wp.vec3, wp.vec3))
    grad_maps, grad_rest = warp_arrays(outputs, (None, wp.vec3))
    return partial(kernels.launch_blend_adjoint, sparse_matrix(weights), maps, rest, adjoint, (grad_maps, grad_rest))


class _Carried(OperationWithTwin):
    def forward(self, inputs: Tensors) -> tuple[Tensors, Tensors]:
        return call_captured(_prepare, inputs, (inputs[1].shape,)), ()

    def adjoint(self, saved: Tensors, adjoints: Tensors) -> Gradients:
        maps, vertices = saved
        return call_captured(_prepare_adjoint, (maps, vertices, *adjoints), (maps.shape, vertices.shape))

    def plain(self, inputs: Tensors) -> Tensors:
        maps, vertices = inputs
        return (_carry(maps, vertices),)


def _prepare(inputs: Tensors, outputs: Tensors) -> Launch:
    """Launch that fills carried vertices from maps and vertices."""
    return partial(kernels.launch_carry, *map(warp_array, (*inputs, *outputs)))


def _prepare_adjoint(inputs: Tensors, outputs: Tensors) -> Launch:
    """Launch that fills gradients of maps and vertices from these and the adjoint of what was carried."""
    return partial(kernels.launch_carry_adjoint, *map(warp_array, (*inputs, *outputs)))
