"""Derivatives that kernels lack, second ones and ``torch.func``'s, 0 to autograd: torch's instead, or errors."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch

_is_wrapped = torch._C._functorch.is_functorch_wrapped_tensor


def is_transformed(*tensors: torch.Tensor | None) -> bool:
    """True if ``torch.func`` has wrapped one of them, as ``vmap`` and ``grad`` do: no kernel can read it."""
    for tensor in tensors:  # noqa: SIM110  any() takes twice as long
        if isinstance(tensor, torch.Tensor) and _is_wrapped(tensor):
            return True
    return False


def refuse_transforms(name: str, *tensors: torch.Tensor | None) -> None:
    """Raise NotImplementedError if ``torch.func`` has wrapped one of a function's tensors.

    Args:
        name: Of the public function.
        tensors: Its arguments.
    """
    if not torch.compiler.is_compiling() and is_transformed(*tensors):
        raise NotImplementedError(
            f"{name}: called under torch.func; expected plain tensors: torch.autograd.grad or backward instead of "
            "grad and jacrev, and the batch dimension instead of vmap"
        )


def once(name: str, gradients: tuple[torch.Tensor | None, ...], *tensors: torch.Tensor) -> Any:
    """Mark gradients so that to differentiate them, under ``create_graph=True``, raises NotImplementedError.

    ``torch.autograd.function.once_differentiable`` looks at the incoming gradients alone, so it is silent where only
    the inputs could be differentiated.

    Args:
        name: Of the public function.
        gradients: With respect to its arguments.
        tensors: What they depend on: incoming gradients and the arguments.
    """
    if not torch.is_grad_enabled():
        return gradients
    known = [gradient for gradient in gradients if gradient is not None]
    marked = iter(_Once.apply(name, len(known), *known, *tensors))
    return tuple(None if gradient is None else next(marked) for gradient in gradients)


class _Once(torch.autograd.Function):
    """Identity of the first ``count`` tensors, made to depend on the others."""

    @staticmethod
    def forward(ctx: Any, name: str, count: int, *tensors: torch.Tensor) -> tuple[torch.Tensor, ...]:
        ctx.name = name
        return tuple(tensor.clone() for tensor in tensors[:count])

    @staticmethod
    def backward(ctx: Any, *adjoints: torch.Tensor) -> Any:
        raise_second_derivative(ctx.name)


def differentiate_again(
    function: Callable[[tuple[torch.Tensor, ...]], tuple[torch.Tensor, ...]],
    inputs: tuple[torch.Tensor, ...],
    adjoints: tuple[torch.Tensor | None, ...],
) -> tuple[torch.Tensor | None, ...]:
    """Gradients by torch, which have derivatives themselves: for a kernel's ``backward`` under ``create_graph=True``.

    Args:
        function: Computes by torch what the kernel computes.
        inputs: Its argument; those without gradient get None.
        adjoints: Gradients with respect to the results; None for those on which nothing depends.
    """

    def used_results(*moved: torch.Tensor) -> tuple[torch.Tensor, ...]:
        own = iter(moved)
        results = function(tuple([next(own) if each.requires_grad else each for each in inputs]))
        return tuple([result for result, each in zip(results, adjoints, strict=True) if each is not None])

    pull = torch.func.vjp(used_results, *[each for each in inputs if each.requires_grad])[1]
    found = iter(pull(tuple([each for each in adjoints if each is not None])))
    return tuple([next(found) if each.requires_grad else None for each in inputs])


def raise_second_derivative(name: str) -> None:
    """Raise NotImplementedError: the function has a first derivative alone."""
    raise NotImplementedError(f"{name}: differentiated twice; expected once: its gradient has no derivative")
