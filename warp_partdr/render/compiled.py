"""Both renderers under ``torch.compile``: custom operations, whose bodies are the captured graphs of eager calls."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch

from ..interop.arrays import same_memory
from ..interop.custom_operations import register_gradient, register_operation
from ..interop.derivatives import once, raise_second_derivative
from ..interop.layouts import row_length
from ..interop.loss_graph import find_numbers
from .body_passes import BodyPasses
from .ellipsoid_passes import EllipsoidPasses
from .mesh_passes import MeshPasses
from .options import label_maps
from .pictures import Picture

_SETTINGS = "int[] integers, str gradient, float[] numbers"


def _register(
    name: str, kind: type[MeshPasses | EllipsoidPasses | BodyPasses], num_inputs: int, nearest: torch.dtype | None
) -> None:
    """Register the operations of a renderer, whose index of the nearest has the dtype ``nearest`` if it has one.

    Of ``tensors``, the first are its inputs, the others its constants.
    """

    def maps(
        tensors: Sequence[torch.Tensor], shape: Sequence[int], *settings: Any
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        num_maps, height, width = shape
        passes = kind.of(same_memory(tensors[num_inputs:]), *settings)
        labels, depth, nearest, faults, _ = passes.draw(tuple(tensors[:num_inputs]), (height, width))
        faults = faults.clone()  # it may lie in one block with the labels, and results must not share memory
        return label_maps(labels, num_maps, faults), labels, depth, nearest, faults

    def empty_maps(tensors: Sequence[Any], shape: Sequence[int], *settings: Any) -> Any:
        first, (num_maps, *size) = tensors[0], shape
        batch = first.shape[0]
        labels = first.new_empty(batch, *size, dtype=torch.uint8)
        if nearest is None:
            others = labels.new_empty(0), labels.new_empty(0)
        else:
            others = first.new_empty(batch, *size), first.new_empty(batch, *size, dtype=nearest)
        return first.new_empty(batch, num_maps, *size), labels, *others, first.new_empty(batch)

    def save_maps(ctx: Any, inputs: Any, output: Any) -> None:
        tensors, _, *ctx.settings = inputs
        ctx.save_for_backward(*tensors, *output[1:])

    def backward_maps(ctx: Any, grad_maps: torch.Tensor, *rest: Any) -> Any:
        *tensors, labels, depth, nearest, faults = ctx.saved_tensors
        gradients = getattr(torch.ops.warp_partdr, f"{name}_maps_backward")
        grads = gradients(tensors, [labels, depth, nearest, faults, grad_maps], *ctx.settings)
        return [*grads, *[None] * (len(tensors) - num_inputs)], *[None] * 4

    def maps_backward(
        tensors: Sequence[torch.Tensor], picture: Sequence[torch.Tensor], *settings: Any
    ) -> list[torch.Tensor]:
        *images, grad_maps = picture
        passes = kind.of(same_memory(tensors[num_inputs:]), *settings)
        found = passes.gradients(tuple(tensors[:num_inputs]), Picture(*images), grad_maps)
        own = empty_gradients(tensors)
        torch._foreach_copy_(own, found)  # they may lie in one tensor, which results of an operation must not
        return own

    def empty_gradients(tensors: Sequence[Any], *rest: Any) -> Any:
        return [torch.empty_like(each, memory_format=torch.contiguous_format) for each in tensors[:num_inputs]]

    def loss(
        tensors: Sequence[torch.Tensor], target: torch.Tensor, needs_grad: bool, *settings: Any
    ) -> tuple[torch.Tensor, torch.Tensor]:
        passes = kind.of(same_memory(tensors[num_inputs:]), *settings)
        return find_numbers(passes, needs_grad, tuple(tensors[:num_inputs]), target)

    def empty_loss(tensors: Sequence[Any], target: Any, needs_grad: bool, *settings: Any) -> Any:
        first, length = tensors[0], row_length(tuple([each.shape for each in tensors[:num_inputs]]))
        batch = first.shape[0]
        return first.new_empty(batch), first.new_empty((2 if needs_grad else 1) * batch * length)

    def save_loss(ctx: Any, inputs: Any, output: Any) -> None:
        ctx.num_tensors = len(inputs[0])
        ctx.save_for_backward(output[1], *inputs[0][:num_inputs])

    def backward_loss(ctx: Any, grad_loss: torch.Tensor, grad_numbers: torch.Tensor) -> Any:
        numbers, *inputs = ctx.saved_tensors
        batch, shapes = grad_loss.shape[0], tuple([each.shape for each in inputs])
        length = row_length(shapes)
        rows = numbers[batch * length :].view(batch, length) * grad_loss[:, None]
        parts = rows.split([math.prod(shape[1:]) for shape in shapes], dim=1)
        found = tuple([part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)])
        grads = once(kind.name, found, grad_loss, *inputs)
        return [*grads, *[None] * (ctx.num_tensors - num_inputs)], *[None] * 5

    register_operation(
        f"{name}_maps_backward(Tensor[] tensors, Tensor[] picture, {_SETTINGS}) -> Tensor[]",
        maps_backward,
        empty_gradients,
    )
    register_gradient(f"{name}_maps_backward", lambda ctx, *grads: raise_second_derivative(kind.drawing))
    register_operation(
        f"{name}_maps(Tensor[] tensors, SymInt[] shape, {_SETTINGS}) -> (Tensor, Tensor, Tensor, Tensor, Tensor)",
        maps,
        empty_maps,
    )
    register_gradient(f"{name}_maps", backward_maps, save_maps)
    register_operation(
        f"{name}_label_loss(Tensor[] tensors, Tensor target, bool needs_grad, {_SETTINGS}) -> (Tensor, Tensor)",
        loss,
        empty_loss,
    )
    register_gradient(f"{name}_label_loss", backward_loss, save_loss)


_register("mesh", MeshPasses, 1, torch.int32)
_register("ellipsoid", EllipsoidPasses, 4, torch.uint8)
_register("body", BodyPasses, 7, None)
