"""Kernels as operations of torch. Each operation is declared once: its launches, and those of its gradient.

An operation is a class. Its fields are the options of a call, and a call takes only tensors. Operations are never
compared (``eq=False``), because torch.compile before torch 2.13 hashes an object before it has its fields. This example
multiplies vectors (B, 3) by a power of a number for each body, (B,)::

    @dataclass(frozen=True, eq=False)
    class _Scaled(Operation):
        power: int
        name = "scale_vectors"

        def forward(self, inputs: Tensors) -> tuple[Tensors, Tensors]:
            vectors, _ = inputs
            return call_captured(_prepare, inputs, (vectors.shape,), self.power), ()

        def adjoint(self, saved: Tensors, adjoints: Tensors) -> Gradients:
            vectors, numbers = saved
            return call_captured(_prepare_adjoint, (numbers, *adjoints), (vectors.shape,), self.power)


    def scale_vectors(vectors: torch.Tensor, numbers: torch.Tensor, power: int = 1) -> torch.Tensor:
        return _Scaled(power)(vectors, numbers)[0]

``_prepare(inputs, outputs, power)`` returns the launch that fills the outputs, and ``_prepare_adjoint`` the launch that
fills the gradients. ``call_captured`` allocates them, launches on torch's stream, and replays a captured graph if that
is faster; a class may also launch in another way. The rest is the same for all operations and is done here: tensors are
saved for the gradient, and adjoints of unused outputs, inputs without gradient (the numbers above) and derivatives of
gradients are handled. Derivatives of gradients are an error, or come from plain torch: see ``OperationWithTwin``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import torch

from .derivatives import differentiate_again, is_transformed, once, refuse_transforms
from .layouts import Tensors

Gradients = tuple[torch.Tensor | None, ...]

_transforms_are_active = torch._C._are_functorch_transforms_active


class Operation(ABC):
    """Operation of torch with a first derivative; a second one and ``torch.func`` raise NotImplementedError.

    An object is made for each call, and stays as long as its outputs' history.
    """

    num_fixed = 0  # number of outputs without gradient, such as label images; they are the first ones

    @property
    @abstractmethod
    def name(self) -> str:
        """Name of the public function, for errors."""

    @abstractmethod
    def forward(self, inputs: Tensors) -> tuple[Tensors, Tensors]:
        """Compute the outputs, without autograd.

        Returns:
            The outputs, and tensors that the adjoint reads besides the inputs; these may be outputs.
        """

    @abstractmethod
    def adjoint(self, saved: Tensors, adjoints: Tensors) -> Gradients:
        """Compute gradients, without autograd.

        Args:
            saved: The inputs, then what ``forward`` returned besides the outputs.
            adjoints: Gradients with respect to the outputs. One of several outputs may have None, if nothing depends on
                it; an operation for which this is so says it in its own type of the argument.

        Returns:
            Gradients with respect to the first inputs; the inputs after them have none.
        """

    def differentiable_adjoint(self, inputs: Tensors, saved: Tensors, adjoints: Tensors) -> Gradients:
        """Compute gradients under ``create_graph=True``, which raise an error if they are differentiated."""
        given = [adjoint for adjoint in adjoints if adjoint is not None]
        found = self.adjoint(saved, adjoints)
        return once(self.name, found, *given, *inputs[: len(found)])

    def __call__(self, *inputs: torch.Tensor) -> Tensors:
        """Compute the outputs, which carry gradients back to the inputs.

        Raises:
            NotImplementedError: Under ``torch.func``.
        """
        if _transforms_are_active():
            refuse_transforms(self.name, *inputs)
        return _Applied.apply(self, *inputs)


class OperationWithTwin(Operation):
    """Operation that plain torch can do as well: it is differentiable as often as wanted, and by ``torch.func``."""

    name = ""  # for errors, which it does not have

    @abstractmethod
    def plain(self, inputs: Tensors) -> Tensors:
        """Compute the outputs by torch."""

    def compiled(self, inputs: Tensors) -> Tensors:
        """Compute the outputs under ``torch.compile``, which traces this: by torch, or by a custom operation."""
        return self.plain(inputs)

    def differentiable_adjoint(self, inputs: Tensors, saved: Tensors, adjoints: Tensors) -> Gradients:
        """Compute gradients by torch, which have derivatives themselves."""
        return differentiate_again(self.plain, inputs, adjoints)

    def __call__(self, *inputs: torch.Tensor) -> Tensors:
        """Compute the outputs, by torch where kernels can't."""
        if torch.compiler.is_compiling() and not _transforms_are_traced():
            return self.compiled(inputs)
        return self.plain(inputs) if must_be_plain(*inputs) else _Applied.apply(self, *inputs)


def _transforms_are_traced() -> bool:
    """True if ``torch.func`` is active where ``torch.compile`` traces."""
    return _transforms_are_active()


# The answer of the moment of tracing, where transforms are active as well, becomes a constant. This is what
# torch.compiler.assume_constant_result does; it would import torch's compiler, which takes seconds.
_transforms_are_traced._dynamo_marked_constant = True  # type: ignore[attr-defined]


def must_be_plain(*tensors: torch.Tensor) -> bool:
    """True if plain torch must do it: kernels can't be traced, and can't read tensors that ``torch.func`` wrapped."""
    return torch.compiler.is_compiling() or (_transforms_are_active() and is_transformed(*tensors))


def split_missing(adjoints: Gradients) -> tuple[Tensors, tuple[bool, ...]]:
    """Split off the adjoints that are given, for ``call_captured``, and a flag for each output whose adjoint is not."""
    given = tuple([adjoint for adjoint in adjoints if adjoint is not None])
    return given, tuple([adjoint is None for adjoint in adjoints])


class _Applied(torch.autograd.Function):
    """Call of an operation, as autograd knows it."""

    @staticmethod
    def forward(ctx: Any, operation: Operation, *inputs: torch.Tensor) -> Tensors:
        outputs, kept = operation.forward(inputs)
        ctx.operation, ctx.num_inputs = operation, len(inputs)
        ctx.save_for_backward(*inputs, *kept)
        ctx.set_materialize_grads(False)  # or autograd would fill tensors with zeros for outputs that nobody uses
        if operation.num_fixed:
            ctx.mark_non_differentiable(*outputs[: operation.num_fixed])
        return outputs

    @staticmethod
    def backward(ctx: Any, *adjoints: torch.Tensor | None) -> Gradients:
        operation, count = ctx.operation, ctx.num_inputs
        if adjoints[-1] is None and all(adjoint is None for adjoint in adjoints):
            return (None,) * (1 + count)
        saved = ctx.saved_tensors
        if torch.is_grad_enabled() or (_transforms_are_active() and is_transformed(*adjoints)):
            found = operation.differentiable_adjoint(saved[:count], saved, adjoints)
        else:
            found = operation.adjoint(saved, adjoints)
        return None, *found, *(None,) * (count - len(found))
