"""Uncertainty of a predicted body, and its distance: what the label network says beside the body itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import nn

from ...body.pose_prior import FREE_PARTS
from ...body.template import BONE_STARTS, JOINT_NAMES
from ...interop.movable import Movable

_WIDTH = 192  # of the layer between
_NUM_DEPTHS = len(JOINT_NAMES) - 1  # the pelvis is the origin
_NUM_TURNS = 1 + len(FREE_PARTS)
_SURE = 1e-3  # smallest spread [m or rad]
_COMMON = (0.05, 0.3, 0.3)  # depths' spread [m], rotations' [rad], and nearness [1/m], where training begins


@dataclass(frozen=True)
class Uncertainty(Movable):
    """Spreads of B predicted bodies, half widths of intervals that hold the truth in 68 % of cases; and a distance.

    Attributes:
        depths: Uncertainty of the depth of ``JOINT_NAMES`` except the pelvis, relative to the pelvis, along the view
            [m], shape (B, 20).
        turns: Uncertainty of the global orientation and of the rotations of ``FREE_PARTS``, as angles [rad], shape (B,
            19).
        nearness: Inverse of the camera's distance from the pelvis, 0 = far [1/m], shape (B,).
    """

    depths: torch.Tensor
    turns: torch.Tensor
    nearness: torch.Tensor

    def centre_depths(self) -> torch.Tensor:
        """Depth spreads of the parts' centres, the mean of both joints' [m], shape (B, 20); the pelvis' own is 0."""
        every = torch.nn.functional.pad(self.depths, (1, 0))
        return (every[:, 1:] + every[:, BONE_STARTS]) / 2

    def resized(self, shares: torch.Tensor) -> Uncertainty:
        """Uncertainty of bodies that are ``shares`` times as large, shape (B,), and as much farther away."""
        return replace(self, depths=self.depths * shares[:, None], nearness=self.nearness / shares)

    def widened(self, factor: float) -> Uncertainty:
        """Uncertainties that are multiplied by a factor. The distance stays."""
        return replace(self, depths=self.depths * factor, turns=self.turns * factor)

    @classmethod
    def joined(cls, parts: Sequence[Uncertainty]) -> Uncertainty:
        """Join the uncertainties of several batches in one batch."""
        return cls(**{name: torch.cat([getattr(each, name) for each in parts]) for name in vars(parts[0])})

    def with_rows(self, rows: torch.Tensor, other: Uncertainty) -> Uncertainty:
        """Uncertainties of bodies of which those at ``rows``, shape (N,), are N others."""
        return Uncertainty(
            **{name: value.index_copy(0, rows, getattr(other, name)) for name, value in vars(self).items()}
        )

    def select(self, index: torch.Tensor | slice) -> Uncertainty:
        """Some of the bodies'."""
        return Uncertainty(**{name: value[index] for name, value in vars(self).items()})


class UncertaintyHead(nn.Module):
    """Network from ``features`` numbers of a person to the body's uncertainty."""

    def __init__(self, features: int) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(features, _WIDTH), nn.ReLU(), nn.Linear(_WIDTH, _NUM_DEPTHS + _NUM_TURNS + 1)
        )
        last = self.layers[-1]
        assert isinstance(last, nn.Linear)
        nn.init.normal_(last.weight, std=1e-3)
        counts = torch.tensor([_NUM_DEPTHS, _NUM_TURNS, 1])
        with torch.no_grad():
            last.bias.copy_(torch.tensor(_COMMON).log().repeat_interleave(counts))

    def forward(self, features: torch.Tensor) -> Uncertainty:
        """Uncertainties of features (B, F)."""
        said = self.layers(features).float().clamp(-10.0, 3.0).exp()
        return Uncertainty(
            said[:, :_NUM_DEPTHS].clamp_min(_SURE), said[:, _NUM_DEPTHS:-1].clamp_min(_SURE), said[:, -1]
        )
