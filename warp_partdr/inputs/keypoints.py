"""2D keypoints of one person, the person's height in the picture, and the choice of one person among several."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import SupportsIndex

import numpy as np

from ..body.skeletons import Skeleton, skeleton
from ..errors import InputError, check_each, check_type, check_whole, shown

LARGEST_COORDINATE = 1e6  # [px], of a keypoint that is visible
MIN_CONFIDENCE = 0.3  # Below it, a keypoint's position is unreliable.

# Straight chains of rigid bones, whose length in the picture gives the scale, with their length as a share of the
# stature (mean adult of body/mean_body.json). The short ones are used only if no long one is visible.
_LONG_BONES: dict[str, float] = {"shoulder-hip": 0.27, "hip-knee": 0.24, "knee-ankle": 0.247}
_SHORT_BONES: dict[str, float] = {"shoulder-elbow": 0.155, "elbow-wrist": 0.14}


@dataclass(frozen=True)
class Keypoints2D:
    """2D keypoints of one person.

    Attributes:
        skeleton: Format of the keypoints: its name, such as "coco17", or a skeleton of one's own.
        points: Positions [px], origin at the picture's top left corner, 0 where missing, shape (J, 2), float32.
        confidence: Confidences, 0 (missing) to 1, shape (J,), float32.
        warnings: Sentences about odd things in the file that the keypoints come from; fits pass them on.
        image_size: Size (H, W) of the picture [px]. If it is known and no camera is given, fits assume a usual lens.
            None: it is not known, or part labels have it.

    Raises:
        InputError: If a shape is wrong, a confidence is not from 0 to 1, or no picture has this size.
    """

    skeleton: str | Skeleton
    points: np.ndarray
    confidence: np.ndarray
    warnings: tuple[str, ...] = ()
    image_size: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        count = len(self.format)
        for name, shape in (("points", (count, 2)), ("confidence", (count,))):
            values = getattr(self, name)
            if not isinstance(values, np.ndarray) or values.shape != shape or values.dtype.kind != "f":
                raise InputError(f"{name}: {np.shape(values)}; expected floats {shape}, as {self.format.name}")
        if not ((self.confidence >= 0) & (self.confidence <= 1)).all():
            raise InputError("confidence: holds numbers that are not from 0 to 1")
        if self.image_size is not None:
            object.__setattr__(self, "image_size", _check_size(self.image_size))

    @property
    def format(self) -> Skeleton:
        """Skeleton of the format: landmarks and edges."""
        return skeleton(self.skeleton)

    @property
    def visible(self) -> np.ndarray:
        """Mask of the keypoints with a confidence above 0, shape (J,), bool."""
        return self.confidence > 0

    @cached_property
    def _height(self) -> float:
        return float(person_heights(self.skeleton, self.points[None], self.confidence[None])[0])

    @cached_property
    def confident(self) -> np.ndarray:
        """Mask of the keypoints with confidence 0.3 or more, or of all visible ones if none has that, shape (J,)."""
        return confident(self.confidence[None])[0]


def _check_size(size: Sequence[SupportsIndex]) -> tuple[int, int]:
    """Return the size (H, W) of a picture as two ints; raise InputError if it is no size."""
    try:
        height, width = size
        return (
            check_whole("image_size", height, 1, LARGEST_COORDINATE),
            check_whole("image_size", width, 1, LARGEST_COORDINATE),
        )
    except (TypeError, ValueError):  # also if they are not two
        raise InputError(
            f"image_size: {shown(size)}; expected (H, W) in whole pixels, up to {LARGEST_COORDINATE:g}"
        ) from None


def confident(confidence: np.ndarray) -> np.ndarray:
    """``Keypoints2D.confident`` for N people, from confidences (N, J), as a mask (N, J)."""
    high = confidence >= MIN_CONFIDENCE
    return np.where(high.any(axis=1, keepdims=True), high, confidence > 0)


def person_height(keypoints: Keypoints2D) -> float:
    """Height of the person standing upright in the picture [px], from the lengths of trunk, thighs and shins.

    A bone that is seen at an angle looks shorter than it is. So the upper quartile of the bones' estimates counts, and
    a person who is bent or cut off is not taken for a small one. If no bone has both its keypoints, the extent of all
    keypoints is returned.
    """
    return keypoints._height


def person_heights(form: str | Skeleton, points: np.ndarray, confidence: np.ndarray) -> np.ndarray:
    """``person_height`` for N people with one skeleton, shape (N,), from points (N, J, 2) and confidence (N, J)."""
    usable = confident(confidence)
    low = np.where(usable[..., None], points, np.inf)
    high = np.where(usable[..., None], points, -np.inf)
    heights = np.where(usable.any(axis=1), (high.max(axis=1) - low.min(axis=1)).max(axis=1), 0.0).astype(np.float64)
    for bones in (_SHORT_BONES, _LONG_BONES):  # the long ones have the last word
        pairs, shares = _bones(form, tuple(bones.items()))
        if not len(pairs):
            continue
        found = np.linalg.norm(points[:, pairs[:, 0]] - points[:, pairs[:, 1]], axis=-1) / shares
        found = np.where(usable[:, pairs].all(axis=-1), found, -np.inf)
        measured = found.max(axis=1) > 0
        heights[measured] = _upper_quartile(found[measured])
    return heights


def _upper_quartile(values: np.ndarray) -> np.ndarray:
    """Upper quartile of each row (N, K) without -inf, with the interpolation of ``numpy.quantile``."""
    values = np.sort(values, axis=1)
    count = (values > -np.inf).sum(axis=1)
    rank = 0.75 * (count - 1)
    first = values.shape[1] - count + np.floor(rank).astype(int)
    last = values.shape[1] - 1
    low = np.take_along_axis(values, np.minimum(first, last)[:, None], axis=1)[:, 0]
    high = np.take_along_axis(values, np.minimum(first + 1, last)[:, None], axis=1)[:, 0]
    share = rank - np.floor(rank)
    return np.where(share < 0.5, low + (high - low) * share, high - (high - low) * (1 - share))


@lru_cache
def _bones(form: str | Skeleton, bones: tuple[tuple[str, float], ...]) -> tuple[np.ndarray, np.ndarray]:
    """Joint pairs of the bones that the skeleton has, on both sides, (N, 2), and their shares of the stature, (N,)."""
    landmarks = skeleton(form).landmarks
    found = [
        ((landmarks.index(start), landmarks.index(end)), share)
        for bone, share in bones
        for start, end in ([f"{side}_{joint}" for joint in bone.split("-")] for side in ("left", "right"))
        if start in landmarks and end in landmarks
    ]
    return np.array([pair for pair, _ in found], dtype=np.int64), np.array([share for _, share in found])


def choose_person(
    people: Sequence[Keypoints2D], groups: np.ndarray | None = None, index: int | None = None
) -> Keypoints2D:
    """Choose the one person to fit.

    Args:
        people: Keypoints of all people in the picture.
        groups: Group ids of the picture's part labels, shape (H, W). Keypoints on background count less.
        index: Index of the person, 0 = first. None: the person who is largest and has the highest confidences.

    Raises:
        InputError: If there is nobody, or ``index`` is out of range.
        TypeError: If ``people`` are no keypoints, or ``groups`` is no array.

    Examples:
        >>> from warp_partdr import choose_person, read_keypoints, read_parts
        >>> people = read_keypoints("keypoints.json")
        >>> person = choose_person(people, read_parts("parts.png", "cdcl14").groups)
        >>> person.points.shape, int(person.visible.sum())
        ((17, 2), 17)
    """
    check_each("people", people, Keypoints2D, "of read_keypoints")
    check_type("groups", groups, np.ndarray | None, "of PartLabels")
    if groups is not None and groups.ndim != 2:
        raise InputError(f"groups: shape {groups.shape}; expected (H, W)")
    if not people:
        raise InputError("keypoints: nobody; expected at least one person")
    if index is not None:
        try:
            return people[check_whole("person", index, 0, len(people) - 1)]
        except ValueError as error:
            raise InputError(str(error)) from None
    scores = np.zeros(len(people))
    for form in {keypoints.skeleton for keypoints in people}:
        rows = [row for row, keypoints in enumerate(people) if keypoints.skeleton == form]
        points = np.stack([people[row].points for row in rows])
        confidence = np.stack([people[row].confidence for row in rows])
        scores[rows] = _weights(points, confidence, groups).mean(axis=1) * person_heights(form, points, confidence)
    return people[int(scores.argmax())]


def _weights(points: np.ndarray, confidence: np.ndarray, groups: np.ndarray | None) -> np.ndarray:
    """Weight of each keypoint when a person is chosen, shape (N, J)."""
    if groups is None:
        return confidence
    height, width = groups.shape
    columns, rows = np.moveaxis(np.floor(points).astype(np.int64), -1, 0)
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    shown = groups[np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)]
    return confidence * np.where(inside & (shown != 0), 1.0, 0.1)
