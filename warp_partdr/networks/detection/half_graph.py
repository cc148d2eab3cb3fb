"""Graphs of operators in float16 for CUDA, which move half as much memory, with few launches.

Numbers such as positions need more digits than float16 has. They are computed from the last features in float32.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F

from ...interop.arrays import warp_array
from ...interop.streams import on_torch_stream
from ...kernels import depthwise
from .graph import KINDS, Node, OperatorGraph, convolve

_A_PICTURE = 2**28  # [bytes], memory that a device has for each picture of a graph, which takes some hundredths of it
_NUMBERS = ("rows", "sigmoid")  # operators whose numbers are a convolution's, rearranged or squashed
_LARGEST = torch.finfo(torch.float16).max
_LIMITS = {"none": (-_LARGEST, _LARGEST), "relu": (0.0, _LARGEST), "relu6": (0.0, 6.0)}


class HalfGraph(OperatorGraph):
    """Graph of a network in float16; its outputs are float32.

    Convolutions of 1 x 1 are products of matrices. A kernel of this package computes depthwise convolutions. It also
    applies the activation of the product before it.

    Args:
        graph: Graph in float32.
    """

    def __init__(self, graph: OperatorGraph) -> None:
        weights = {name.replace("_", "."): values for name, values in graph.named_buffers()}
        super().__init__(graph.size, graph.start, graph.outputs, graph.nodes, weights)
        self._exact = _numbers(graph)
        for node in self.nodes:
            if node.kind == "convolution" and node.output not in self._exact:
                weight = getattr(self, f"{node.output}_weight").half()
                bias = getattr(self, f"{node.output}_bias").half()
                if _is_depthwise(node, weight):
                    weight = weight[:, 0].permute(1, 2, 0).contiguous()
                setattr(self, f"{node.output}_weight", weight)
                setattr(self, f"{node.output}_bias", bias)
        by_channel = {node.output for node in self.nodes if self._weight(node).dim() == 3}
        self._uncut = {
            node.output: node.activation
            for node in self.nodes
            if node.kind == "convolution"
            and node.output not in by_channel | self._exact | set(self.outputs.values())
            and all(other.output in by_channel for other in self.nodes if node.output in other.inputs)
        }

    def most_captured(self, device: torch.device) -> int:
        """Number of pictures up to which graphs are captured, as in ``OperatorGraph``.

        The host takes twice as long to launch this network as a device takes to compute it.
        """
        return min(torch.cuda.get_device_properties(device).total_memory // _A_PICTURE, 256)

    def _weight(self, node: Node) -> torch.Tensor:
        return getattr(self, f"{node.output}_weight") if node.kind == "convolution" else torch.empty(0)

    def _run(self, pictures: torch.Tensor) -> dict[str, torch.Tensor]:
        with on_torch_stream(pictures.device):
            return {name: values.float() for name, values in super()._run(pictures.half()).items()}

    def _computed(self, node: Node, inputs: list[torch.Tensor]) -> torch.Tensor:
        if node.output in self._exact:
            return super()._computed(node, [values.float() for values in inputs])
        if node.kind != "convolution":
            return KINDS[node.kind](node, *inputs)
        weight, bias = self._weight(node), getattr(self, f"{node.output}_bias")
        activation = "none" if node.output in self._uncut else node.activation
        if weight.dim() == 3:
            limits = _LIMITS[self._uncut.get(node.inputs[0], "none")], _LIMITS[activation]
            return _by_channel(node, inputs[0], weight, bias, limits)
        if weight.shape[2:] == (1, 1):
            values = F.linear(inputs[0].permute(0, 2, 3, 1), weight[:, :, 0, 0], bias).permute(0, 3, 1, 2)
            return values if activation == "none" else values.clamp_(*_LIMITS[activation])
        return convolve(node, inputs[0], weight, bias, activation)


def _numbers(graph: OperatorGraph) -> set[int]:
    """Indices of values that are numbers rather than maps: rows, and the convolutions that they come from."""
    found = set(graph.outputs.values())
    rows: set[int] = set()
    for node in reversed(graph.nodes):
        if node.output in rows or (node.output in found and node.kind in _NUMBERS):
            rows.add(node.output)
            if node.kind in _NUMBERS:
                rows |= set(node.inputs)
    return rows


def _is_depthwise(node: Node, weight: torch.Tensor) -> bool:
    square = weight.shape[2] == weight.shape[3]
    return bool(weight.shape[1] == 1 and node.groups == len(weight) and square) and not len(weight) % depthwise.TOGETHER


def _by_channel(
    node: Node,
    values: torch.Tensor,
    weight: torch.Tensor,
    bias: torch.Tensor,
    limits: tuple[tuple[float, float], tuple[float, float]],
) -> torch.Tensor:
    values = values.permute(0, 2, 3, 1).contiguous()
    batch, height, width, channels = values.shape
    size, (left, right, above, below) = len(weight), node.zeros
    rows = (height + above + below - size) // node.stride + 1
    columns = (width + left + right - size) // node.stride + 1
    found = values.new_empty(batch, rows, columns, channels)
    words = [warp_array(each.view(torch.int64).flatten()) for each in (values, weight, bias)]
    numbers = [height, width, channels // depthwise.TOGETHER, size, node.stride, left, above]
    depthwise.launch_depthwise(words, numbers, limits, warp_array(found.view(torch.int64).flatten(2)))
    return found.permute(0, 3, 1, 2)
