"""Graphs of a few operators, which describe the packaged networks of the detection. Plain torch runs them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch
import torch.nn.functional as F
from torch import nn

from ...interop.precision import exact_convolutions


@dataclass(frozen=True)
class Node:
    """One operator of a graph.

    Attributes:
        kind: Name of the operator, one of ``KINDS``.
        inputs: Numbers of the values that it takes.
        output: Number of the value that it makes, and of its weights.
        stride: Stride of a convolution.
        groups: Number of groups of a convolution. It is the number of channels in a depthwise convolution.
        zeros: Padding with zeros around a convolution's input: left, right, above, below.
        activation: Activation after a convolution or a sum: "none", "relu" or "relu6".
        size: Side of pooled squares, number of channels of zeros that are appended, or (H, W) of a resized picture.
        shape: Shape of the rows that a picture becomes, without the batch.
    """

    kind: str
    inputs: tuple[int, ...]
    output: int
    stride: int = 1
    groups: int = 1
    zeros: tuple[int, int, int, int] = (0, 0, 0, 0)
    activation: str = "none"
    size: Any = 0
    shape: tuple[int, ...] = field(default=())

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Node:
        """Node from a JSON object of the packaged file; lists become tuples."""
        fields: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value for name, value in values.items()
        }
        return cls(**fields)


def activate(values: torch.Tensor, name: str) -> torch.Tensor:
    """Values after an activation, in their own memory."""
    if name == "none":
        return values
    return values.relu_() if name == "relu" else values.clamp_(0.0, 6.0)


def convolve(node: Node, values: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor) -> torch.Tensor:
    """Convolution, then the node's activation.

    Torch pads both sides alike. Where the node doesn't, zeros beside the weights do the same as a padded copy of the
    values, which would take twice as long as the convolution itself.
    """
    left, right, above, below = node.zeros
    across, down = max(left, right), max(above, below)
    if left != right or above != below:
        weight = F.pad(weight, (across - left, across - right, down - above, down - below))
    found = F.conv2d(values, weight, bias, node.stride, (down, across), groups=node.groups)
    return activate(found, node.activation)


def _add(node: Node, first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    return activate(first + second, node.activation)


def _max_pool(node: Node, values: torch.Tensor) -> torch.Tensor:
    return F.max_pool2d(values, node.size)


def _more_channels(node: Node, values: torch.Tensor) -> torch.Tensor:
    return F.pad(values, (0, 0, 0, 0, 0, node.size))


def _resize(node: Node, values: torch.Tensor) -> torch.Tensor:
    return F.interpolate(values, node.size, mode="bilinear", align_corners=False)


def _sigmoid(node: Node, values: torch.Tensor) -> torch.Tensor:
    return values.sigmoid()


def _rows(node: Node, values: torch.Tensor) -> torch.Tensor:
    """Rows of numbers from pictures, pixel by pixel; the channels of a pixel are side by side."""
    return values.permute(0, 2, 3, 1).reshape(len(values), *node.shape)


KINDS: dict[str, Callable[..., torch.Tensor]] = {
    "convolution": convolve,
    "add": _add,
    "max_pool": _max_pool,
    "more_channels": _more_channels,
    "resize": _resize,
    "sigmoid": _sigmoid,
    "rows": _rows,
}


class OperatorGraph(nn.Module):
    """Network from nodes in the order of their computation.

    Args:
        size: Side of the square pictures that it takes [px].
        start: Number of the value that is the input.
        outputs: Name of each output, and number of its value.
        nodes: The operators.
        weights: Weights "N.weight" (out, in / groups, H, W) and "N.bias" (out,) of the convolution with output N.

    The arguments are attributes, too. The weights are buffers with names such as "N_weight".
    """

    def __init__(
        self,
        size: int,
        start: int,
        outputs: Mapping[str, int],
        nodes: Sequence[Node],
        weights: Mapping[str, torch.Tensor],
    ) -> None:
        super().__init__()
        self.size = size
        self.start, self.outputs, self.nodes = start, dict(outputs), tuple(nodes)
        for name, tensor in weights.items():
            # Channels come last, so that convolutions of 1 x 1, which most of them are, are products of matrices.
            form = torch.channels_last if tensor.dim() == 4 else torch.contiguous_format
            self.register_buffer(name.replace(".", "_"), tensor.float().contiguous(memory_format=form))
        last = {number: index for index, node in enumerate(self.nodes) for number in node.inputs}
        self._done = [
            [number for number in set(node.inputs) if last[number] == index and number not in self.outputs.values()]
            for index, node in enumerate(self.nodes)
        ]

    def showing(self, more: Mapping[str, int]) -> OperatorGraph:
        """Graph that shows more of its values, by name and number; it has the same weights."""
        weights = {name.replace("_", "."): values for name, values in self.named_buffers()}
        return OperatorGraph(self.size, self.start, {**self.outputs, **more}, self.nodes, weights)

    def forward(self, pictures: torch.Tensor) -> dict[str, torch.Tensor]:
        """Compute the outputs by name, for pictures of shape (B, 3, size, size)."""
        if not pictures.is_cuda:
            return self._run(pictures)  # several threads at a time, which must not change torch's settings
        with exact_convolutions():
            return self._run(pictures)

    def _run(self, pictures: torch.Tensor) -> dict[str, torch.Tensor]:
        values = {self.start: pictures.contiguous(memory_format=torch.channels_last)}
        for node, done in zip(self.nodes, self._done, strict=True):
            values[node.output] = self._computed(node, [values[number] for number in node.inputs])
            for number in done:  # otherwise, a batch would keep all of its activations
                del values[number]
        return {name: values[number] for name, number in self.outputs.items()}

    def _computed(self, node: Node, inputs: list[torch.Tensor]) -> torch.Tensor:
        if node.kind == "convolution":
            inputs = [*inputs, *self._weights(node)]
        return KINDS[node.kind](node, *inputs)

    def _weights(self, node: Node) -> tuple[torch.Tensor, torch.Tensor]:
        """Weight and bias of a convolution."""
        return getattr(self, f"{node.output}_weight"), getattr(self, f"{node.output}_bias")
