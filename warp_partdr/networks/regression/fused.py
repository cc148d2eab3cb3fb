"""The label network for CUDA: convolutions that are fused with their normalisation, and graphs for few people.

In bfloat16, a convolution, its normalisation, a sum and what is cut off are one launch. Torch alone makes a launch of
each, which passes through memory as often. In float32, for few people, convolutions are products of matrices, because
the first call would wait for cuDNN (``convolve_windows``). Launches for few people take three times as long as their
work: they are captured.
"""

from __future__ import annotations

from copy import deepcopy
from functools import lru_cache, partial
from weakref import WeakKeyDictionary

import torch
import torch.nn.functional as F
from torch import nn
from torch.nn.utils.fusion import fuse_conv_bn_weights

from ...interop.captured_call import CapturedCall
from ...interop.graph_cache import graphs
from ...interop.layouts import Tensors
from ..window_products import convolve_windows
from .label_network import EVEN_CHANNELS, LabelNetwork, ResidualBlock
from .mirror import mean_with_images
from .predicted import Predicted

_MOST_WINDOWS = 32  # pictures in float32, whose windows take up to 10 MB each
_MOST_CAPTURED = 1024  # people; of more, launches are short beside their work, and graphs would hold much memory
_Known = tuple[list[torch.Tensor], list[int], LabelNetwork]
_fused: WeakKeyDictionary[LabelNetwork, dict[torch.dtype, _Known]] = WeakKeyDictionary()


def is_fused(inputs: Tensors, *, half: bool) -> bool:
    """True if ``ask_fused`` answers such inputs faster than the network itself: on CUDA, in float32 for few people."""
    return inputs[0].is_cuda and (half or len(inputs[0]) <= _MOST_WINDOWS)


def ask_fused(network: LabelNetwork, inputs: Tensors, *, half: bool, images: bool) -> Predicted:
    """Bodies on CUDA, as ``ask_with`` returns them; few people are captured."""
    fused = fused_network(network, torch.bfloat16 if half else torch.float32)
    if len(inputs[0]) <= _MOST_CAPTURED:
        key = ask_fused, fused, images, tuple([(each.shape, each.dtype) for each in inputs])
        ask = partial(ask_with, network, fused, half=half, images=images)
        captured = graphs.find(key, inputs[0].device, 0, lambda: CapturedCall(ask, inputs))
        if captured is not None:
            result = captured(inputs)
            # A copy, because the next call fills the buffers again.
            return result.select(torch.arange(len(result.shift), device=result.shift.device))
    return ask_with(network, fused, inputs, half=half, images=images)


def ask_with(network: LabelNetwork, encoder: LabelNetwork, inputs: Tensors, *, half: bool, images: bool) -> Predicted:
    """Bodies of the inputs of ``forward``, from an encoder's ``features``.

    Bodies are made of features in float32 all the same: three corrections in bfloat16 would add up their rounding.

    Args:
        network: Network that makes bodies of features.
        encoder: Network that makes features, perhaps the same.
        inputs: Inputs of ``forward``.
        half: True for features in bfloat16.
        images: True if people's mirror images follow them, as many as they are (``mean_with_images``).
    """
    with torch.autocast(inputs[0].device.type, torch.bfloat16, enabled=half):
        features = encoder.features(*inputs)
    bodies = network.bodies(features.float(), inputs[1])
    return mean_with_images(bodies) if images else bodies


def fused_network(network: LabelNetwork, dtype: torch.dtype = torch.bfloat16) -> LabelNetwork:
    """A network for its ``features`` alone, in evaluation mode, kept until the weights change."""
    kept = _fused.setdefault(network, {}).get(dtype)
    if kept is not None:
        weights, versions, fused = kept  # looked up once, which takes a quarter of an answer's time
        same = weights[0] is network.stem[0].weight and weights[0].device == fused.stem[0].weight.device
        if same and [each._version for each in weights] == versions:
            return fused
    weights = [*network.parameters(), *network.buffers()]
    fused = _fuse(network, dtype)
    _fused[network][dtype] = weights, [each._version for each in weights], fused
    return fused


@torch.no_grad()
def _fuse(network: LabelNetwork, dtype: torch.dtype) -> LabelNetwork:
    fused = deepcopy(network)
    first, norm, _ = network.stem
    fused.stem = nn.Sequential(_FusedConvolution(first, norm, dtype, channels=EVEN_CHANNELS))
    fused.add_module("coarse", _FusedBlock(network.coarse, dtype))
    fused.stages = nn.Sequential(*(_fused_stage(each, dtype) for each in fused.stages))
    return fused.eval()


def _fused_stage(stage: nn.Module, dtype: torch.dtype) -> nn.Module:
    if isinstance(stage, ResidualBlock):
        return _FusedBlock(stage, dtype)
    if isinstance(stage, nn.Conv2d) and dtype == torch.float32:
        return _FusedConvolution(stage, None, dtype, cut=False)
    return stage


class _FusedConvolution(nn.Module):
    """Convolution, normalisation, the sum with something where that is given, and a cut at 0 where ``cut`` says so."""

    def __init__(
        self,
        convolution: nn.Module,
        norm: nn.Module | None,
        dtype: torch.dtype,
        *,
        channels: int = 0,
        cut: bool = True,
    ) -> None:
        super().__init__()
        assert isinstance(convolution, nn.Conv2d)
        folded, bias = convolution.weight, convolution.bias
        if norm is not None:
            assert isinstance(norm, nn.BatchNorm2d)
            assert norm.running_mean is not None
            assert norm.running_var is not None
            statistics = norm.running_mean, norm.running_var, norm.eps, norm.weight, norm.bias
            folded, bias = fuse_conv_bn_weights(folded, bias, *statistics)
        assert bias is not None
        weight = F.pad(folded.detach(), (0, 0, 0, 0, 0, max(channels - folded.shape[1], 0)))
        weight = weight.to(dtype).contiguous(memory_format=torch.channels_last)
        self.register_buffer("weight", weight)
        self.register_buffer("bias", bias.detach().to(dtype))
        self.weight: torch.Tensor
        self.bias: torch.Tensor
        assert not isinstance(convolution.padding, str)
        self.stride, self.padding, self.cut = convolution.stride, convolution.padding, cut

    def forward(self, values: torch.Tensor, added: torch.Tensor | None = None) -> torch.Tensor:
        """Values (B, C, H, W), and what is added to their convolution."""
        more = self.weight.shape[1] - values.shape[1]
        if more:
            values = F.pad(values, (0, 0, 0, 0, 0, more))
        values = values.to(self.weight.dtype, memory_format=torch.channels_last)
        stride, padding, still = self.stride, self.padding, (1, 1)
        if self.weight.dtype == torch.float32:
            zeros = padding[1], padding[1], padding[0], padding[0]
            found = convolve_windows(values, self.weight, self.bias, stride[0], zeros)
        elif self.cut and values.is_cuda and fuses(values.device):
            if added is None:
                return torch.cudnn_convolution_relu(values, self.weight, self.bias, stride, padding, still, 1)
            summed = values, self.weight, added, 1.0, self.bias
            return torch.cudnn_convolution_add_relu(*summed, stride, padding, still, 1)
        else:
            with torch.autocast(values.device.type, enabled=False):
                found = F.conv2d(values, self.weight, self.bias, stride, padding)
        found = found if added is None else found.add_(added)
        return found.relu_() if self.cut else found


class _FusedBlock(nn.Module):
    def __init__(self, block: ResidualBlock, dtype: torch.dtype) -> None:
        super().__init__()
        first, first_norm, _, second, second_norm = block.body
        self.first = _FusedConvolution(first, first_norm, dtype)
        self.second = _FusedConvolution(second, second_norm, dtype)
        self.past: nn.Module = nn.Identity()
        if isinstance(block.past, nn.Sequential):
            past, past_norm = block.past
            self.past = _FusedConvolution(past, past_norm, dtype, cut=False)

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        values = values.to(self.first.weight.dtype, memory_format=torch.channels_last)
        return self.second(self.first(values), self.past(values))


@lru_cache(maxsize=8)
def fuses(device: torch.device) -> bool:
    """True if cuDNN fuses convolutions there, and rightly: torch has these functions without a promise."""
    generator = torch.Generator(device).manual_seed(0)

    def drawn(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, device=device, generator=generator).bfloat16()

    values, added = (drawn(2, 16, 8, 8).contiguous(memory_format=torch.channels_last) for _ in range(2))
    weight = drawn(16, 16, 3, 3).contiguous(memory_format=torch.channels_last)
    bias, ones = drawn(16), (1, 1)
    try:
        alone = torch.cudnn_convolution_relu(values, weight, bias, ones, ones, ones, 1)
        summed = torch.cudnn_convolution_add_relu(values, weight, added, 1.0, bias, ones, ones, ones, 1)
    except (RuntimeError, AttributeError, TypeError):
        return False
    with torch.autocast(device.type, enabled=False):  # a network that asks is within it
        exact = F.conv2d(values.float(), weight.float(), bias.float(), padding=1)
    pairs = ((alone, exact.relu()), (summed, (exact + added.float()).relu()))
    return all(bool(torch.allclose(found.float(), expected, rtol=0.05, atol=0.5)) for found, expected in pairs)
