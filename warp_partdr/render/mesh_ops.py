"""The mesh renderer under ``torch.compile``: custom operations, which it does not look into."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch

from ..interop.derivatives import once, raise_second_derivative
from ..interop.loss_graph import launch_label_loss, row_length
from .mesh_passes import MeshOptions, draw_images, mesh_recipe, vertex_gradient
from .options import label_maps


def mesh_numbers(options: MeshOptions) -> tuple[bool, list[float]]:
    """Options as the custom operations take them."""
    return options.perspective, [options.near, options.max_distance, options.depth_weight]


def _options(perspective: bool, numbers: Sequence[float]) -> MeshOptions:
    near, max_distance, depth_weight = numbers
    return MeshOptions(near, perspective, max_distance, depth_weight)


@torch.library.custom_op("warp_partdr::mesh_maps", mutates_args=())
def _maps_op(
    vertices: torch.Tensor,
    faces: torch.Tensor,
    face_labels: torch.Tensor,
    edges: torch.Tensor,
    shape: Sequence[int],  # K, H, W
    perspective: bool,
    numbers: Sequence[float],
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    num_maps, height, width = shape
    geometry = vertices, faces, face_labels, edges
    images = draw_images(geometry, (height, width), _options(perspective, numbers))
    return label_maps(images[0], num_maps), *images


@_maps_op.register_fake
def _(vertices: Any, faces: Any, face_labels: Any, edges: Any, shape: Sequence[int], *rest: Any) -> Any:
    batch, (num_maps, height, width) = vertices.shape[0], shape
    image = (batch, height, width)
    return (
        vertices.new_empty(batch, num_maps, height, width),
        vertices.new_empty(image, dtype=torch.uint8),
        vertices.new_empty(image, dtype=torch.float32),
        vertices.new_empty(image, dtype=torch.int32),
    )


@torch.library.custom_op("warp_partdr::mesh_maps_backward", mutates_args=())
def _maps_backward_op(
    vertices: torch.Tensor,
    faces: torch.Tensor,
    face_labels: torch.Tensor,
    edges: torch.Tensor,
    labels: torch.Tensor,
    depth: torch.Tensor,
    face_index: torch.Tensor,
    grad_maps: torch.Tensor,
    perspective: bool,
    numbers: Sequence[float],
) -> torch.Tensor:
    geometry, images = (vertices, faces, face_labels, edges), (labels, depth, face_index)
    return vertex_gradient(geometry, images, grad_maps, _options(perspective, numbers))


@_maps_backward_op.register_fake
def _(vertices: Any, *rest: Any) -> Any:
    return torch.empty_like(vertices, memory_format=torch.contiguous_format)


def _save_maps(ctx: Any, inputs: Any, output: Any) -> None:
    *geometry, _, perspective, numbers = inputs
    ctx.save_for_backward(*geometry, *output[1:])
    ctx.options = perspective, numbers


def _backward_maps(ctx: Any, grad_maps: torch.Tensor, *rest: Any) -> Any:
    gradient = torch.ops.warp_partdr.mesh_maps_backward(*ctx.saved_tensors, grad_maps, *ctx.options)
    return gradient, *([None] * 6)


_maps_op.register_autograd(_backward_maps, setup_context=_save_maps)
_maps_backward_op.register_autograd(lambda ctx, grad: raise_second_derivative("draw_mesh"))


@torch.library.custom_op("warp_partdr::mesh_label_loss", mutates_args=())
def _loss_op(
    vertices: torch.Tensor,
    faces: torch.Tensor,
    face_labels: torch.Tensor,
    edges: torch.Tensor,
    target: torch.Tensor,
    needs_grad: bool,
    num_labels: int,
    perspective: bool,
    numbers: Sequence[float],
) -> tuple[torch.Tensor, torch.Tensor]:
    recipe = mesh_recipe(faces, face_labels, edges, num_labels, _options(perspective, numbers))
    return launch_label_loss(recipe, needs_grad, (vertices,), target)


@_loss_op.register_fake
def _(vertices: Any, faces: Any, face_labels: Any, edges: Any, target: Any, needs_grad: bool, *rest: Any) -> Any:
    batch = vertices.shape[0]
    return vertices.new_empty(batch), vertices.new_empty(2 if needs_grad else 1, batch, row_length((vertices.shape,)))


def _save_loss(ctx: Any, inputs: Any, output: Any) -> None:
    ctx.save_for_backward(output[1], inputs[0])


def _backward_loss(ctx: Any, grad_loss: torch.Tensor, grad_rows: torch.Tensor) -> Any:
    rows, vertices = ctx.saved_tensors
    found = ((rows[1] * grad_loss[:, None]).reshape(vertices.shape),)
    return *once("mesh_label_loss", found, grad_loss, vertices), *([None] * 8)


_loss_op.register_autograd(_backward_loss, setup_context=_save_loss)
