"""Label network: a body from part labels and keypoints, no colour, by a small convolutional encoder and a regressor.

Its input is independent of the label set and the keypoint format: a pixel holds the share of each of the 20 parts in
its label, of background and of unknown; keypoints are those of ``LANDMARKS`` that were found. The camera may be known,
or a usual lens be assumed, and the person's stature may be known (``network_conditions``).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import torch
from torch import nn

from ...body.labels import BACKGROUND, IGNORE, LabelSet
from ...body.template import NUM_PARTS
from ...errors import check_whole
from ...interop.arrays import warp_array
from ...interop.streams import launch_bodies_on
from ...kernels import label_rows
from .heads import cell_centres
from .landmark_attention import NUM_SAID, LandmarkAttention
from .landmarks import LANDMARKS
from .predicted import Predicted
from .regressor import Regressor, RegressorConfig
from .uncertainty import UncertaintyHead

NUM_CHANNELS = NUM_PARTS + 2  # the parts, background, unknown
EVEN_CHANNELS = 24  # the same in bfloat16, which products of matrices take eight at a time; the last ones are 0
_UNKNOWN = NUM_CHANNELS - 1
_HEATMAP_STRIDE = 4  # of the labels' pixels
_RAYS = 4  # the first numbers of ``network_conditions``
NUM_CONDITIONS = 6
KNOWN_LENS, USUAL_LENS = 1.0, 0.5  # certainty of a lens that is known, and of one that is assumed
_STATURE = 1.7  # [m], at which a known stature is 0
_STATURE_SCALE = 5.0  # of its logarithm, so that people differ by about 1
# [half-sides of the crop], focal length from which on cameras look alike, about 7 m away. Networks learn from those
# that end at 9 m: told of a farther one, they shrank the body.
_FARTHEST = 8.0
_SPREAD = 0.06  # standard deviation of a keypoint's spot, the crop's side being 2
# Of what places are described with: of 999 in 1,000 people they stay within 3. What fires once in a thousand pictures
# was hardly trained, and said 56 where others say 2: three corrections made a place kilometres away of it.
_MOST_SAID = 4.0
_MOST_FEATURES = 1 << 16  # of a picture's places; the packaged network has 768


@dataclass(frozen=True)
class LabelNetworkConfig:
    """Sizes of a label network.

    They are bounded, for a file that says a billion would otherwise fill the memory before its weights are looked at.

    Raises:
        ValueError: If a size is out of range.
    """

    size: int = 128  # [px], side of the label images, a multiple of 32
    channels: tuple[int, ...] = (32, 96, 144, 224, 256)  # of five stages, each at half the size of the one before
    places: int = 48  # channels that the last stage's places are described with
    keypoint_features: int = 256  # number of features made of the keypoints' coordinates
    attention_layers: int = 0  # of ``LandmarkAttention``; 0: without
    attention_width: int = 192  # of its tokens
    stature: bool = (
        False  # the network is told the person's stature where it is known, as packaged ones are from run 18
    )
    regressor: RegressorConfig = field(default_factory=RegressorConfig)

    def __post_init__(self) -> None:
        check_whole("size", self.size, 32, 512)
        check_whole("len(channels)", len(self.channels), 3, 8)
        for index, width in enumerate(self.channels):
            check_whole(f"channels[{index}]", width, 1, 1024)
        check_whole("places", self.places, 1, 256)
        check_whole("keypoint_features", self.keypoint_features, 1, 4096)
        check_whole("attention_layers", self.attention_layers, 0, 16)
        check_whole("attention_width", self.attention_width, 1, 1024)
        side = self.size >> len(self.channels)
        if self.places * side**2 > _MOST_FEATURES:
            fault = f"{self.places}, of {side} x {side} places"
            raise ValueError(f"places: {fault}; expected at most {_MOST_FEATURES} numbers in all")


def label_table(labels: LabelSet) -> torch.Tensor:
    """Shares of the parts, background and unknown in each group id, shape (256, 22); rows sum to 1."""
    table = np.zeros((256, NUM_CHANNELS), dtype=np.float32)
    table[:, _UNKNOWN] = 1.0  # ids that the set does not have, and 255
    for group in range(1, labels.num_groups + 1):
        table[group] = 0.0
        members = np.nonzero(labels.part_groups[1:] == group)[0]
        table[group, members] = 1.0 / len(members)
    table[BACKGROUND] = 0.0
    table[BACKGROUND, NUM_PARTS] = 1.0
    return torch.from_numpy(table)


def label_shares(groups: torch.Tensor, tables: torch.Tensor, which: torch.Tensor) -> torch.Tensor:
    """Look up each pixel's shares of the parts, background and unknown.

    Args:
        groups: Group ids, shape (B, S, S), of any number type.
        tables: Tables of N label sets, shape (N, 256, 22).
        which: Index of each image's label set, shape (B,), int64.

    Returns:
        Shares, shape (B, 22, S, S), channels last in memory, in the dtype of ``tables``.
    """
    found = tables.new_empty(*groups.shape, tables.shape[2])
    given = groups.byte().flatten(1).contiguous(), tables.contiguous().view(torch.int64), which.contiguous()
    words = found.flatten(1).view(torch.int64)

    def launch(part: slice) -> None:
        labels, rows = warp_array(given[0][part]), warp_array(given[1])
        label_rows.launch_rows(labels, rows, warp_array(given[2][part]), warp_array(words[part]))

    launch_bodies_on(groups.device, launch, len(groups), [label_rows])
    return found.permute(0, 3, 1, 2)


def map_shares(maps: torch.Tensor, known: torch.Tensor, table: torch.Tensor) -> torch.Tensor:
    """Shares of the parts, background and unknown from probability maps.

    Args:
        maps: Probability maps of the groups 1 to G, shape (B, G, S, S).
        known: Share of each pixel that is known, shape (B, S, S). The rest, up to 1, is unknown.
        table: Table of the label set, shape (256, 22).
    """
    known = known[:, None]
    background = (known - maps.sum(1, keepdim=True)).clamp_min(0.0)
    shares = torch.cat([background, maps, 1.0 - known], dim=1)
    rows = table[[*range(maps.shape[1] + 1), IGNORE]]
    return torch.einsum("bghw,gc->bchw", shares, rows)


def network_conditions(
    lenses: torch.Tensor, certainty: torch.Tensor, statures: torch.Tensor | None = None
) -> torch.Tensor:
    """Numbers that networks are told beside pixels and keypoints: the camera's rays, and the person's stature.

    Cameras are told by the tangents of their rays, which are finite however far away a camera is.

    Args:
        lenses: Focal length and principal point in crop coordinates, shape (B, 3).
        certainty: Certainty of each lens: ``KNOWN_LENS``, ``USUAL_LENS``, or 0 where nothing is known, shape (B,).
        statures: Known statures [m], 0 where unknown, shape (B,). If it is None, none is known.

    Returns:
        Conditions, shape (B, 6): the certainty; the tangents of the crop's half side, as from ``_FARTHEST`` at most,
        and of its middle, negative, across and down; 1 where the stature is known, and its scaled logarithm. All are 0
        where unknown.
    """
    focal = lenses[:, :1]
    rays = torch.cat([1 / focal.clamp_max(_FARTHEST), lenses[:, 1:] / focal], dim=1)
    rays = torch.where(certainty[:, None] > 0, rays, 0.0)
    tall = rays.new_zeros(len(rays), 2)
    if statures is not None:
        known = statures > 0
        logarithms = _STATURE_SCALE * (statures / _STATURE).log()
        tall = torch.stack([known.to(rays), torch.where(known, logarithms, 0.0).to(rays)], dim=1)
    return torch.cat([certainty[:, None].to(rays), rays, tall], dim=1)


class LabelNetwork(nn.Module):
    """Label shares, keypoints and conditions to bodies, as a camera sees them that looks at the pelvis."""

    def __init__(self, config: LabelNetworkConfig) -> None:
        super().__init__()
        self.config = config
        stem, *rest, last = config.channels
        self._conditions = NUM_CONDITIONS if config.stature else _RAYS
        self.stem = nn.Sequential(
            _Widening(NUM_CHANNELS, stem, 5, stride=2, padding=2, bias=False), nn.BatchNorm2d(stem), nn.ReLU()
        )
        self.coarse = ResidualBlock(stem, rest[0], stride=2)
        self.stages = nn.Sequential(
            ResidualBlock(rest[0] + len(LANDMARKS), rest[0]),
            *[
                block
                for before, after in pairwise(rest)
                for block in (ResidualBlock(before, after, stride=2), ResidualBlock(after, after))
            ],
            ResidualBlock(rest[-1], last, stride=2),
            nn.Conv2d(last, config.places, 1),
            nn.Flatten(),
            nn.Hardtanh(-_MOST_SAID, _MOST_SAID),
        )
        self._shown = range(0, 2 * len(rest), 2)  # the stages whose maps ``attention`` looks at, the last of each size
        keypoints = config.keypoint_features
        self.keypoints = nn.Sequential(
            nn.Linear(3 * len(LANDMARKS) + self._conditions, 2 * keypoints),
            nn.ReLU(),
            nn.Linear(2 * keypoints, keypoints),
            nn.ReLU(),
        )
        side = config.size // 2 ** len(config.channels)
        features = config.places * side**2 + keypoints
        if config.attention_layers:
            self.attention = LandmarkAttention(
                rest, 3 + self._conditions, width=config.attention_width, layers=config.attention_layers
            )
            features += NUM_SAID
        self.regressor = Regressor(features, config.regressor)
        self.uncertainty = UncertaintyHead(features)

    def forward(self, shares: torch.Tensor, keypoints: torch.Tensor, conditions: torch.Tensor) -> Predicted:
        """Bodies.

        Args:
            shares: Shares that ``label_shares`` or ``map_shares`` returns, shape (B, 22, S, S). More channels, of
                zeros, may follow.
            keypoints: Crop coordinates and confidence, all 0 where missing (``network_keypoints``), shape (B, 24, 3).
            conditions: Conditions that ``network_conditions`` returns, shape (B, 6).
        """
        return self.bodies(self.features(shares, keypoints, conditions), keypoints)

    def features(self, shares: torch.Tensor, keypoints: torch.Tensor, conditions: torch.Tensor) -> torch.Tensor:
        """Features that bodies are made of, (B, F), from the arguments of ``forward``."""
        heatmaps = draw_heatmaps(keypoints, self.config.size // _HEATMAP_STRIDE)
        coarse = self.coarse(self.stem(shares))
        heatmaps = heatmaps.to(coarse.dtype, memory_format=torch.channels_last)  # else what is joined is not
        seen, maps = torch.cat([coarse, heatmaps], dim=1), []
        for index, stage in enumerate(self.stages):
            seen = stage(seen)
            if index in self._shown:
                maps.append(seen)
        known = conditions[:, : self._conditions]
        found = [seen, self.keypoints(torch.cat([keypoints.flatten(1), known], dim=1))]
        if self.config.attention_layers:
            found.append(self.attention(maps, keypoints, known))
        return torch.cat([each.to(seen) for each in found], dim=1)

    def bodies(self, features: torch.Tensor, keypoints: torch.Tensor) -> Predicted:
        """Bodies of features (B, F) and of the keypoints (B, 24, 3) that these were made of."""
        predicted: Predicted = self.regressor(features, keypoints)
        return replace(predicted, uncertainty=self.uncertainty(features))


def draw_heatmaps(keypoints: torch.Tensor, size: int) -> torch.Tensor:
    """Draw keypoints (B, L, 3), crop coordinates and confidence, as spots as bright, shape (B, L, size, size)."""
    centres = cell_centres(size, keypoints.device)
    spots = (-0.5 * ((centres - keypoints[..., :2, None]) / _SPREAD).square()).exp()
    return keypoints[..., 2, None, None] * spots[..., 1, :, None] * spots[..., 0, None, :]


class _Widening(nn.Conv2d):
    """Convolution of inputs that may have more channels than weights, which don't count."""

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        """Values (B, ..., H, W)."""
        more = values.shape[1] - self.in_channels
        weight = nn.functional.pad(self.weight, (0, 0, 0, 0, 0, more)) if more else self.weight
        return self._conv_forward(values, weight, self.bias)


class ResidualBlock(nn.Module):
    """Two convolutions with a residual connection (He et al., 2016)."""

    def __init__(self, before: int, after: int, stride: int = 1) -> None:
        super().__init__()
        self.body = nn.Sequential(
            nn.Conv2d(before, after, 3, stride=stride, padding=1, bias=False),
            nn.BatchNorm2d(after),
            nn.ReLU(),
            nn.Conv2d(after, after, 3, padding=1, bias=False),
            nn.BatchNorm2d(after),
        )
        self.past: nn.Module = nn.Identity()
        if stride > 1 or before != after:
            self.past = nn.Sequential(nn.Conv2d(before, after, 1, stride=stride, bias=False), nn.BatchNorm2d(after))

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        """Values (B, C, H, W)."""
        return torch.relu(self.body(values) + self.past(values))
