"""Functions of torch tensors without gradients, which a CUDA graph replays in the time of a few launches."""

from __future__ import annotations

from collections.abc import Callable, Hashable

import torch

from .captured_step import CapturedStep
from .graph_cache import graphs
from .layouts import Tensors


def replayed(function: Callable[..., Tensors], tensors: Tensors, *options: Hashable) -> Tensors:
    """Compute a function of tensors; on CUDA, a graph replays it from the second call with the same shapes on.

    Hundreds of operators of small tensors take Python ten milliseconds, and a graph a tenth of one. If a gradient is
    wanted, under ``torch.compile``, and on the CPU, the function itself is called.

    Args:
        function: Function of a module, which must not be a closure. It takes the tensors and the options. It must
            neither wait for the device nor send it numbers, such as lists of indices.
        tensors: Inputs on one device.
        options: Further arguments of ``function``, which are the same objects at each call.

    Returns:
        The results of ``function``.
    """
    device = tensors[0].device
    differentiated = torch.is_grad_enabled() and any(each.requires_grad for each in tensors)
    if device.type != "cuda" or differentiated or torch.compiler.is_compiling():
        return function(*tensors, *options)
    key = function, options, tuple([(each.shape, each.dtype) for each in tensors])
    graph = graphs.find(key, device, 0, lambda: _Replayed(function, tensors, options))
    return function(*tensors, *options) if graph is None else graph(tensors)


class _Replayed:
    """Captured function, with the buffers of its inputs."""

    def __init__(self, function: Callable[..., Tensors], tensors: Tensors, options: tuple[Hashable, ...]) -> None:
        self._inputs = tuple([each.clone(memory_format=torch.contiguous_format) for each in tensors])
        self._step = CapturedStep(lambda: function(*self._inputs, *options), tensors[0].device)

    def __call__(self, tensors: Tensors) -> Tensors:
        """Replay, and return copies of the results, because the next call fills the buffers again."""
        torch._foreach_copy_(self._inputs, tensors)
        self._step.replay()
        return tuple([each.clone() for each in self._step.result])
