"""Derivatives that kernels lack: second ones and those of ``torch.func``. Autograd would take them for 0.

Instead, torch computes them, or they raise an error.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch

_is_wrapped = torch._C._functorch.is_functorch_wrapped_tensor
_transforms_are_active = torch._C._are_functorch_transforms_active


def is_transformed(*tensors: torch.Tensor | None) -> bool:
    """True if ``torch.func`` has wrapped a tensor, as ``vmap`` and ``grad`` do: no kernel can read it."""
    for tensor in tensors:  # noqa: SIM110  any() takes twice as long
        if isinstance(tensor, torch.Tensor) and _is_wrapped(tensor):
            return True
    return False


def refuse_transforms(name: str, *tensors: torch.Tensor | None) -> None:
    """Raise NotImplementedError if ``torch.func`` has wrapped one of a function's tensors.

    Args:
        name: Name of the public function.
        tensors: Arguments of the function.
    """
    if torch.compiler.is_compiling() or not _transforms_are_active():
        return
    if is_transformed(*tensors):
        raise NotImplementedError(
            f"{name}: called under torch.func; expected plain tensors: torch.autograd.grad or backward instead of "
            "grad and jacrev, and the batch dimension instead of vmap"
        )


def once(name: str, gradients: tuple[torch.Tensor | None, ...], *tensors: torch.Tensor) -> Any:
    """Mark gradients so that NotImplementedError is raised if they are differentiated, under ``create_graph=True``.

    ``torch.autograd.function.once_differentiable`` checks only the incoming gradients, so it is silent if only the
    inputs can be differentiated.

    Args:
        name: Name of the public function.
        gradients: Gradients with respect to its arguments.
        tensors: Tensors on which the gradients depend: incoming gradients and the arguments.
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
    """Compute gradients with torch, which can be differentiated: for a ``backward`` under ``create_graph=True``.

    Args:
        function: Function of torch that computes the same as the kernel.
        inputs: Arguments of the function; those that need no gradient get None.
        adjoints: Gradients with respect to the results; None for results on which nothing depends.
    """

    def used_results(*differentiated: torch.Tensor) -> tuple[torch.Tensor, ...]:
        own = iter(differentiated)
        results = function(tuple([next(own) if each.requires_grad else each for each in inputs]))
        return tuple([result for result, each in zip(results, adjoints, strict=True) if each is not None])

    pull = torch.func.vjp(used_results, *[each for each in inputs if each.requires_grad])[1]
    found = iter(pull(tuple([each for each in adjoints if each is not None])))
    return tuple([next(found) if each.requires_grad else None for each in inputs])


def raise_second_derivative(name: str) -> None:
    """Raise NotImplementedError: the function has only a first derivative."""
    raise NotImplementedError(f"{name}: differentiated twice; expected once: its gradient has no derivative")
