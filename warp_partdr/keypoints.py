"""2D keypoints of one person, how tall they say the person is, and which of several people is meant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from .body.skeletons import Skeleton, skeleton
from .errors import InputError
from .kernels.integers import check_whole

MIN_CONFIDENCE = 0.3  # Below it, a keypoint says little about where the person is.

# Straight chains of rigid bones, whose length in the picture tells the scale, with their length as a share of the
# stature (mean adult of body/mean_body.json). The short ones serve only where no long one is to be seen.
_LONG_BONES: dict[str, float] = {"shoulder-hip": 0.27, "hip-knee": 0.24, "knee-ankle": 0.247}
_SHORT_BONES: dict[str, float] = {"shoulder-elbow": 0.155, "elbow-wrist": 0.14}


@dataclass(frozen=True)
class Keypoints2D:
    """2D keypoints of one person.

    Attributes:
        skeleton: Name of their format, such as "coco17".
        points: Positions [px], origin at the picture's top left corner, 0 where missing, shape (J, 2), float32.
        confidence: 0 (missing) to 1, shape (J,), float32.

    Raises:
        InputError: If a shape is wrong, or a confidence is none.
    """

    skeleton: str
    points: np.ndarray
    confidence: np.ndarray

    def __post_init__(self) -> None:
        count = len(self.format)
        for name, shape in (("points", (count, 2)), ("confidence", (count,))):
            values = getattr(self, name)
            if not isinstance(values, np.ndarray) or values.shape != shape or values.dtype.kind != "f":
                raise InputError(f"{name}: {np.shape(values)}; expected floats {shape}, as {self.skeleton}")
        if not ((self.confidence >= 0) & (self.confidence <= 1)).all():
            raise InputError("confidence: holds numbers that are not from 0 to 1")

    @property
    def format(self) -> Skeleton:
        """The skeleton itself: landmarks and edges."""
        return skeleton(self.skeleton)

    @property
    def visible(self) -> np.ndarray:
        """Whether each keypoint is there at all, shape (J,), bool."""
        return self.confidence > 0

    @property
    def confident(self) -> np.ndarray:
        """Whether each keypoint is to be relied on, shape (J,): confidence of 0.3 and more, or any if none has that."""
        sure = self.confidence >= MIN_CONFIDENCE
        return sure if sure.any() else self.visible


def person_height(keypoints: Keypoints2D) -> float:
    """How tall the person would stand in the picture [px], from the lengths of trunk, thighs and shins.

    A bone seen at an angle looks shorter than it is, so the upper quartile of what the bones say counts, and a bent or
    cut-off person is not taken for a small one. Without two keypoints of any bone: the extent of the keypoints.
    """
    for bones in (_LONG_BONES, _SHORT_BONES):
        pairs, shares = _bones(keypoints.skeleton, tuple(bones.items()))
        usable = keypoints.confident[pairs].all(axis=1)
        if usable.any():
            ends = keypoints.points[pairs[usable]]
            heights = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) / shares[usable]
            if heights.max() > 0:
                return float(np.quantile(heights, 0.75))
    points = keypoints.points[keypoints.confident]
    return float(np.ptp(points, axis=0).max()) if len(points) else 0.0


@lru_cache
def _bones(name: str, bones: tuple[tuple[str, float], ...]) -> tuple[np.ndarray, np.ndarray]:
    """Joint pairs (N, 2) of the bones on both sides that the skeleton has, and their shares of the stature (N,)."""
    landmarks = skeleton(name).landmarks
    pairs = [
        (landmarks.index(f"{side}_{start}"), landmarks.index(f"{side}_{end}"))
        for start, end in (bone.split("-") for bone, _ in bones)
        for side in ("left", "right")
    ]
    return np.array(pairs), np.repeat([share for _, share in bones], 2)


def choose_person(
    people: Sequence[Keypoints2D], groups: np.ndarray | None = None, index: int | None = None
) -> Keypoints2D:
    """The one person to fit.

    Args:
        people: Everybody whose keypoints there are.
        groups: Group ids of the picture's part labels, shape (H, W); without labels under them, keypoints count less.
        index: Whom to take, 0 = first; by default the largest and most confident.

    Raises:
        InputError: If there is nobody, or ``index`` is out of range.
    """
    if not people:
        raise InputError("keypoints: nobody; expected at least one person")
    if index is not None:
        try:
            return people[check_whole("person", index, 0, len(people) - 1)]
        except ValueError as error:
            raise InputError(str(error)) from None
    return max(people, key=lambda keypoints: _prominence(keypoints, groups))


def _prominence(keypoints: Keypoints2D, groups: np.ndarray | None) -> float:
    weight = keypoints.confidence
    if groups is not None:
        height, width = groups.shape
        columns, rows = np.floor(keypoints.points).astype(np.int64).T
        inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
        shown = groups[np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)]
        weight = weight * np.where(inside & (shown != 0), 1.0, 0.1)
    return float(weight.mean()) * person_height(keypoints)
