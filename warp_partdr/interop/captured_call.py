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
        self._tensors = tuple([each.clone(memory_format=torch.contiguous_format) for each in tensors])
        self._function = function  # the graph reads what belongs to it
        self._step = CapturedStep(lambda: function(self._tensors), tensors[0].device)

    def __call__(self, tensors: Tensors) -> _T:
        """Replay, and return the result, which the next call fills again."""
        torch._foreach_copy_(self._tensors, tensors)
        self._step.replay()
        return self._step.result


def call_as_graph(function: Callable[..., Tensors], tensors: Tensors, *options: Hashable) -> Tensors:
    """Compute a function of tensors; on CUDA, a graph replays it from the second call with the same shapes on.

    Hundreds of operators of small tensors take Python ten milliseconds, and a graph a tenth of one. If a gradient is
    wanted, under ``torch.compile``, and on the CPU, the function itself is called.

    Args:
        function: Function of a module, which must not be a closure. It takes the tensors and then the options, and
            returns tensors. It must neither wait for the device nor send it numbers, such as lists of indices.
        tensors: Inputs on one device.
        options: Further arguments of the function, which are the same objects at each call.

    Returns:
        The function's tensors. A later call does not change them.
    """
    device = tensors[0].device
    differentiated = torch.is_grad_enabled() and any(each.requires_grad for each in tensors)
    if device.type != "cuda" or differentiated or torch.compiler.is_compiling():
        return function(*tensors, *options)
    key = call_as_graph, function, options, tuple([(each.shape, each.dtype) for each in tensors])
    make = lambda: CapturedCall(lambda held: function(*held, *options), tensors)  # noqa: E731
    captured = graphs.find(key, device, 0, make)
    if captured is None:
        return function(*tensors, *options)
    return tuple([each.clone() for each in captured(tensors)])
