"""L_seg of a batch with its gradient: by a captured graph, or kernel by kernel if memory has no room for a graph."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from types import ModuleType
from typing import Any, Protocol

import torch

from .derivatives import once
from .graph_cache import BYTES_PER_PIXEL, CapturedBodies, graphs
from .layouts import Shapes, Tensors, row_length, row_views, split_blocks, split_rows
from .streams import launch_bodies_on


@dataclass(frozen=True)
class Buffers:
    """Inputs and outputs of a renderer's launches for B bodies.

    Attributes:
        numbers: Numbers of the inputs, one input after the other, then, if needed, of their gradients, as rows (B, R).
        inputs: Views of the inputs in ``numbers``, each of shape (B, ...).
        target: Target labels, shape (N, H, W), N = 1 or B, uint8; or the gradient with respect to part maps, shape
            (B, K, H, W), float32: then there is no loss.
        losses: Partial sums of L_seg, shape (B, M).
        grads: Views of the gradients in ``numbers``, with the inputs' shapes; empty if not needed.
    """

    numbers: torch.Tensor
    inputs: tuple[torch.Tensor, ...]
    target: torch.Tensor
    losses: torch.Tensor
    grads: tuple[torch.Tensor, ...]

    @classmethod
    def empty(cls, recipe: Recipe, shapes: Shapes, target: torch.Tensor, needs_grad: bool) -> Buffers:
        """Allocate buffers for inputs with these shapes."""
        batch, (*_, height, width), device = shapes[0][0], target.shape, target.device
        size = batch * row_length(shapes)
        numbers = torch.empty(size * (2 if needs_grad else 1), device=device)
        losses = torch.empty(batch, recipe.num_losses(device, batch, height, width), device=device)
        grads = split_rows(numbers, shapes, size) if needs_grad else ()
        return cls(numbers, split_blocks(numbers, shapes), target, losses, grads)

    @property
    def of_maps(self) -> bool:
        """True if the target is the gradient with respect to part maps."""
        return self.target.dim() == 4

    def of_bodies(self, part: slice) -> Buffers:
        """Return the buffers of a slice of the bodies."""
        return Buffers(
            self.numbers,
            tuple(tensor[part] for tensor in self.inputs),
            self.target if len(self.target) == 1 else self.target[part],
            self.losses[part],
            tuple(tensor[part] for tensor in self.grads),
        )


class Recipe(Protocol):
    """Launches of a renderer for loss and gradient. Recipes with equal options are equal: one is a graph's key."""

    def __hash__(self) -> int: ...

    name: str  # of the public function

    @property
    def modules(self) -> Sequence[ModuleType]:
        """Python modules with the kernels that it launches."""
        ...

    def num_losses(self, device: torch.device, batch: int, height: int, width: int) -> int:
        """Count the partial sums of a body's loss, M."""
        ...

    def prepare(self, buffers: Buffers) -> Callable[[], None]:
        """Allocate intermediate buffers; return a function that fills ``losses`` and ``grads`` and only launches."""
        ...


def find_label_loss(
    recipe: Recipe, tensors: tuple[torch.Tensor, ...], target: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Compute L_seg of a batch, and its gradient if one is needed.

    Args:
        recipe: Recipe of the renderer.
        tensors: Inputs of the loss, shapes (B, ...), on one device.
        target: Target labels, shape (N, H, W), N = 1 or B, uint8.

    Returns:
        The loss of each body, differentiable, shape (B,), and ``Buffers.numbers``, which begin with a copy of the
        tensors for ``split_blocks``.
    """
    needs_grad = torch.is_grad_enabled() and any(tensor.requires_grad for tensor in tensors)
    loss, numbers = find_numbers(recipe, needs_grad, tensors, target)
    if needs_grad:
        loss = LabelLoss.apply(recipe.name, (loss, numbers), *tensors)
    return loss, numbers


def find_gradients(recipe: Recipe, tensors: Tensors, grad_maps: torch.Tensor) -> Tensors:
    """Compute gradients with respect to the inputs from the gradient with respect to part maps, (B, K, H, W)."""
    _, numbers = find_numbers(recipe, True, tensors, grad_maps.float())
    return split_rows(numbers, tuple([tensor.shape for tensor in tensors]), numbers.numel() // 2)


@torch.no_grad()
def find_numbers(
    recipe: Recipe, needs_grad: bool, tensors: Tensors, target: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Compute loss and numbers, by a captured graph if memory has room and copying the target beats launching.

    Args:
        recipe: Recipe of the renderer.
        needs_grad: True if the gradient is wanted.
        tensors: Inputs of the loss, shapes (B, ...), on one device.
        target: Target labels, or the gradient with respect to part maps, as in ``Buffers``.

    Returns:
        The loss of each body, shape (B,), and ``Buffers.numbers``, as new tensors.
    """
    shapes = tuple([tensor.shape for tensor in tensors])
    key, device, graph = (recipe, shapes, target.shape, needs_grad), target.device, None
    grad_bytes = target.nbytes if target.dim() == 4 else 0
    num_bytes = shapes[0][0] * math.prod(target.shape[-2:]) * BYTES_PER_PIXEL + grad_bytes
    if num_bytes and grad_bytes <= (_MOST_ON_CPU if device.type == "cpu" else _MOST_ON_CUDA):
        graph = graphs.find(key, device, num_bytes, partial(LossGraph, *key, device))
    return launch_label_loss(recipe, needs_grad, tensors, target) if graph is None else graph(tensors, target)


_MOST_ON_CPU, _MOST_ON_CUDA = 2**25, 2**30  # most bytes of a maps' gradient that are copied faster than launches begin


class LabelLoss(torch.autograd.Function):
    """Loss whose gradient was computed with it, and is only multiplied by the incoming factor."""

    @staticmethod
    def forward(ctx: Any, name: str, found: tuple[torch.Tensor, torch.Tensor], *tensors: torch.Tensor) -> torch.Tensor:
        """Return the loss. ``found`` is a tuple, because autograd does not look for tensors in it."""
        loss, numbers = found
        ctx.save_for_backward(numbers)
        # The tensors are not saved, because they may be written to until then. Only shapes and history are needed.
        ctx.name, ctx.tensors = name, tensors
        return loss

    @staticmethod
    def backward(ctx: Any, grad_loss: torch.Tensor) -> Any:
        """Scale all gradients by one multiplication."""
        (numbers,) = ctx.saved_tensors
        scaled = gradient_rows(numbers, grad_loss.shape[0]) * grad_loss.unsqueeze(1)
        views = row_views(tuple([tensor.shape for tensor in ctx.tensors]))
        needs = zip(views, ctx.needs_input_grad[2:], strict=True)
        gradients = tuple([scaled.as_strided(*view) if needed else None for view, needed in needs])
        return None, None, *once(ctx.name, gradients, grad_loss, *ctx.tensors)


def gradient_rows(numbers: torch.Tensor, batch: int) -> torch.Tensor:
    """The gradients in ``Buffers.numbers``, shape (B, R)."""
    size = numbers.numel() // 2
    length = size // max(batch, 1)
    return numbers.as_strided((batch, length), (length, 1), numbers.storage_offset() + size)


def launch_label_loss(
    recipe: Recipe, needs_grad: bool, tensors: tuple[torch.Tensor, ...], target: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Compute loss and numbers in new buffers, launch by launch."""
    shapes = tuple([tensor.shape for tensor in tensors])
    buffers = Buffers.empty(recipe, shapes, target.contiguous(), needs_grad)
    torch._foreach_copy_(buffers.inputs, tensors)

    def launch(part: slice) -> None:
        recipe.prepare(buffers.of_bodies(part))()

    launch_bodies_on(target.device, launch, shapes[0][0], recipe.modules)
    return buffers.losses.sum(1), buffers.numbers


class LossGraph:
    """Captured graph that computes loss and numbers in fixed buffers.

    Args:
        recipe: Recipe of the renderer.
        shapes: Shapes of the inputs.
        targets: Shape of the target.
        needs_grad: True if the gradient is wanted.
        device: Device; on CUDA, the graph is captured for torch's current stream.
    """

    def __init__(
        self, recipe: Recipe, shapes: Shapes, targets: torch.Size, needs_grad: bool, device: torch.device
    ) -> None:
        target = torch.empty(targets, dtype=torch.float32 if len(targets) == 4 else torch.uint8, device=device)
        self._buffers = buffers = Buffers.empty(recipe, shapes, target, needs_grad)
        self._launches = CapturedBodies(lambda part: recipe.prepare(buffers.of_bodies(part)), shapes[0][0], device)

    def __call__(self, tensors: tuple[torch.Tensor, ...], target: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Replay, and return copies of loss and numbers, because the next call fills the buffers again."""
        buffers = self._buffers
        torch._foreach_copy_(buffers.inputs, tensors)
        buffers.target.copy_(target)
        self._launches.replay()
        return buffers.losses.sum(1), buffers.numbers.clone()
