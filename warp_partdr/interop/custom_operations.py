"""Custom operations: what ``torch.compile`` takes as it is, without looking into it.

They are made with torch's library of operations itself. ``torch.library.custom_op`` looks through all arguments and
results at each call, which takes as long as the rest of the call.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import torch

from .derivatives import raise_second_derivative
from .graph_cache import graphs
from .layouts import Shapes, Tensors, total_length

_NAMESPACE = "warp_partdr"
_DEFAULT_STREAM = 0  # CUDA's own number for it
_library = torch.library.Library(_NAMESPACE, "FRAGMENT")

Save = Callable[..., None]  # takes ctx, inputs and output, and saves what the gradient reads


def register_operation(schema: str, function: Callable[..., Any], empty: Callable[..., Any]) -> None:
    """Register the custom operation ``torch.ops.warp_partdr.NAME``.

    Args:
        schema: Name, arguments and results in torch's own words: "twice(Tensor[] vectors) -> Tensor". The first
            argument is a list of tensors.
        function: Function that computes the results. They are new tensors, no two of which share memory.
        empty: Function that makes empty results of the same shapes, of which sizes may be symbols.
    """
    name = schema.partition("(")[0]
    _library.define(schema, tags=(torch.Tag.pt2_compliant_tag,))
    _library.impl(name, function, "CPU")
    _library.impl(name, partial(_call_on_cuda, function), "CUDA")
    torch.library.register_fake(f"{_NAMESPACE}::{name}", empty, lib=_library)


def _call_on_cuda(function: Callable[..., Any], tensors: Sequence[torch.Tensor], *others: Any) -> Any:
    """Call the function of an operation on CUDA, without captured graphs unless torch is on its default stream.

    With ``mode="reduce-overhead"``, torch runs an operation on a stream of its own before it captures it, and takes
    all memory from a pool that the capture uses again. What stays, such as our graphs' buffers, must not lie there.
    """
    if torch._C._cuda_getCurrentRawStream(tensors[0].device.index) == _DEFAULT_STREAM:
        return function(tensors, *others)
    with graphs.unused():
        return function(tensors, *others)


def register_gradient(name: str, backward: Callable[..., Any], save: Save | None = None) -> None:
    """Register the gradient of a custom operation.

    Args:
        name: Name of the operation.
        backward: Function of ``ctx`` and the adjoints of the results that returns the adjoints of the arguments.
        save: Function that saves what it reads, as ``setup_context`` of an autograd function does.
    """
    torch.library.register_autograd(f"{_NAMESPACE}::{name}", backward, setup_context=save, lib=_library)


def split_symbolic(numbers: torch.Tensor, shapes: Sequence[torch.Size]) -> Tensors:
    """``split_blocks`` for sizes that may be symbols."""
    parts = numbers.split([math.prod(shape) for shape in shapes])
    return tuple([part.view(shape) for part, shape in zip(parts, shapes, strict=True)])


def register_function(
    name: str,
    public: str,
    shapes: Callable[[Tensors, int], Shapes],
    forward: Callable[[Tensors, int], torch.Tensor],
    adjoint: Callable[[Tensors, torch.Tensor, int], torch.Tensor],
) -> None:
    """Register a function of tensors and of a number, which has a first derivative.

    All results lie in one tensor, one after the other, as ``find_together`` gives them: results of a custom operation
    must not share memory, and a copy of each would take longer than the function.

    Args:
        name: Name of the operation.
        public: Name of the public function, for errors.
        shapes: Function that gives the shapes of the results from inputs and number.
        forward: Function that computes the results.
        adjoint: Function that computes the gradients of the inputs, one after the other, from the inputs, the gradients
            of the results, and the number.
    """
    operations, derivative = getattr(torch.ops, _NAMESPACE), f"{name}_adjoint"

    def save(ctx: Any, inputs: Any, output: Any) -> None:
        tensors, ctx.number = inputs
        ctx.save_for_backward(*tensors)

    def backward(ctx: Any, adjoints: torch.Tensor) -> Any:
        inputs = ctx.saved_tensors
        found = getattr(operations, derivative)(inputs, adjoints, ctx.number)
        return list(split_symbolic(found, [each.shape for each in inputs])), None

    def refuse(ctx: Any, *adjoints: Any) -> None:
        raise_second_derivative(public)

    def empty(inputs: Any, number: int) -> Any:
        return inputs[0].new_empty(total_length(shapes(inputs, number)))

    def empty_adjoint(inputs: Any, adjoints: Any, number: int) -> Any:
        return inputs[0].new_empty(total_length(tuple([each.shape for each in inputs])))

    register_operation(
        f"{name}(Tensor[] inputs, int number) -> Tensor",
        lambda inputs, number: forward(tuple(inputs), number),
        empty,
    )
    register_operation(
        f"{derivative}(Tensor[] inputs, Tensor adjoints, int number) -> Tensor",
        lambda inputs, adjoints, number: adjoint(tuple(inputs), adjoints, number),
        empty_adjoint,
    )
    register_gradient(name, backward, save)
    register_gradient(derivative, refuse)
