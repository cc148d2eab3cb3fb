"""Attention between landmarks: each knows where its keypoint is and what the picture shows there, and asks the others.

A transformer's encoder (Vaswani et al., 2017) whose tokens are the landmarks, as in PoseFormer (Zheng et al., 2021);
that each sees maps of the picture at its own place is of PyMAF (Zhang et al., 2021).
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import nn

from .landmarks import LANDMARKS

_HEADS = 4
_SAID = 16  # numbers that a landmark says in the end
NUM_SAID = _SAID * len(LANDMARKS)


class LandmarkAttention(nn.Module):
    """Network from feature maps and ``numbers`` numbers for each keypoint to features (B, ``NUM_SAID``)."""

    def __init__(self, channels: Sequence[int], numbers: int, *, width: int, layers: int) -> None:
        super().__init__()
        self.shown = nn.Linear(sum(channels), width)
        self.told = nn.Linear(numbers, width)
        self.names = nn.Parameter(0.1 * torch.randn(len(LANDMARKS), width))
        layer = nn.TransformerEncoderLayer(
            width, _HEADS, 2 * width, dropout=0.0, activation="gelu", batch_first=True, norm_first=True
        )
        self.layers = nn.TransformerEncoder(layer, layers, nn.LayerNorm(width), enable_nested_tensor=False)
        self.said = nn.Linear(width, _SAID)

    def forward(self, maps: Sequence[torch.Tensor], keypoints: torch.Tensor, conditions: torch.Tensor) -> torch.Tensor:
        """Features.

        Args:
            maps: Feature maps of any sizes, each of shape (B, C, H, W).
            keypoints: Crop coordinates and confidence, all 0 where missing, shape (B, 24, 3).
            conditions: Conditions that ``network_conditions`` returns, shape (B, C). Each landmark is given these and
                its keypoint.
        """
        inputs = torch.cat([keypoints, conditions[:, None].expand(-1, keypoints.shape[1], -1)], dim=2)
        tokens = self.shown(at_keypoints(maps, keypoints)) + self.told(inputs) + self.names
        features: torch.Tensor = self.said(self.layers(tokens)).flatten(1)
        return features


def at_keypoints(maps: Sequence[torch.Tensor], keypoints: torch.Tensor) -> torch.Tensor:
    """Values of all maps at keypoints (B, L, 3), interpolated between cells, (B, L, sum of C); 0 where missing."""
    positions = keypoints[:, None, :, :2].float()
    shown = [nn.functional.grid_sample(each.float(), positions, align_corners=False)[:, :, 0] for each in maps]
    return torch.where(keypoints[..., 2:] > 0, torch.cat(shown, dim=1).mT, 0.0)
