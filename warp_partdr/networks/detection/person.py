"""Person who was found in a picture."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from ...inputs.keypoints import Keypoints2D
from ...inputs.person import Box
from .crops import TurnedCrops

SKELETON = "blazepose33"


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
        parts: Probabilities of background and the 20 parts in the crop, shape (21, 128, 128), float16, on the device
            that found it; None if only the smaller landmark network has looked.
    """

    keypoints: Keypoints2D
    score: float
    box: Box
    crop: TurnedCrops
    mask: torch.Tensor
    next_crop: TurnedCrops
    mirror_distance: float | None = None
    parts: torch.Tensor | None = None

    @property
    def seen(self) -> bool:
        """True if landmarks are known. False if only another detector's box shows the person."""
        return bool(self.keypoints.confident.any())
