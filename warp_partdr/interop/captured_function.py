"""Functions of torch tensors by captured launches: arguments into fixed buffers, one replay, copies of the results."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass

import torch

from .arrays import dense_rows
from .graph_cache import CapturedBodies, Launch, graphs
from .layouts import Shapes, Tensors, split_blocks, total_length
from .streams import launch_bodies_on, on_torch_stream

Prepare = Callable[..., Launch]  # of inputs, outputs and options; allocates and returns launches that fill the outputs

# [bytes] of arguments and results that are copied faster than launches begin
_MOST_ON_CPU, _MOST_ON_CUDA = 2**20, 2**26
_LEAST_TO_SHARE = 2**17  # and from where on they take longer than a thread to start


@dataclass(frozen=True, eq=False)
class Fixed:
    """A tensor as an option: launches read it where it lies, and another one takes launches of its own."""

    tensor: torch.Tensor

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Fixed) and other.tensor is self.tensor

    def __hash__(self) -> int:
        return id(self.tensor)


def call_captured(prepare: Prepare, tensors: Tensors, outputs: Shapes, *options: Hashable) -> Tensors:
    """Results of launches for B bodies, by a captured graph where that pays and memory has room for its buffers.

    Args:
        prepare: A function of a module; called with inputs and outputs of some bodies, of which each body's numbers are
            contiguous, and the options.
        tensors: Inputs, shapes (B, ...), on one device, of any strides; the first one's dtype is a floating one.
        outputs: Shapes of the results, (B, ...).
        options: Further arguments of ``prepare``.

    Returns:
        The results, of the first input's dtype.
    """
    first = tensors[0]
    device, dtype, length = first.device, first.dtype, total_length(outputs)
    if length == 0:
        return tuple([first.new_empty(shape) for shape in outputs])
    size = sum([each.nbytes for each in tensors]) + first.element_size() * length
    if size <= (_MOST_ON_CPU if device.type == "cpu" else _MOST_ON_CUDA):
        inputs = tuple([(each.shape, each.dtype) for each in tensors])
        key = prepare, options, inputs, outputs, dtype, device, size >= _LEAST_TO_SHARE
        graph = graphs.find(key, device, 2 * size, lambda: _Graph(*key))  # with what lies in between
        if graph is not None:
            return graph(tensors)
    given, found = tuple([dense_rows(each) for each in tensors]), tuple([first.new_empty(shape) for shape in outputs])

    def work(part: slice) -> None:
        prepare(tuple([each[part] for each in given]), tuple([each[part] for each in found]), *options)()

    if prepare in _launched:
        launch_bodies_on(device, work, len(first), ())
    else:
        with on_torch_stream(device):
            work(slice(None))
        _launched.add(prepare)
    return found


_launched: set[Prepare] = set()  # whose kernels are built: threads that share a batch would each build them


class _Graph:
    """Launches in fixed buffers: inputs in a tensor each, outputs one after the other in one tensor."""

    def __init__(
        self,
        prepare: Prepare,
        options: tuple[Hashable, ...],
        inputs: Sequence[tuple[torch.Size, torch.dtype]],
        outputs: Shapes,
        dtype: torch.dtype,
        device: torch.device,
        shared: bool,
    ) -> None:
        self._shapes = outputs
        self._inputs = [torch.empty(shape, dtype=kind, device=device) for shape, kind in inputs]
        self._found = torch.empty(total_length(outputs), dtype=dtype, device=device)
        found = split_blocks(self._found, outputs)

        def prepare_part(part: slice) -> Launch:
            return prepare(*(tuple([each[part] for each in some]) for some in (self._inputs, found)), *options)

        self._launches = CapturedBodies(prepare_part, inputs[0][0][0], device, shared=shared)

    def __call__(self, tensors: Tensors) -> Tensors:
        """Copies of the results, for the next call fills the buffers again."""
        torch._foreach_copy_(self._inputs, tensors)
        self._launches.replay()
        return split_blocks(self._found.clone(), self._shapes)
