"""Points that are sums of a few vertices and joints, as landmarks are, by kernels, with gradients for torch."""

from __future__ import annotations

from functools import partial

import torch
from warp import vec3

from ..interop.arrays import warp_array
from ..interop.captured_function import Fixed, call_captured
from ..interop.graph_cache import Launch
from ..interop.layouts import Tensors
from ..interop.operation import Gradients, Operation
from ..interop.sparse import sparse_matrix
from ..kernels import sparse as kernels


def sum_points(weights: torch.Tensor, vertices: torch.Tensor, joints: torch.Tensor) -> torch.Tensor:
    """Sums (B, L, 3) of vertices (B, V, 3) and then joints (B, J, 3) by fixed weights (L, V + J); float32."""
    return _Summed()(vertices, joints, weights)[0]


class _Summed(Operation):
    name = "sum_points"

    def forward(self, inputs: Tensors) -> tuple[Tensors, Tensors]:
        vertices, joints, weights = inputs
        shape = torch.Size((len(vertices), len(weights), 3))
        return call_captured(_prepare, (vertices, joints), (shape,), Fixed(weights)), ()

    def adjoint(self, saved: Tensors, adjoints: Tensors) -> Gradients:
        vertices, joints, weights = saved
        return call_captured(_prepare_adjoint, adjoints, (vertices.shape, joints.shape), Fixed(weights))


def _prepare(inputs: Tensors, outputs: Tensors, weights: Fixed) -> Launch:
    """Launch that fills sums from vertices and joints."""
    points = [warp_array(each, vec3) for each in inputs]
    return partial(kernels.launch_sum_points, sparse_matrix(weights).rows, points, warp_array(outputs[0], vec3))


def _prepare_adjoint(inputs: Tensors, outputs: Tensors, weights: Fixed) -> Launch:
    """Launch that fills gradients of vertices and joints from the adjoint of the sums."""
    gradients = [warp_array(each, vec3) for each in outputs]
    adjoint = warp_array(inputs[0], vec3)
    return partial(kernels.launch_sum_points_adjoint, sparse_matrix(weights).columns, adjoint, gradients)
