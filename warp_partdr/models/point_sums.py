"""Points that are sums of a few vertices and joints, as landmarks are, by kernels, with gradients for torch."""

from __future__ import annotations

from functools import partial
from typing import Any

import torch
from warp import vec3

from ..interop.arrays import warp_array
from ..interop.captured_function import Fixed, call_captured
from ..interop.derivatives import once
from ..interop.graph_cache import Launch
from ..interop.layouts import Tensors
from ..interop.sparse import sparse_matrix
from ..kernels import sparse as kernels


def sum_points(weights: torch.Tensor, vertices: torch.Tensor, joints: torch.Tensor) -> torch.Tensor:
    """Sums (B, L, 3) of vertices (B, V, 3) and then joints (B, J, 3) by fixed weights (L, V + J); float32."""
    found: torch.Tensor = _Summed.apply(weights, vertices, joints)
    return found


class _Summed(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, weights: torch.Tensor, vertices: torch.Tensor, joints: torch.Tensor) -> torch.Tensor:
        ctx.save_for_backward(weights, vertices, joints)
        shape = torch.Size((len(vertices), len(weights), 3))
        return call_captured(_prepare, (vertices, joints), (shape,), Fixed(weights))[0]

    @staticmethod
    def backward(ctx: Any, *adjoints: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        weights, vertices, joints = ctx.saved_tensors
        found = call_captured(_prepare_adjoint, adjoints, (vertices.shape, joints.shape), Fixed(weights))
        return None, *once("sum_points", found, *adjoints, vertices, joints)


def _prepare(inputs: Tensors, outputs: Tensors, weights: Fixed) -> Launch:
    """Launch that fills sums from vertices and joints."""
    points = [warp_array(each, vec3) for each in inputs]
    return partial(kernels.launch_sum_points, sparse_matrix(weights).rows, points, warp_array(outputs[0], vec3))


def _prepare_adjoint(inputs: Tensors, outputs: Tensors, weights: Fixed) -> Launch:
    """Launch that fills gradients of vertices and joints from the adjoint of the sums."""
    gradients = [warp_array(each, vec3) for each in outputs]
    adjoint = warp_array(inputs[0], vec3)
    return partial(kernels.launch_sum_points_adjoint, sparse_matrix(weights).columns, adjoint, gradients)
