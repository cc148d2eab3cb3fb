"""Head that says which part each pixel of a person's picture shows and where the joints are.

It looks at the features of the landmark network.

The encoder is BlazePose's network "heavy", whose weights stay as they are: it has seen a great many real people, and
nothing else in the package has. Its maps of five sizes are joined from the smallest to the largest, as in U-Net
(Ronneberger et al., 2015). The limbs between its own landmarks are drawn beside them: they tell left from right, and
the person in the middle from those beside.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from ...body.skeletons import skeleton
from ...body.template import NUM_JOINTS, NUM_PARTS
from ...errors import check_whole
from ...interop.device_cache import device_cache
from ..regression.heads import cell_centres, heat_moments
from ..window_products import convolve_windows
from .person import SKELETON

TAPS: Mapping[int, tuple[int, ...]] = {8: (535, 640), 16: (499, 614), 32: (448, 587), 64: (430, 545), 128: (412,)}
"""Values of the landmark network's graph that the head looks at, by the side of their maps [cells]."""
PICTURE_SIDE = 256  # [px], of the pictures that the landmark network takes
_TAPPED = {8: 560, 16: 352, 32: 152, 64: 80, 128: 24}  # their channels
_COLOUR_CHANNELS = 16  # channels that are made of the picture itself
_LIMB_CELLS = 64  # side of the maps of limbs and of joints
_LEAST_VARIANCE = 1e-6  # of a heat map, the picture's side being 1, so that its root has a gradient
_LIMB_SPREAD = 0.035  # standard deviation of a limb's map, the picture's side being 1
_HIDDEN = 0.3  # brightness of a limb whose ends are hidden
_MOST_DEPTH = 2.0  # [half-sides of the picture]
MOST_WINDOWS = 8  # pictures whose windows, of 66 MB each at most, are made on CUDA, so that cuDNN need not be loaded
_NUMBERS = 5  # of a landmark: x, y and depth [px], and the logits of visibility and presence

_ARM = (("shoulder", "elbow"), ("elbow", "wrist"), ("wrist", "index"))
_LEG = (("hip", "knee"), ("knee", "ankle"), ("heel", "foot_index"))
_LINES = (
    *[(f"{side}_{a}", f"{side}_{b}") for limb in (_ARM, _LEG) for side in ("left", "right") for a, b in limb],
    *[(f"{side}_shoulder", f"{side}_hip") for side in ("left", "right")],
    ("left_shoulder", "right_shoulder"),
    ("left_hip", "right_hip"),
    ("left_ear", "right_ear"),
    ("nose", "nose"),
)


@dataclass(frozen=True)
class PartHeadConfig:
    """Sizes of a part head.

    Raises:
        ValueError: If a size is out of range.
    """

    channels: tuple[int, ...] = (128, 128, 96, 64, 32)  # for each of ``TAPS``, from the smallest maps on

    def __post_init__(self) -> None:
        check_whole("len(channels)", len(self.channels), len(TAPS), len(TAPS))
        for index, width in enumerate(self.channels):
            check_whole(f"channels[{index}]", width, 1, 1024)


class SeenParts(NamedTuple):
    """Answer of a part head.

    Attributes:
        logits: Logits of background and the 20 parts at each cell, shape (B, 21, 128, 128).
        joints: Joints in the order of ``JOINT_NAMES``, x and y from 0 to 1 across the picture, shape (B, 21, 2).
        spreads: Standard deviation of each joint's heat map across and down, the picture's side being 1, (B, 21, 2).
    """

    logits: torch.Tensor
    joints: torch.Tensor
    spreads: torch.Tensor


class PartHead(nn.Module):
    """Network from the landmark network's features and landmarks to parts and joints."""

    def __init__(self, config: PartHeadConfig) -> None:
        super().__init__()
        self.config = config
        widths = dict(zip(TAPS, config.channels, strict=True))
        self.sides = nn.ModuleDict({str(side): _block(_TAPPED[side], width, 1) for side, width in widths.items()})
        self.colours = _block(3, _COLOUR_CHANNELS)
        self.joined = nn.ModuleDict()
        (_, before), *rest = widths.items()
        for side, width in rest:
            beside = _COLOUR_CHANNELS if side == PICTURE_SIDE // 2 else 2 * len(_LINES)
            self.joined[str(side)] = nn.Sequential(_block(before + width + beside, width), _block(width, width))
            before = width
        self.last: nn.Module = nn.Conv2d(before, NUM_PARTS + 1, 1)
        self.heat: nn.Module = nn.Conv2d(widths[_LIMB_CELLS], NUM_JOINTS, 1)

    def forward(
        self, features: Mapping[int, torch.Tensor], landmarks: torch.Tensor, pictures: torch.Tensor
    ) -> SeenParts:
        """Parts and joints.

        Args:
            features: Maps of the landmark network, those of ``TAPS`` joined, by their side, shape (B, C, side, side).
            landmarks: Numbers of its landmarks, shape (B, 195).
            pictures: Pictures, from 0 to 1, shape (B, 3, 256, 256).
        """
        limbs = draw_limbs(landmarks).to(pictures.dtype)
        smallest, *rest = TAPS
        values = self.sides[str(smallest)](features[smallest])
        for side in rest:
            values = F.interpolate(values, scale_factor=2, mode="bilinear", align_corners=False)
            if side == PICTURE_SIDE // 2:
                beside = self.colours(F.avg_pool2d(pictures, 2))
            else:
                beside = F.avg_pool2d(limbs, _LIMB_CELLS // side)
            values = self.joined[str(side)](torch.cat([values, self.sides[str(side)](features[side]), beside], dim=1))
            if side == _LIMB_CELLS:
                means, variances = heat_moments(self.heat(values))
        spreads = (variances / 4).clamp_min(_LEAST_VARIANCE).sqrt()
        return SeenParts(self.last(values), (means + 1) / 2, spreads)

    def folded(self) -> PartHead:
        """A copy for answers, whose normalisations are within its convolutions."""
        head = deepcopy(self).eval()
        blocks = [each for each in head.modules() if isinstance(each, nn.Sequential)]
        for block in blocks:
            convolution, norm = block[0], block[1]
            if isinstance(convolution, nn.Conv2d) and isinstance(norm, nn.BatchNorm2d):
                block[0], block[1] = _Products(fuse_conv_bn_eval(convolution, norm)), nn.Identity()
        for name in ("last", "heat"):
            convolution = getattr(self, name)
            setattr(head, name, _Products(convolution))
        return head


class _Products(nn.Module):
    """Convolution that keeps the size of its maps; on CUDA, of few pictures, a product of matrices."""

    def __init__(self, convolution: nn.Conv2d) -> None:
        super().__init__()
        assert convolution.bias is not None
        weight = convolution.weight.detach().contiguous(memory_format=torch.channels_last)
        self.register_buffer("weight", weight)
        self.register_buffer("bias", convolution.bias.detach())
        self.weight: torch.Tensor
        self.bias: torch.Tensor

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        """Values (B, C, H, W)."""
        beside = self.weight.shape[2] // 2
        if values.is_cuda and len(values) <= MOST_WINDOWS:
            return convolve_windows(values, self.weight, self.bias, 1, (beside,) * 4)
        return F.conv2d(values, self.weight, self.bias, padding=beside)


def draw_limbs(landmarks: torch.Tensor) -> torch.Tensor:
    """Maps of limbs: how near a cell is to each limb, and the same times the limb's depth, shape (B, 36, 64, 64).

    Args:
        landmarks: Numbers of the landmark network, shape (B, 195).
    """
    points = landmarks.unflatten(1, (-1, _NUMBERS))
    places, depths = points[..., :2] / PICTURE_SIDE, points[..., 2] / PICTURE_SIDE
    shown = points[..., 3].sigmoid()
    first, second = _line_ends(landmarks.device)
    starts, along = places[:, first, None, None], (places[:, second] - places[:, first])[:, :, None, None]
    centres = (cell_centres(_LIMB_CELLS, landmarks.device) + 1) / 2
    cells = torch.stack(torch.meshgrid(centres, centres, indexing="xy"), dim=-1)
    share = ((cells - starts) * along).sum(-1) / (along.square().sum(-1) + 1e-6)
    share = share.clamp(0.0, 1.0)
    distance = (cells - starts - share[..., None] * along).square().sum(-1)
    brightness = _HIDDEN + (1 - _HIDDEN) * torch.minimum(shown[:, first], shown[:, second])
    near = (-distance / (2 * _LIMB_SPREAD**2)).exp() * brightness[..., None, None]
    depth = torch.lerp(depths[:, first, None, None], depths[:, second, None, None], share)
    return torch.cat([near, near * (2 * depth).clamp(-_MOST_DEPTH, _MOST_DEPTH)], dim=1)


@device_cache(8)
def _line_ends(device: torch.device) -> tuple[torch.Tensor, torch.Tensor]:
    """Landmarks at both ends of each of ``_LINES``, kept on the device, which would wait for what it is sent."""
    names = skeleton(SKELETON).landmarks
    ends = torch.tensor([[names.index(name) for name in line] for line in _LINES], device=device)
    return ends[:, 0], ends[:, 1]


def _block(before: int, after: int, size: int = 3) -> nn.Sequential:
    """Convolution, normalisation and a cut at 0."""
    return nn.Sequential(
        nn.Conv2d(before, after, size, padding=size // 2, bias=False), nn.BatchNorm2d(after), nn.ReLU()
    )
