"""The target as a picture, and what is wrong beside it: what stays the same while the body moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..body.labels import BACKGROUND, IGNORE
from ..inputs.observation import resize_nearest
from ..results.palette import IGNORE_COLOUR, group_colours
from .targets import Target

BACKGROUND_COLOUR = 250
_RIGHT_COLOUR = 226
_UNKNOWN_COLOUR = 238


@dataclass(frozen=True)
class WantedPicture:
    """What a drawn picture is compared with, N pixels a side.

    Attributes:
        labels: Group ids, 255 = ignore, shape (N, N), uint8.
        picture: Their colours, RGB, shape (N, N, 3), uint8.
        right: What the difference is where all is right, the same.
        wrong: What it is where something is wrong, the same.
    """

    labels: np.ndarray
    picture: np.ndarray
    right: np.ndarray
    wrong: np.ndarray

    def difference(self, drawn: np.ndarray) -> np.ndarray:
        """A wrong pixel has the colour that it should have; what should be background is dark."""
        different = (drawn != self.labels) & (self.labels != IGNORE)
        return np.where(different[..., None], self.wrong, self.right)


def wanted_picture(target: Target, size: int) -> WantedPicture | None:
    """At ``size`` pixels a side; None of a target without labels."""
    if target.observation.labels is None:
        return None
    labels = resize_nearest(target.observation.labels, size).numpy()
    picture = picture_colours(target)[labels]
    person = (labels != BACKGROUND) & (labels != IGNORE)
    right = np.full_like(picture, BACKGROUND_COLOUR)
    right[person] = _RIGHT_COLOUR
    wrong = np.where(labels[..., None] == BACKGROUND, IGNORE_COLOUR, picture)
    return WantedPicture(labels, picture, right, wrong)


def picture_colours(target: Target) -> np.ndarray:
    """RGB of each group id of a target, shape (256, 3), uint8."""
    colours = group_colours(target.label_set.part_groups)
    colours[BACKGROUND], colours[IGNORE] = BACKGROUND_COLOUR, _UNKNOWN_COLOUR
    return colours
