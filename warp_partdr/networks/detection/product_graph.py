"""Graphs of operators for CUDA, in float32 or float16: few launches, which are captured, and a short first call.

In float16, half as much memory is moved. Numbers such as positions need more digits than float16 has. They are computed
from the last features in float32.
"""

from __future__ import annotations

import threading
from functools import lru_cache
from typing import Any

import torch

from ...interop.arrays import warp_array
from ...interop.captured_step import CapturedStep
from ...interop.precision import matmul_precision
from ...interop.streams import on_torch_stream
from ...kernels import depthwise
from ..window_products import convolve_windows
from .graph import KINDS, Node, OperatorGraph, activate, convolve

_MOST = {torch.float32: 16, torch.float16: 256}  # pictures at a time; with more, launches take little of the time
_A_PICTURE = 2**28  # [bytes], memory that a device has for each picture of a graph, which takes some hundredths of it
_NUMBERS = ("rows", "sigmoid")  # operators whose numbers are a convolution's, rearranged or squashed


class ProductGraph(OperatorGraph):
    """Graph of a network whose convolutions are products of matrices; its outputs are float32.

    A kernel of this package computes depthwise convolutions. It also applies the activation of the product before it.
    So cuDNN is not needed. Pictures are asked for in batches of few sizes, because each new size is captured anew.

    Args:
        graph: Graph in float32.
        dtype: Type of the weights and of the maps, float32 or float16.
    """

    def __init__(self, graph: OperatorGraph, dtype: torch.dtype = torch.float32) -> None:
        weights = {name.replace("_", "."): values for name, values in graph.named_buffers()}
        super().__init__(graph.size, graph.start, graph.outputs, graph.nodes, weights)
        self._dtype = dtype
        self._exact = _numbers(graph) if dtype == torch.float16 else set()
        self._captured: dict[tuple[int, int], tuple[torch.Tensor, CapturedStep[dict[str, torch.Tensor]]]] = {}
        self._lock = threading.Lock()  # guards the buffers of the captured graphs
        convolutions = [node for node in self.nodes if node.kind == "convolution"]
        for node in convolutions:
            if node.output not in self._exact:
                weight, bias = self._weights(node)
                if _is_depthwise(node, weight):
                    weight = weight[:, 0].permute(1, 2, 0).contiguous().permute(2, 0, 1)[:, None]
                setattr(self, f"{node.output}_weight", weight.to(dtype))
                setattr(self, f"{node.output}_bias", bias.to(dtype))
        self._by_channel = {
            node.output
            for node in convolutions
            if node.output not in self._exact and _is_depthwise(node, self._weights(node)[0])
        }
        self._uncut = {
            node.output: node.activation
            for node in convolutions
            if node.groups == 1
            and node.output not in self._exact | set(self.outputs.values())
            and all(other.output in self._by_channel for other in self.nodes if node.output in other.inputs)
        }

    def forward(self, pictures: torch.Tensor) -> dict[str, torch.Tensor]:
        """Compute the outputs by name, for pictures of shape (B, 3, size, size)."""
        parts = [self._asked(part) for part in pictures.split(self._most(pictures.device))]
        if len(parts) == 1:
            return parts[0]
        return {name: torch.cat([part[name] for part in parts]) for name in self.outputs}

    def _most(self, device: torch.device) -> int:
        """Largest number of pictures that are computed at a time."""
        most = _MOST[self._dtype]
        if device.type != "cuda":
            return most
        return max(min(torch.cuda.get_device_properties(device).total_memory // _A_PICTURE, most), 1)

    def _asked(self, pictures: torch.Tensor) -> dict[str, torch.Tensor]:
        """Outputs for at most ``_most`` pictures, from a batch of the next size."""
        count = len(pictures)
        room = batch_room(count)
        if not pictures.is_cuda:
            held = pictures.new_zeros(room, *pictures.shape[1:])
            held[:count] = pictures
            return {name: values[:count] for name, values in self._run(held).items()}
        key = room, torch.cuda.current_stream(pictures.device).cuda_stream
        with self._lock:
            if key not in self._captured:
                held = pictures.new_zeros(room, *pictures.shape[1:])
                with matmul_precision("highest"):
                    self._captured[key] = held, CapturedStep(lambda: self._run(held), pictures.device)
            held, step = self._captured[key]
            held[:count].copy_(pictures)
            step.replay()
            return {name: values[:count].clone() for name, values in step.result.items()}

    def _run(self, pictures: torch.Tensor) -> dict[str, torch.Tensor]:
        with on_torch_stream(pictures.device):
            return {name: values.float() for name, values in super()._run(pictures.to(self._dtype)).items()}

    def _computed(self, node: Node, inputs: list[torch.Tensor]) -> torch.Tensor:
        if node.output in self._exact:
            inputs = [values.float() for values in inputs]
        if node.kind != "convolution":
            return KINDS[node.kind](node, *inputs)
        weight, bias = self._weights(node)
        activation = "none" if node.output in self._uncut else node.activation
        if node.output in self._by_channel:
            return _by_channel(node, inputs[0], weight, bias, self._uncut.get(node.inputs[0], "none"))
        if node.groups > 1:
            return convolve(node, inputs[0], weight, bias)
        return activate(convolve_windows(inputs[0], weight, bias, node.stride, node.zeros), activation)


def batch_room(count: int) -> int:
    """Size of the batch in which so many pictures are computed: 4, 16, or a higher power of 2."""
    return 4 if count <= 4 else max(1 << (count - 1).bit_length(), 16)


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


def _limits(activation: str, dtype: torch.dtype) -> tuple[float, float]:
    """Least and most of what an activation lets pass."""
    most = torch.finfo(dtype).max
    return {"none": (-most, most), "relu": (0.0, most), "relu6": (0.0, 6.0)}[activation]


def _by_channel(
    node: Node, values: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor, before: str
) -> torch.Tensor:
    """Depthwise convolution of values that are cut off by the activation ``before`` as they are read."""
    values = values.permute(0, 2, 3, 1).contiguous()
    batch, height, width, channels = values.shape
    size, (left, right, above, below) = weight.shape[2], node.zeros
    rows = (height + above + below - size) // node.stride + 1
    columns = (width + left + right - size) // node.stride + 1
    found = values.new_empty(batch, rows, columns * channels)
    limits = *_limits(before, values.dtype), *_limits(node.activation, values.dtype)
    windows = _depthwise_windows(height, width, channels // depthwise.TOGETHER, size, node.stride, left, above, limits)
    weights = weight.permute(2, 3, 1, 0).flatten()
    depthwise.launch_depthwise(_words(values.flatten()), _words(weights), _words(bias), windows, _words(found))
    return found.view(batch, rows, columns, channels).permute(0, 3, 1, 2)


@lru_cache(maxsize=1024)  # it takes as long as a launch
def _depthwise_windows(
    height: int,
    width: int,
    words: int,
    size: int,
    stride: int,
    left: int,
    above: int,
    limits: tuple[float, float, float, float],
) -> Any:
    """Make ``DepthwiseWindows`` of its fields in their order."""
    windows = depthwise.DepthwiseWindows()
    windows.height, windows.width, windows.words = height, width, words
    windows.size, windows.stride = size, stride
    windows.left, windows.above = left, above
    windows.input_limits, windows.limits = limits[:2], limits[2:]
    return windows


def _words(values: torch.Tensor) -> object:
    """Channels (..., N) as an array (..., N / 4) of what a thread reads at once."""
    if values.dtype == torch.float16:
        return warp_array(values.view(torch.int64), depthwise.HALF_WORD)
    return warp_array(values.unflatten(-1, (-1, depthwise.TOGETHER)), depthwise.WORD)
