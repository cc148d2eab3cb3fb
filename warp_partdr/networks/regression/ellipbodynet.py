"""EllipBodyNet: from a picture to EllipBody, its camera, 2D keypoints and part segmentation (paper, section 3.4).

The backbone is any of ``transformers.AutoBackbone`` whose last feature map is (B, C, h, w). The regressor sees that map
pooled, the heat maps' keypoints, and the segmentation's probabilities, pooled.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torch import nn

from ...body.template import NUM_PARTS
from ...errors import InputError, cause, check_whole, install_command
from ...interop.checks import check_tensor
from .heads import DeconvolutionHead, soft_argmax
from .landmarks import LANDMARKS
from .predicted import Predicted
from .regressor import Regressor, RegressorConfig

if TYPE_CHECKING:
    from transformers import PreTrainedConfig

RESNET50 = "microsoft/resnet-50"
# Of an architecture: what the kind and its sizes say already, and what heads for other tasks need.
_NOT_STORED = (
    *("architectures", "dtype", "torch_dtype", "transformers_version"),
    *("id2label", "label2id", "stage_names", "out_features"),
)
_MOST_LAYERS, _WIDEST = 256, 1 << 16  # of a backbone's configuration
_MOST_WEIGHTS = 1 << 28  # of a backbone; files of networks hold 1 GiB at most
_MEAN, _DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # of ImageNet's colours, as backbones were trained


@dataclass(frozen=True)
class EllipBodyNetConfig:
    """Backbone and sizes of an EllipBodyNet."""

    backbone: str = RESNET50  # name on the Hugging Face hub, or a local folder with its config.json
    # The backbone's configuration as transformers writes it, with its ``model_type``; empty: what ``backbone`` has,
    # which needs a connection (or its cache) for any name but ResNet-50's.
    architecture: dict[str, Any] = field(default_factory=dict)
    pretrained: bool = False  # start from the backbone's own weights instead of random ones
    size: int = 256  # [px], side of the pictures
    head_width: int = 256  # channels of the two heads' deconvolutions
    part_cells: int = 8  # side of the grid that part probabilities are pooled to for the regressor
    regressor: RegressorConfig = field(default_factory=RegressorConfig)

    def __post_init__(self) -> None:
        check_whole("size", self.size, 32, 1024)
        check_whole("head_width", self.head_width, 1, 2048)
        check_whole("part_cells", self.part_cells, 1, 32)
        _check_numbers("architecture", self.architecture)


def _check_numbers(name: str, value: Any) -> None:
    """Raise ValueError if a backbone's configuration, which a file may hold, has a number or a list that is too large.

    Depths are bounded more tightly than widths, for each layer is built before its weights can be counted.
    """
    if isinstance(value, Mapping):
        for key, each in value.items():
            _check_numbers(f"{name}.{key}", each)
    elif isinstance(value, list | tuple):
        check_whole(f"len({name})", len(value), 0, _MOST_LAYERS)
        for index, each in enumerate(value):
            _check_numbers(f"{name}[{index}]", each)
    elif type(value) is int:
        is_depth = "depth" in name or "layer" in name
        check_whole(name, value, -_WIDEST, _MOST_LAYERS if is_depth else _WIDEST)


@dataclass(frozen=True)
class PicturePrediction:
    """Output of EllipBodyNet for B pictures."""

    bodies: Predicted
    heatmaps: torch.Tensor  # logits of the keypoints ``LANDMARKS``, shape (B, 24, h, w)
    keypoints: torch.Tensor  # their crop coordinates and confidence, shape (B, 24, 3)
    parts: torch.Tensor  # logits of background and the 20 parts, shape (B, 21, h, w)

    def part_labels(self, size: int) -> torch.Tensor:
        """Most likely part of each pixel at ``size`` pixels a side, 0 = background, shape (B, size, size), uint8."""
        logits = nn.functional.interpolate(self.parts.float(), size=(size, size), mode="bilinear")
        return logits.argmax(1).to(torch.uint8)


class EllipBodyNet(nn.Module):
    """Pictures to bodies, keypoints and parts.

    Its own ``config`` has the backbone's architecture filled in, and is not ``pretrained``: from it the network is made
    again without a connection, and a checkpoint brings the weights.

    Raises:
        InputError: If there is no such backbone, it can't be fetched, or it makes no (B, C, h, w) feature maps.
    """

    mean: torch.Tensor
    deviation: torch.Tensor

    def __init__(self, config: EllipBodyNetConfig) -> None:
        super().__init__()
        self.backbone, architecture = _make_backbone(config)
        self.config = replace(config, architecture=architecture, pretrained=False)
        channels = _feature_channels(self.backbone, config)
        self.keypoint_head = DeconvolutionHead(channels, len(LANDMARKS), config.head_width)
        self.part_head = DeconvolutionHead(channels, NUM_PARTS + 1, config.head_width)
        features = channels + 3 * len(LANDMARKS) + (NUM_PARTS + 1) * config.part_cells**2
        self.regressor = Regressor(features, config.regressor)
        for name, colour in (("mean", _MEAN), ("deviation", _DEVIATION)):
            self.register_buffer(name, torch.tensor(colour).view(3, 1, 1), persistent=False)

    def forward(self, pictures: torch.Tensor) -> PicturePrediction:
        """Bodies, keypoints and parts of one person a picture.

        Args:
            pictures: Square crops around the people, RGB, uint8 or floats from 0 to 1, shape (B, 3, size, size).

        Raises:
            ValueError: If the shape or dtype is another.
        """
        side = self.config.size
        dtypes = (torch.uint8, torch.float32, torch.float16, torch.bfloat16)
        check_tensor("pictures", pictures, (None, 3, side, side), dtypes=dtypes)
        colours = pictures.float() / 255 if pictures.dtype == torch.uint8 else pictures.float()
        features = self.backbone((colours - self.mean) / self.deviation).feature_maps[-1]
        heatmaps, parts = self.keypoint_head(features), self.part_head(features)
        keypoints = soft_argmax(heatmaps)
        shares = nn.functional.adaptive_avg_pool2d(parts.float().softmax(1), self.config.part_cells)
        seen = [features.mean((2, 3)).float(), keypoints.flatten(1), shares.flatten(1)]
        bodies = self.regressor(torch.cat(seen, dim=1))
        return PicturePrediction(bodies, heatmaps, keypoints, parts)


def _make_backbone(config: EllipBodyNetConfig) -> tuple[nn.Module, dict[str, Any]]:
    """The backbone, which gives its last feature map, and its architecture as JSON has it."""
    try:
        from transformers import AutoBackbone
    except ImportError as error:
        raise InputError(f"EllipBodyNet needs transformers ({install_command('train')})") from error
    architecture = _architecture(config)
    try:
        with torch.device("meta"):  # counts the weights without making them
            count = sum(weight.numel() for weight in AutoBackbone.from_config(architecture).parameters())
        if count > _MOST_WEIGHTS:
            raise ValueError(f"{count:,} weights; expected at most {_MOST_WEIGHTS:,}")
        backbone = AutoBackbone.from_config(architecture)
        if config.pretrained:  # by its own class: AutoBackbone asks the hub first, also about a folder
            folder = Path(config.backbone).expanduser()
            backbone = type(backbone).from_pretrained(str(folder), config=architecture)
    except Exception as error:  # of many kinds: of the connection, the files, and each model's own
        reason = _no_files("weights") if config.pretrained else cause(error)
        raise InputError(f"backbone: {config.backbone!r} ({architecture.model_type}): {reason}") from error
    differing = architecture.to_diff_dict().items()
    stored = {name: value for name, value in differing if not name.startswith("_") and name not in _NOT_STORED}
    return backbone, {**stored, "model_type": architecture.model_type}


def _architecture(config: EllipBodyNetConfig) -> PreTrainedConfig:
    """The backbone's configuration, asked for its last feature map alone."""
    from transformers import AutoConfig, ResNetConfig

    if config.architecture:
        values = dict(config.architecture)
        try:
            found = AutoConfig.for_model(values.pop("model_type"), **values)
        except Exception as error:  # of many kinds: each model checks its own values
            raise InputError(
                f"architecture: {cause(error)}; expected a backbone's configuration with its model_type, such as resnet"
            ) from error
    elif config.backbone == RESNET50:
        found = ResNetConfig()
    else:
        folder = Path(config.backbone).expanduser()
        if str(folder).startswith((".", "/")) and not folder.is_dir():
            raise InputError(f"backbone: {config.backbone}: no such folder; expected one with a config.json")
        try:
            found = AutoConfig.from_pretrained(str(folder))
        except Exception as error:  # as above
            raise InputError(f"backbone: {config.backbone!r}: {_no_files('config.json')}") from error
    if not hasattr(found, "stage_names"):
        raise InputError(
            f"backbone: {config.backbone!r} is a {found.model_type}, which gives no feature maps; expected a backbone "
            "that transformers.AutoBackbone knows, such as resnet, convnext, swin or dinov2"
        )
    found.out_indices = [len(found.stage_names) - 1]
    return found


def _no_files(what: str) -> str:
    return (
        f"no {what} found; expected a name on huggingface.co and a connection, or a local folder: download it once "
        "where there is a connection (hf download NAME --local-dir FOLDER) and give the folder, or set pretrained to "
        "false for random weights"
    )


@torch.no_grad()
def _feature_channels(backbone: nn.Module, config: EllipBodyNetConfig) -> int:
    """C of the last feature map, by trying."""
    was_training = backbone.training
    try:
        maps = backbone.eval()(torch.zeros(1, 3, config.size, config.size)).feature_maps[-1]
    except (RuntimeError, ValueError) as error:
        where = f"the backbone {config.backbone!r}"
        raise InputError(f"size: {config.size} px does not suit {where}: {cause(error)}") from error
    backbone.train(was_training)
    if maps.ndim != 4:
        raise InputError(f"backbone: {config.backbone!r}: feature map of {tuple(maps.shape)}; expected (B, C, h, w)")
    return int(maps.shape[1])
