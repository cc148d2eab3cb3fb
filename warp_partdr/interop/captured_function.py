"""Functions of torch tensors, run by captured launches: copy arguments to fixed buffers, replay, copy the results."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass

import torch

from .arrays import dense_rows
from .graph_cache import CapturedBodies, Launch, graphs
from .layouts import Shapes, Tensors, split_blocks, total_length
from .streams import launch_bodies_on, on_torch_stream

Prepare = Callable[..., Launch]  # takes inputs, outputs, options; allocates, and returns launches that fill the outputs

# Most bytes of arguments and results that are copied faster than launches begin.
_MOST_ON_CPU, _MOST_ON_CUDA = 2**20, 2**26
_LEAST_TO_SHARE = 2**17  # [bytes]; from here on, the work takes longer than the start of a thread


@dataclass(frozen=True, eq=False)
class Fixed:
    """Tensor as an option: launches read it in place, and another tensor gets launches of its own."""

    tensor: torch.Tensor

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Fixed) and other.tensor is self.tensor

    def __hash__(self) -> int:
        return id(self.tensor)


def call_captured(prepare: Prepare, tensors: Tensors, outputs: Shapes, *options: Hashable) -> Tensors:
    """Compute results for B bodies, with a captured graph if that is faster and memory has room for its buffers.

    Args:
        prepare: Function of a module, which must not be a closure. It is called with inputs and outputs of some bodies,
            each body's numbers being contiguous, and with the options.
        tensors: Inputs, shapes (B, ...), on one device, with any strides. The first one has a floating dtype.
        outputs: Shapes of the results, (B, ...).
        options: Further arguments of ``prepare``.

    Returns:
        The results, with the first input's dtype.
    """
    return split_blocks(find_together(prepare, tensors, outputs, *options), outputs)


def find_together(prepare: Prepare, tensors: Tensors, outputs: Shapes, *options: Hashable) -> torch.Tensor:
    """Compute what ``call_captured`` returns in one tensor, one result after the other."""
    first = tensors[0]
    device, dtype, length = first.device, first.dtype, total_length(outputs)
    if length == 0:
        return first.new_empty(0)
    size = sum([each.nbytes for each in tensors]) + first.element_size() * length
    if size <= (_MOST_ON_CPU if device.type == "cpu" else _MOST_ON_CUDA):
        inputs = tuple([(each.shape, each.dtype) for each in tensors])
        key = prepare, options, inputs, outputs, dtype, device, size >= _LEAST_TO_SHARE
        graph = graphs.find(key, device, 2 * size, lambda: _Graph(*key))  # with what lies in between
        if graph is not None:
            return graph(tensors)
    given, together = tuple([dense_rows(each) for each in tensors]), first.new_empty(length)
    found = split_blocks(together, outputs)

    def work(part: slice) -> None:
        prepare(tuple([each[part] for each in given]), tuple([each[part] for each in found]), *options)()

    if prepare in _launched:
        launch_bodies_on(device, work, len(first), ())
    else:
        with on_torch_stream(device):
            work(slice(None))
        _launched.add(prepare)
    return together


_launched: set[Prepare] = set()  # functions whose kernels are built; else each thread of a batch would build them


class _Graph:
    """Launches in fixed buffers: each input is a tensor, and all outputs lie one after the other in one tensor."""

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
        self._inputs = [torch.empty(shape, dtype=own_dtype, device=device) for shape, own_dtype in inputs]
        self._found = torch.empty(total_length(outputs), dtype=dtype, device=device)
        found = split_blocks(self._found, outputs)

        def prepare_part(part: slice) -> Launch:
            return prepare(*(tuple([each[part] for each in some]) for some in (self._inputs, found)), *options)

        self._launches = CapturedBodies(prepare_part, inputs[0][0][0], device, shared=shared)

    def __call__(self, tensors: Tensors) -> torch.Tensor:
        """Replay, and return a copy of the results, because the next call fills the buffers again."""
        torch._foreach_copy_(self._inputs, tensors)
        self._launches.replay()
        return self._found.clone()
