"""Both renderers under ``torch.compile``: custom operations, which it does not look into."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, List  # noqa: UP035  torch 2.6 knows no list[torch.Tensor] as a result

import torch

from ..interop.derivatives import once, raise_second_derivative
from ..interop.layouts import row_length
from ..interop.loss_graph import gradient_rows, launch_label_loss
from .ellipsoid_passes import EllipsoidPasses
from .mesh_passes import MeshPasses
from .options import label_maps
from .pictures import Picture


def _register(kind: type[MeshPasses | EllipsoidPasses], num_inputs: int, index: torch.dtype) -> None:
    """Register the operations of a renderer; of ``tensors``, the first are its inputs, the others its constants."""

    def maps(
        tensors: Sequence[torch.Tensor],
        shape: Sequence[int],  # K, H, W
        integers: Sequence[int],
        gradient: str,
        numbers: Sequence[float],
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        num_maps, height, width = shape
        passes = kind.of(tensors[num_inputs:], integers, gradient, numbers)
        labels, depth, nearest, faults, _ = passes.draw(tuple(tensors[:num_inputs]), (height, width))
        return label_maps(labels, num_maps, faults), labels, depth, nearest, faults

    def empty_maps(tensors: Sequence[Any], shape: Sequence[int], *settings: Any) -> Any:
        first, (num_maps, *size) = tensors[0], shape
        images = (first.new_empty(len(first), *size, dtype=each) for each in (torch.uint8, torch.float32, index))
        return first.new_empty(len(first), num_maps, *size), *images, first.new_empty(len(first))

    def save_maps(ctx: Any, inputs: Any, output: Any) -> None:
        tensors, _, *ctx.settings = inputs
        ctx.save_for_backward(*tensors, *output[1:])

    def backward_maps(ctx: Any, grad_maps: torch.Tensor, *rest: Any) -> Any:
        *tensors, labels, depth, nearest, faults = ctx.saved_tensors
        grads = maps_backward_op(tensors, [labels, depth, nearest, faults, grad_maps], *ctx.settings)
        return [*grads, *[None] * (len(tensors) - num_inputs)], *[None] * 4

    def maps_backward(
        tensors: Sequence[torch.Tensor],
        picture: Sequence[torch.Tensor],  # its images, and the gradient with respect to its maps
        integers: Sequence[int],
        gradient: str,
        numbers: Sequence[float],
    ) -> List[torch.Tensor]:  # noqa: UP006
        *images, grad_maps = picture
        passes = kind.of(tensors[num_inputs:], integers, gradient, numbers)
        return list(passes.gradients(tuple(tensors[:num_inputs]), Picture(*images), grad_maps))

    def empty_gradients(tensors: Sequence[Any], *rest: Any) -> Any:
        return [torch.empty_like(each, memory_format=torch.contiguous_format) for each in tensors[:num_inputs]]

    def loss(
        tensors: Sequence[torch.Tensor],
        target: torch.Tensor,
        needs_grad: bool,
        integers: Sequence[int],
        gradient: str,
        numbers: Sequence[float],
    ) -> tuple[torch.Tensor, torch.Tensor]:
        passes = kind.of(tensors[num_inputs:], integers, gradient, numbers)
        return launch_label_loss(passes, needs_grad, tuple(tensors[:num_inputs]), target)

    def empty_loss(tensors: Sequence[Any], target: Any, needs_grad: bool, *settings: Any) -> Any:
        first, length = tensors[0], row_length(tuple(each.shape for each in tensors[:num_inputs]))
        return first.new_empty(len(first)), first.new_empty((2 if needs_grad else 1) * len(first) * length)

    def save_loss(ctx: Any, inputs: Any, output: Any) -> None:
        ctx.num_tensors = len(inputs[0])
        ctx.save_for_backward(output[1], *inputs[0][:num_inputs])

    def backward_loss(ctx: Any, grad_loss: torch.Tensor, grad_rows: torch.Tensor) -> Any:
        numbers, *inputs = ctx.saved_tensors
        parts = (gradient_rows(numbers, len(grad_loss)) * grad_loss[:, None]).split(
            [math.prod(each.shape[1:]) for each in inputs], dim=1
        )
        found = tuple(part.reshape(each.shape) for part, each in zip(parts, inputs, strict=True))
        grads = once(kind.name, found, grad_loss, *inputs)
        return [*grads, *[None] * (ctx.num_tensors - num_inputs)], *[None] * 5

    def operation(name: str, function: Callable[..., Any], fake: Callable[..., Any]) -> Any:
        made = torch.library.custom_op(f"warp_partdr::{kind.kind}_{name}", function, mutates_args=())
        made.register_fake(fake)
        return made

    maps_backward_op = operation("maps_backward", maps_backward, empty_gradients)
    maps_backward_op.register_autograd(lambda ctx, *grads: raise_second_derivative(kind.drawing))
    operation("maps", maps, empty_maps).register_autograd(backward_maps, setup_context=save_maps)
    operation("label_loss", loss, empty_loss).register_autograd(backward_loss, setup_context=save_loss)


_register(MeshPasses, 1, torch.int32)
_register(EllipsoidPasses, 4, torch.uint8)
