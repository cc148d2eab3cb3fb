"""Heads beside EllipBodyNet's regressor: keypoints as heat maps, and part segmentation (paper, section 3.4).

Both are three deconvolutions and a 1x1 convolution (Xiao et al., 2018: simple baselines), eight times finer than the
backbone's last feature map: 64x64 for a picture of 256x256.
"""

from __future__ import annotations

import torch
from torch import nn

_DECONVOLUTIONS = 3
_SURE_SPREAD = 0.1  # [half-sides of the crop], 13 px of 256: a heat map spread so wide is of confidence 0.6


class DeconvolutionHead(nn.Module):
    """Feature maps (B, channels, h, w) to maps (B, outputs, 8h, 8w), with ``width`` channels in between."""

    def __init__(self, channels: int, outputs: int, width: int) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for before in (channels, *[width] * (_DECONVOLUTIONS - 1)):
            layers += [
                nn.ConvTranspose2d(before, width, 4, stride=2, padding=1, bias=False),
                nn.BatchNorm2d(width),
                nn.ReLU(),
            ]
        self.layers = nn.Sequential(*layers, nn.Conv2d(width, outputs, 1))

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """Logits."""
        maps: torch.Tensor = self.layers(features)
        return maps


def soft_argmax(heatmaps: torch.Tensor) -> torch.Tensor:
    """Mean of each heat map, and a confidence that falls with its spread.

    Args:
        heatmaps: Logits, shape (B, L, h, w); a softmax makes probabilities of each map.

    Returns:
        Crop coordinates (-1 to 1) and confidence (0 to 1), shape (B, L, 3), float32.
    """
    means, variances = heat_moments(heatmaps)
    confidence = (-variances.sum(-1).clamp_min(0.0) / (2 * _SURE_SPREAD**2)).exp()
    return torch.cat([means, confidence[..., None]], dim=-1)


def heat_moments(heatmaps: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Means and variances of heat maps across and down, in crop coordinates (-1 to 1), shape (B, L, 2) each, float32.

    Args:
        heatmaps: Logits, shape (B, L, h, w); a softmax makes probabilities of each map.
    """
    height, width = heatmaps.shape[-2:]
    probabilities = heatmaps.float().flatten(2).softmax(-1).unflatten(2, (height, width))
    means, variances = [], []
    for size, share in ((width, probabilities.sum(2)), (height, probabilities.sum(3))):
        positions = cell_centres(size, share.device)
        mean = (share * positions).sum(-1)  # no matrix product, which autocast would round
        means.append(mean)
        variances.append((share * positions.square()).sum(-1) - mean.square())
    return torch.stack(means, dim=-1), torch.stack(variances, dim=-1)


def cell_centres(size: int, device: torch.device) -> torch.Tensor:
    """Crop coordinates of the middles of ``size`` cells, shape (size,)."""
    return (torch.arange(size, device=device) + 0.5) * (2 / size) - 1
