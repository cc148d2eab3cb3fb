"""Functions of torch tensors with many short kernels: on CUDA, calls with the same shapes become one captured graph."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

import torch

from .captured_step import CapturedStep
from .graph_cache import graphs
from .layouts import Tensors

_T = TypeVar("_T")


class CapturedCall(Generic[_T]):
    """Captured call of a function of tensors, which are copied to fixed buffers.

    Args:
        function: Function of the tensors that never waits for the device.
        tensors: Tensors of the first call, all on one CUDA device. Those of later calls have the same shapes.
    """

    def __init__(self, function: Callable[[Tensors], _T], tensors: Tensors) -> None:
        self._tensors = tuple([each.clone() for each in tensors])
        self._step = CapturedStep(lambda: function(self._tensors), tensors[0].device)

    def __call__(self, tensors: Tensors) -> _T:
        """Replay, and return the result, which the next call fills again."""
        torch._foreach_copy_(self._tensors, tensors)
        self._step.replay()
        return self._step.result


def call_as_graph(function: Callable[..., Tensors], options: tuple[Hashable, ...], tensors: Tensors) -> Tensors:
    """Call a function with options and then tensors; on CUDA, the second call with the same shapes is captured.

    A call that is to be differentiated is not captured.

    Args:
        function: Function of a module, which must not be a closure. It never waits for the device, and returns tensors.
        options: First arguments of the function.
        tensors: Tensors on one device, which are its further arguments.

    Returns:
        The function's tensors. A later call does not change them.
    """
    device = tensors[0].device
    differentiated = torch.is_grad_enabled() and any(each.requires_grad for each in tensors)
    if device.type == "cuda" and not differentiated:
        key = call_as_graph, function, options, tuple([(each.shape, each.dtype) for each in tensors])
        make = lambda: CapturedCall(lambda held: function(*options, *held), tensors)  # noqa: E731
        captured = graphs.find(key, device, 0, make)
        if captured is not None:
            return tuple([each.clone() for each in captured(tensors)])
    return function(*options, *tensors)
