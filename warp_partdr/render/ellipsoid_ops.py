"""Exact ellipsoids under ``torch.compile``: custom operations, which it does not look into."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, cast

import torch

from ..interop.derivatives import once, raise_second_derivative
from ..interop.loss_graph import launch_label_loss, row_length
from .ellipsoid_passes import EllipsoidOptions, View, dense_gradient, draw, ellipsoid_recipe, gradients
from .options import Gradient, label_maps

_NUM_TENSORS = 4  # centres, axes, semi-axes, camera


def ellipsoid_numbers(view: View, options: EllipsoidOptions) -> tuple[list[int], bool, str, list[float]]:
    """Numbers of a view, but for its size, and of the options, as the custom operations take them."""
    numbers = [view.near, options.max_distance, options.depth_weight, options.samples_per_pixel]
    return list(view.labels), view.perspective, options.gradient, numbers


def _read(
    size: Sequence[int], labels: Sequence[int], perspective: bool, gradient: str, numbers: Sequence[float]
) -> tuple[View, EllipsoidOptions]:
    (height, width), (near, *rest) = size, numbers
    return View(height, width, near, perspective, tuple(labels)), EllipsoidOptions(cast(Gradient, gradient), *rest)


@torch.library.custom_op("warp_partdr::ellipsoid_maps", mutates_args=())
def _maps_op(
    centres: torch.Tensor,
    axes: torch.Tensor,
    semi_axes: torch.Tensor,
    camera: torch.Tensor,
    shape: Sequence[int],  # K, H, W
    labels: Sequence[int],
    perspective: bool,
    gradient: str,
    numbers: Sequence[float],
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    num_maps, *size = shape
    view, _ = _read(size, labels, perspective, gradient, numbers)
    picture = draw((centres, axes, semi_axes, camera), view)
    return label_maps(picture.labels, num_maps), picture.labels, picture.depth, picture.parts


@_maps_op.register_fake
def _(centres: Any, axes: Any, semi_axes: Any, camera: Any, shape: Sequence[int], *rest: Any) -> Any:
    batch, (num_maps, height, width) = centres.shape[0], shape
    image = (batch, height, width)
    labels, parts = (centres.new_empty(image, dtype=torch.uint8) for _ in range(2))
    return centres.new_empty(batch, num_maps, height, width), labels, centres.new_empty(image), parts


@torch.library.custom_op("warp_partdr::ellipsoid_maps_backward", mutates_args=())
def _maps_backward_op(
    centres: torch.Tensor,
    axes: torch.Tensor,
    semi_axes: torch.Tensor,
    camera: torch.Tensor,
    grad_maps: torch.Tensor,
    labels: Sequence[int],
    perspective: bool,
    gradient: str,
    numbers: Sequence[float],
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    view, options = _read(grad_maps.shape[2:], labels, perspective, gradient, numbers)
    tensors = (centres, axes, semi_axes, camera)
    # Drawn again: what the gradient needs of the picture is no tensor, and drawing is the smaller part.
    found = gradients(tensors, draw(tensors, view), view, options, dense_gradient(grad_maps))
    return found[0], found[1], found[2], found[3]


@_maps_backward_op.register_fake
def _(*arguments: Any) -> Any:
    return tuple(torch.empty_like(tensor, memory_format=torch.contiguous_format) for tensor in arguments[:_NUM_TENSORS])


def _save_maps(ctx: Any, inputs: Any, output: Any) -> None:
    ctx.save_for_backward(*inputs[:_NUM_TENSORS])
    ctx.numbers = inputs[_NUM_TENSORS + 1 :]


def _backward_maps(ctx: Any, *incoming: torch.Tensor) -> Any:
    found = torch.ops.warp_partdr.ellipsoid_maps_backward(*ctx.saved_tensors, incoming[0], *ctx.numbers)
    return *found, None, *([None] * len(ctx.numbers))


_maps_op.register_autograd(_backward_maps, setup_context=_save_maps)
_maps_backward_op.register_autograd(lambda ctx, *grads: raise_second_derivative("draw_ellipsoids"))


@torch.library.custom_op("warp_partdr::ellipsoid_label_loss", mutates_args=())
def _loss_op(
    centres: torch.Tensor,
    axes: torch.Tensor,
    semi_axes: torch.Tensor,
    camera: torch.Tensor,
    target: torch.Tensor,
    needs_grad: bool,
    labels: Sequence[int],
    perspective: bool,
    gradient: str,
    numbers: Sequence[float],
) -> tuple[torch.Tensor, torch.Tensor]:
    view, options = _read(target.shape[1:], labels, perspective, gradient, numbers)
    return launch_label_loss(ellipsoid_recipe(view, options), needs_grad, (centres, axes, semi_axes, camera), target)


@_loss_op.register_fake
def _(centres: Any, axes: Any, semi_axes: Any, camera: Any, target: Any, needs_grad: bool, *rest: Any) -> Any:
    batch = centres.shape[0]
    length = row_length(tuple(tensor.shape for tensor in (centres, axes, semi_axes, camera)))
    return centres.new_empty(batch), centres.new_empty(2 if needs_grad else 1, batch, length)


def _save_loss(ctx: Any, inputs: Any, output: Any) -> None:
    ctx.save_for_backward(output[1], *inputs[:_NUM_TENSORS])
    ctx.num_others = len(inputs) - _NUM_TENSORS


def _backward_loss(ctx: Any, grad_loss: torch.Tensor, grad_rows: torch.Tensor) -> Any:
    rows, *tensors = ctx.saved_tensors
    parts = (rows[1] * grad_loss[:, None]).split([math.prod(tensor.shape[1:]) for tensor in tensors], dim=1)
    found = tuple(part.reshape(tensor.shape) for part, tensor in zip(parts, tensors, strict=True))
    return *once("ellipsoid_label_loss", found, grad_loss, *tensors), *([None] * ctx.num_others)


_loss_op.register_autograd(_backward_loss, setup_context=_save_loss)
