"""L_seg of a batch with its gradient: by a captured graph, or launched kernel by kernel where memory has no room."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from types import ModuleType
from typing import Any, Protocol

import torch

from .derivatives import once
from .graph_cache import BYTES_PER_PIXEL, CapturedBodies, graphs
from .streams import launch_bodies_on

Shapes = tuple[torch.Size, ...]


@dataclass(frozen=True)
class Buffers:
    """Inputs and outputs of a renderer's launches, of B bodies.

    Attributes:
        rows: The inputs and, if needed, their gradients, shape (1 or 2, B, R); a body's numbers lie side by side.
        inputs: Views of the first rows, each of shape (B, ...).
        target: Target labels, shape (N, H, W), N = 1 or B, uint8.
        losses: Partial sums of L_seg, shape (B, K).
        grads: Views of the second rows, as of the inputs; empty if not needed.
    """

    rows: torch.Tensor
    inputs: tuple[torch.Tensor, ...]
    target: torch.Tensor
    losses: torch.Tensor
    grads: tuple[torch.Tensor, ...]

    @classmethod
    def empty(cls, recipe: Recipe, shapes: Shapes, target: torch.Tensor, needs_grad: bool) -> Buffers:
        """Allocate for inputs of these shapes."""
        batch, (_, height, width), device = shapes[0][0], target.shape, target.device
        rows = torch.empty(2 if needs_grad else 1, batch, row_length(shapes), device=device)
        losses = torch.empty(batch, recipe.num_losses(device, batch, height, width), device=device)
        views = [split_rows(each, shapes) for each in rows]
        return cls(rows, views[0], target, losses, views[1] if needs_grad else ())

    def of_bodies(self, part: slice) -> Buffers:
        """Buffers of a slice of the bodies."""
        return Buffers(
            self.rows[:, part],
            tuple(tensor[part] for tensor in self.inputs),
            self.target if len(self.target) == 1 else self.target[part],
            self.losses[part],
            tuple(tensor[part] for tensor in self.grads),
        )


class Recipe(Protocol):
    """A renderer's launches of loss and gradient; equal for equal options, for it is a graph's key."""

    def __hash__(self) -> int: ...

    name: str  # of the public function

    @property
    def modules(self) -> Sequence[ModuleType]:
        """Python modules of the kernels it launches."""
        ...

    def num_losses(self, device: torch.device, batch: int, height: int, width: int) -> int:
        """K, the number of partial sums of a body's loss."""
        ...

    def prepare(self, buffers: Buffers) -> Callable[[], None]:
        """Allocate intermediate buffers; return a function that fills ``losses`` and ``grads`` by launches alone."""
        ...


def find_label_loss(
    recipe: Recipe, tensors: tuple[torch.Tensor, ...], target: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """L_seg of a batch, and its gradient if one is needed.

    Args:
        recipe: The renderer's.
        tensors: Inputs of the loss, shapes (B, ...), on one device.
        target: Shape (N, H, W), N = 1 or B, uint8.

    Returns:
        The loss of each body, differentiable, shape (B,), and ``rows``: ``rows[0]`` is a copy of the tensors for
        ``split_rows``.
    """
    needs_grad = torch.is_grad_enabled() and any(tensor.requires_grad for tensor in tensors)
    shapes = tuple([tensor.shape for tensor in tensors])
    key, device = (recipe, shapes, target.shape, needs_grad), target.device
    num_bytes = shapes[0][0] * math.prod(target.shape[1:]) * BYTES_PER_PIXEL
    with torch.no_grad():
        graph = graphs.find(key, device, num_bytes, partial(LossGraph, *key, device)) if num_bytes else None
        found = launch_label_loss(recipe, needs_grad, tensors, target) if graph is None else graph(tensors, target)
    loss, rows = found
    if needs_grad:
        loss = LabelLoss.apply(recipe.name, (loss, rows), *tensors)
    return loss, rows


class LabelLoss(torch.autograd.Function):
    """Loss whose gradient was computed with it and only waits for the incoming factor."""

    @staticmethod
    def forward(ctx: Any, name: str, found: tuple[torch.Tensor, torch.Tensor], *tensors: torch.Tensor) -> torch.Tensor:
        """Return the loss; ``found`` is a tuple, in which autograd sees no tensors."""
        loss, rows = found
        ctx.save_for_backward(rows)
        # Not saved as rows are, for they may be written to until then: only their shapes and history are asked for.
        ctx.name, ctx.tensors = name, tensors
        return loss

    @staticmethod
    def backward(ctx: Any, grad_loss: torch.Tensor) -> Any:
        """Scale all gradients by one multiplication."""
        (rows,) = ctx.saved_tensors
        scaled = rows[1] * grad_loss[:, None]
        views = zip(_layout(tuple([tensor.shape for tensor in ctx.tensors])), ctx.needs_input_grad[2:], strict=True)
        # Their offsets are those in ``scaled``, which begins where its memory does.
        gradients = tuple([scaled.as_strided(*place) if needed else None for place, needed in views])
        return None, None, *once(ctx.name, gradients, grad_loss, *ctx.tensors)


def split_rows(rows: torch.Tensor, shapes: Shapes) -> tuple[torch.Tensor, ...]:
    """Views of shapes (B, ...) into contiguous rows (B, R), which hold a body's numbers one after another."""
    return tuple(_view(rows, place) for place in _layout(shapes))


_Place = tuple[torch.Size, tuple[int, ...], int]  # shape, strides and first number


def _view(rows: torch.Tensor, place: _Place) -> torch.Tensor:
    shape, strides, start = place
    return rows.as_strided(shape, strides, rows.storage_offset() + start)


@lru_cache(maxsize=64)
def _layout(shapes: Shapes) -> list[_Place]:
    """Shape, strides and offset of each tensor in a row."""
    length, layout, start = row_length(shapes), [], 0
    for shape in shapes:
        inner = [math.prod(shape[k + 1 :]) for k in range(1, len(shape))]
        layout.append((shape, (length, *inner), start))
        start += math.prod(shape[1:])
    return layout


def row_length(shapes: Shapes) -> int:
    """R, the number of a body's values."""
    return sum(math.prod(shape[1:]) for shape in shapes)


def launch_label_loss(
    recipe: Recipe, needs_grad: bool, tensors: tuple[torch.Tensor, ...], target: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Loss and rows, in fresh buffers and launch by launch; with ``needs_grad``, ``rows[1]`` is the gradient."""
    shapes = tuple([tensor.shape for tensor in tensors])
    buffers = Buffers.empty(recipe, shapes, target.contiguous(), needs_grad)
    torch._foreach_copy_(buffers.inputs, tensors)

    def launch(part: slice) -> None:
        recipe.prepare(buffers.of_bodies(part))()

    launch_bodies_on(target.device, launch, shapes[0][0], recipe.modules)
    return buffers.losses.sum(1), buffers.rows


class LossGraph:
    """Loss and rows by a captured graph in fixed buffers.

    Args:
        recipe: The renderer's.
        shapes: Shapes of the inputs.
        targets: Shape of the target.
        needs_grad: Whether the gradient is wanted.
        device: On CUDA, for torch's current stream.
    """

    def __init__(
        self, recipe: Recipe, shapes: Shapes, targets: torch.Size, needs_grad: bool, device: torch.device
    ) -> None:
        target = torch.empty(targets, dtype=torch.uint8, device=device)
        self._buffers = buffers = Buffers.empty(recipe, shapes, target, needs_grad)
        self._launches = CapturedBodies(lambda part: recipe.prepare(buffers.of_bodies(part)), shapes[0][0], device)

    def __call__(self, tensors: tuple[torch.Tensor, ...], target: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Copies of loss and rows, for the next call fills the buffers again."""
        buffers = self._buffers
        torch._foreach_copy_(buffers.inputs, tensors)
        buffers.target.copy_(target)
        self._launches.replay()
        return buffers.losses.sum(1), buffers.rows.clone()
