"""Functions of torch tensors by captured launches: arguments into fixed buffers, one replay, copies of the results."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from typing import Any

import torch

from .graph_cache import CapturedBodies, Launch, graphs
from .layouts import Shapes, Tensors, split_blocks, total_length
from .streams import on_torch_stream

Prepare = Callable[..., Launch]  # of inputs, outputs and options; allocates and returns launches that fill the outputs


def call_captured(prepare: Prepare, tensors: Tensors, outputs: Shapes, *options: Hashable) -> Tensors:
    """Results of launches for B bodies, by a captured graph where memory has room for its buffers.

    Args:
        prepare: A function of a module; called with views of some bodies' inputs and outputs, and the options.
        tensors: Inputs of one floating dtype, shapes (B, ...), on one device; copied, so that any strides will do.
        outputs: Shapes of the results, (B, ...).
        options: Further arguments of ``prepare``.

    Returns:
        The results, of the inputs' dtype: views of one tensor.
    """
    first = tensors[0]
    batch, device, dtype = first.shape[0], first.device, first.dtype
    inputs = tuple([tensor.shape for tensor in tensors])
    if batch == 0:
        return tuple(first.new_empty(shape) for shape in outputs)
    key = prepare, options, inputs, outputs, dtype, device
    size = 2 * first.element_size() * total_length((*inputs, *outputs))  # with what lies in between
    graph = graphs.find(key, device, size, lambda: _Graph(*key))
    if graph is not None:
        return graph(tensors)
    buffers = _Buffers(inputs, outputs, dtype, device)
    torch._foreach_copy_(buffers.inputs, tensors)
    with on_torch_stream(device):
        buffers.prepare(slice(0, batch), prepare, options)()
    return buffers.outputs


class _Buffers:
    """Inputs and outputs of B bodies, one after the other in one tensor each."""

    def __init__(self, inputs: Shapes, outputs: Shapes, dtype: torch.dtype, device: torch.device) -> None:
        ends = [torch.empty(total_length(each), dtype=dtype, device=device) for each in (inputs, outputs)]
        self.found = ends[1]
        self.inputs, self.outputs = split_blocks(ends[0], inputs), split_blocks(ends[1], outputs)

    def prepare(self, part: slice, prepare: Prepare, options: Sequence[Any]) -> Launch:
        """Launches of some of the bodies."""
        inputs, outputs = (tuple(tensor[part] for tensor in each) for each in (self.inputs, self.outputs))
        return prepare(inputs, outputs, *options)


class _Graph:
    def __init__(
        self,
        prepare: Prepare,
        options: tuple[Hashable, ...],
        inputs: Shapes,
        outputs: Shapes,
        dtype: torch.dtype,
        device: torch.device,
    ) -> None:
        self._shapes = outputs
        self._buffers = buffers = _Buffers(inputs, outputs, dtype, device)
        self._launches = CapturedBodies(lambda part: buffers.prepare(part, prepare, options), inputs[0][0], device)

    def __call__(self, tensors: Tensors) -> Tensors:
        """Copies of the results, for the next call fills the buffers again."""
        torch._foreach_copy_(self._buffers.inputs, tensors)
        self._launches.replay()
        return split_blocks(self._buffers.found.clone(), self._shapes)
