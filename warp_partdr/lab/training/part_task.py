"""Training of the part head: pictures that look like photos, made on the fly, and the parts and joints in them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import torch
import torch.nn.functional as F

from ...body.labels import BACKGROUND, IGNORE
from ...body.template import NUM_PARTS
from ...errors import InputError
from ...metrics import confusion, part_f1, pooled
from ...networks.detection.asset import load_heavy_landmarks
from ...networks.detection.heavy_network import join_features, load_part_head, save_part_head, with_features
from ...networks.detection.part_head import PICTURE_SIDE, PartHead, PartHeadConfig, SeenParts
from ...results.palette import PART_COLOURS
from ..synthetic.backdrops import load_backdrops
from ..synthetic.photo_people import PhotoBatch, PhotoPeopleMaker
from ..synthetic.pose_sampler import PoseBank
from ..synthetic.training_people import PeopleMaker
from .config import TrainingConfig
from .task import PACKAGED_NETWORK, Task, weighted_losses

if TYPE_CHECKING:
    from PIL import Image

_VALIDATION_SEED = 7  # the same people in every run
_BATCH = 64  # of validation
_SHOWN = 8  # people on the contact sheet
_JOINT_SCALE = 0.02  # of the picture's side: smaller errors of joints cost their square
_WIDEST = 0.025  # of the picture's side: standard deviation up to which a joint's heat map costs nothing


@dataclass(frozen=True)
class PartData:
    """Source of the pictures."""

    backgrounds: str = ""  # folder of pictures in which nobody is seen; "": scikit-image's samples, or noise without it
    poses: str = ""  # folder of motion capture, or a pose bank made of one (.npz); "" takes the packaged prior alone
    validation: int = 512  # number of held-out people that errors are measured on
    pool: int = 8192  # poses that are made at once

    def __post_init__(self) -> None:
        for name in ("validation", "pool"):
            if getattr(self, name) < 1:
                raise InputError(f"data.{name}: {getattr(self, name)}; expected 1 or more")


class PartTask(Task):
    """The ``Task`` of the part head. The landmark network, whose features it looks at, stays as it is."""

    MODEL: ClassVar[type[Any]] = PartHeadConfig
    DATA: ClassVar[type[Any]] = PartData
    WEIGHTS: ClassVar[Mapping[str, float]] = MappingProxyType({"labels": 1.0, "joints": 0.05, "spreads": 0.01})
    BITS: ClassVar[int] = 16

    def __init__(self, config: TrainingConfig, *, rank: int, processes: int, device: torch.device) -> None:
        super().__init__(config, rank=rank, processes=processes, device=device)
        self._backdrops = load_backdrops(config.data.backgrounds)
        # Processes differ in their seeds; those of one process follow one another.
        self._maker = self._make_maker(config.seed * processes + rank, held_out=False)
        self._encoder = with_features(load_heavy_landmarks(device=device), half=config.precision == "bf16")

    def _make_maker(self, seed: int, *, held_out: bool) -> PhotoPeopleMaker:
        data = self.config.data
        poses = PoseBank.read(data.poses, held_out=held_out) if data.poses else PoseBank.of_prior(seed=seed)
        people = PeopleMaker(poses, size=PICTURE_SIDE, device=self.device, seed=seed, held_out=held_out, pool=data.pool)
        return PhotoPeopleMaker(people, self._backdrops, seed=seed)

    def model(self) -> torch.nn.Module:
        """A new head."""
        return PartHead(self.config.model).to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def batch(self, device: torch.device) -> PhotoBatch:
        """The next pictures."""
        return self._maker(self.config.batch_size)

    def see(self, model: torch.nn.Module, pictures: torch.Tensor) -> SeenParts:
        """Parts and joints that a head sees in pictures, shape (B, 3, 256, 256)."""
        with torch.no_grad():
            values = self._encoder(pictures)
        seen: SeenParts = model(join_features(values), values["landmarks"], pictures)
        return seen

    def loss(self, model: torch.nn.Module, batch: PhotoBatch) -> dict[str, torch.Tensor]:
        """The weighted terms of ``part_losses``, and their sum."""
        terms = part_losses(self.see(model, batch.pictures), batch)
        return weighted_losses(terms, self.config.weights, self.left_out)

    def validate(self, model: torch.nn.Module, device: torch.device) -> dict[str, float]:
        """Errors on held-out bodies in held-out poses."""
        counts, distances = [], []
        for batch in self._held_out:
            seen = self.see(model, batch.pictures)
            found = seen.logits.argmax(1).to(torch.uint8)
            counts.append(confusion(found, cell_labels(batch.labels), NUM_PARTS + 1).sum(0))
            distances.append((seen.joints - batch.joints).norm(dim=-1)[_inside(batch.joints)])
        return {
            "part F1": float(part_f1(pooled(counts))),
            "joints [px of 256]": float(torch.cat(distances).mean()) * PICTURE_SIDE,
        }

    def pictures(self, model: torch.nn.Module, device: torch.device) -> Image.Image | None:
        """Rows of pictures, the truth, and the parts that are seen."""
        from PIL import Image

        batch = self._held_out[0]
        shown, truth = batch.pictures[:_SHOWN], cell_labels(batch.labels[:_SHOWN])
        found = self.see(model, shown).logits.argmax(1)
        small = (F.avg_pool2d(shown, 2) * 255).byte().permute(0, 2, 3, 1)
        parts = [truth.where(truth != IGNORE, BACKGROUND).cpu().numpy(), found.cpu().numpy()]
        rows = [small.cpu().numpy(), *(PART_COLOURS[labels] for labels in parts)]
        return Image.fromarray(np.concatenate([np.concatenate(list(row), axis=1) for row in rows]))

    def save(self, path: Path, weights: Mapping[str, torch.Tensor], about: Mapping[str, Any], *, bits: int) -> None:
        """Write the head."""
        save_part_head(path, weights, self.config.model, about, bits=bits)

    def read(self, source: str) -> Mapping[str, torch.Tensor]:
        """Weights of a trained head; see ``Task``."""
        head = load_part_head(None if source == PACKAGED_NETWORK else source)
        if head.config != self.config.model:
            raise InputError(f"initial: {source}: a head of {head.config}; expected {self.config.model}")
        return head.state_dict()

    def state_dict(self) -> dict[str, Any]:
        """State of what makes pictures."""
        return self._maker.state_dict()

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from there."""
        self._maker.load_state_dict(state)

    @cached_property
    def _held_out(self) -> list[PhotoBatch]:
        """The pictures that errors are measured on."""
        maker, count = self._make_maker(_VALIDATION_SEED, held_out=True), self.config.data.validation
        return [maker(min(_BATCH, count - first)) for first in range(0, count, _BATCH)]


def cell_labels(labels: torch.Tensor) -> torch.Tensor:
    """Labels of a head's cells, those of every second pixel, shape (B, S / 2, S / 2), of labels (B, S, S)."""
    return labels[:, 1::2, 1::2]


def part_losses(seen: SeenParts, batch: PhotoBatch) -> dict[str, torch.Tensor]:
    """Loss terms by comparison with the truth, each a mean over the batch, without weights.

    * labels: cross entropy of background and parts, over cells within the picture's border;
    * joints: smooth absolute error of the coordinates of joints within the picture, in units of 0.02 of its side;
    * spreads: logarithm of a heat map's standard deviation over 0.025 of the side, 0 for smaller ones.
    """
    truth = cell_labels(batch.labels).long()
    inside = _inside(batch.joints)[..., None].expand_as(batch.joints)
    errors = F.smooth_l1_loss(seen.joints / _JOINT_SCALE, batch.joints / _JOINT_SCALE, reduction="none")
    return {
        "labels": F.cross_entropy(seen.logits.float(), truth, ignore_index=IGNORE),
        "joints": torch.where(inside, errors, 0.0).sum() / inside.sum().clamp_min(1),
        "spreads": (seen.spreads.log() - math.log(_WIDEST)).clamp_min(0).mean(),
    }


def _inside(joints: torch.Tensor) -> torch.Tensor:
    """True for joints (B, L, 2) within the picture, shape (B, L), bool."""
    return ((joints > 0) & (joints < 1)).all(-1)
