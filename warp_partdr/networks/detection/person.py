"""Person who was found in a picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F

from ...body.labels import IGNORE
from ...inputs.keypoints import Keypoints2D
from ...inputs.person import Box
from .crops import TurnedCrops

SKELETON = "blazepose33"
_SIDE = 256  # [px], of the maps of a person's crop
_SURE = 0.7  # probability of a part among all parts from which on it is likely


@dataclass(frozen=True)
class LikeliestParts:
    """Parts that the part head sees in one crop, or in N, on the device that found them.

    Attributes:
        labels: Part with the highest probability, 1 to 20 in the order of ``PART_NAMES``, at each pixel, whether or not
            it shows the person; 255 where no part is likely, shape (..., 256, 256), uint8.
        background: Probability that the pixel does not show the person, in steps of 1 / 255, same shape, uint8.
    """

    labels: torch.Tensor
    background: torch.Tensor

    @classmethod
    def of(cls, shares: torch.Tensor) -> LikeliestParts:
        """Parts from probabilities of background and the 20 parts, shape (N, 21, S, S)."""
        shares = F.interpolate(shares, (_SIDE, _SIDE), mode="bilinear", align_corners=False)
        parts = shares[:, 1:]
        likeliest, place = parts.max(1)
        labels = torch.where(likeliest >= _SURE * parts.sum(1), place + 1, IGNORE).to(torch.uint8)
        return cls(labels, (255 * shares[:, 0]).round().to(torch.uint8))

    @classmethod
    def joined(cls, batches: Sequence[LikeliestParts]) -> LikeliestParts:
        """Join the crops of several batches in one."""
        return cls(torch.cat([each.labels for each in batches]), torch.cat([each.background for each in batches]))

    def __getitem__(self, row: int) -> LikeliestParts:
        return LikeliestParts(self.labels[row], self.background[row])


@dataclass(frozen=True)
class FoundPerson:
    """Person in a picture.

    Attributes:
        keypoints: Landmarks of the format "blazepose33", 33 of them. Their confidence says that a landmark is in the
            picture and not hidden.
        score: Confidence that there is a person, 0 to 1.
        box: Left, top, right and bottom of the mask, or else of the keypoints, within the picture [px].
        crop: Single crop, turned upright, in which the landmarks were found.
        mask: Probability that a pixel of the crop shows the person, 0 beyond the picture, shape (256, 256), float32,
            on the device that found it. ``draw_mask`` and ``instance_map`` draw it in the picture.
        next_crop: Crop that the landmarks place about the person, for the next picture of a film.
        mirror_distance: Distance between joints as they are found in the crop and in its mirror image, mean weighted by
            their confidence, as a share of the crop's side; None if the mirror image was not looked at.
        parts: Likeliest part at each pixel of the crop; None if only the smaller landmark network has looked.
    """

    keypoints: Keypoints2D
    score: float
    box: Box
    crop: TurnedCrops
    mask: torch.Tensor
    next_crop: TurnedCrops
    mirror_distance: float | None = None
    parts: LikeliestParts | None = None

    @property
    def seen(self) -> bool:
        """True if landmarks are known. False if only another detector's box shows the person."""
        return bool(self.keypoints.confident.any())
