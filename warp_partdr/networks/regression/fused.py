"""The label network in bfloat16 for CUDA: a convolution, its normalisation, a sum and what is cut off in one launch.

Torch alone makes a launch of each, which passes through memory as often. Of few people, launches take three times as
long as what they launch: these are captured.
"""

from __future__ import annotations

from copy import deepcopy
from functools import lru_cache
from weakref import WeakKeyDictionary

import torch
import torch.nn.functional as F
from torch import nn
from torch.nn.utils.fusion import fuse_conv_bn_weights

from ...interop.captured_call import CapturedCall
from ...interop.graph_cache import graphs
from ...interop.layouts import Tensors
from .label_network import EVEN_CHANNELS, LabelNetwork, ResidualBlock
from .predicted import Predicted

_MOST_CAPTURED = 1024  # people; of more, launches are short beside their work, and graphs would hold much memory
_Known = tuple[list[torch.Tensor], list[int], LabelNetwork]
_fused: WeakKeyDictionary[LabelNetwork, _Known] = WeakKeyDictionary()


def ask_fused(
    network: LabelNetwork, shares: torch.Tensor, keypoints: torch.Tensor, conditions: torch.Tensor
) -> Predicted:
    """Bodies on CUDA, from features in bfloat16. Inputs are those of ``forward``; few people are captured."""
    fused, inputs = fused_network(network), (shares, keypoints, conditions)
    if len(shares) <= _MOST_CAPTURED:
        key = ask_fused, fused, tuple([(each.shape, each.dtype) for each in inputs])
        make = lambda: CapturedCall(lambda held: ask_with(network, fused, held, half=True), inputs)  # noqa: E731
        captured = graphs.find(key, shares.device, 0, make)
        if captured is not None:
            # A copy, because the next call fills the buffers again.
            return captured(inputs).select(torch.arange(len(shares), device=shares.device))
    return ask_with(network, fused, inputs, half=True)


def ask_with(network: LabelNetwork, encoder: LabelNetwork, inputs: Tensors, *, half: bool) -> Predicted:
    """Bodies of the inputs of ``forward``, from an encoder's ``features``, with ``half`` in bfloat16.

    Bodies are made of features in float32 all the same: three corrections in bfloat16 would add up their rounding.
    """
    with torch.autocast(inputs[0].device.type, torch.bfloat16, enabled=half):
        features = encoder.features(*inputs)
    return network.bodies(features.float(), inputs[1])


def fused_network(network: LabelNetwork) -> LabelNetwork:
    """A network for its ``features`` alone, in evaluation mode, kept until the weights change."""
    kept = _fused.get(network)
    if kept is not None:
        weights, versions, fused = kept  # looked up once, which takes a quarter of an answer's time
        same = weights[0] is network.stem[0].weight and weights[0].device == fused.stem[0].weight.device
        if same and [each._version for each in weights] == versions:
            return fused
    weights = [*network.parameters(), *network.buffers()]
    _fused[network] = weights, [each._version for each in weights], _fuse(network)
    return _fused[network][2]


@torch.no_grad()
def _fuse(network: LabelNetwork) -> LabelNetwork:
    fused = deepcopy(network)
    first, norm, _ = network.stem
    fused.stem = nn.Sequential(_FusedConvolution(first, norm, channels=EVEN_CHANNELS))
    fused.add_module("coarse", _FusedBlock(network.coarse))
    fused.stages = nn.Sequential(
        *(_FusedBlock(each) if isinstance(each, ResidualBlock) else each for each in fused.stages)
    )
    return fused.eval()


class _FusedConvolution(nn.Module):
    """Convolution, normalisation, the sum with something where that is given, and a cut at 0 where ``cut`` says so."""

    def __init__(self, convolution: nn.Module, norm: nn.Module, *, channels: int = 0, cut: bool = True) -> None:
        super().__init__()
        assert isinstance(convolution, nn.Conv2d)
        assert isinstance(norm, nn.BatchNorm2d)
        assert norm.running_mean is not None
        assert norm.running_var is not None
        statistics = norm.running_mean, norm.running_var, norm.eps, norm.weight, norm.bias
        folded, bias = fuse_conv_bn_weights(convolution.weight, convolution.bias, *statistics)
        weight = F.pad(folded.detach(), (0, 0, 0, 0, 0, max(channels - folded.shape[1], 0)))
        weight = weight.bfloat16().contiguous(memory_format=torch.channels_last)
        self.register_buffer("weight", weight)
        self.register_buffer("bias", bias.detach().bfloat16())
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
        if self.cut and values.is_cuda and fuses(values.device):
            if added is None:
                return torch.cudnn_convolution_relu(values, self.weight, self.bias, stride, padding, still, 1)
            summed = values, self.weight, added, 1.0, self.bias
            return torch.cudnn_convolution_add_relu(*summed, stride, padding, still, 1)
        with torch.autocast(values.device.type, enabled=False):
            found = F.conv2d(values, self.weight, self.bias, stride, padding)
        found = found if added is None else found.add_(added)
        return found.relu_() if self.cut else found


class _FusedBlock(nn.Module):
    def __init__(self, block: ResidualBlock) -> None:
        super().__init__()
        first, first_norm, _, second, second_norm = block.body
        self.first, self.second = _FusedConvolution(first, first_norm), _FusedConvolution(second, second_norm)
        self.past: nn.Module = nn.Identity()
        if isinstance(block.past, nn.Sequential):
            self.past = _FusedConvolution(*block.past, cut=False)

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
