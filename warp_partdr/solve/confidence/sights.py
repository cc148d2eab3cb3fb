"""Sight of limbs: whether keypoints show them, or they are hidden or outside the picture."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, get_args

import numpy as np

from ...inputs.keypoints import MIN_CONFIDENCE
from .limbs import LIMBS

Sight = Literal["seen", "hidden", "outside"]
SIGHTS: tuple[Sight, ...] = get_args(Sight)
NO_SIGHT = len(SIGHTS)  # index of limbs in pictures in which the person was not found
LIMB_LANDMARKS = tuple(dict.fromkeys(name for limb in LIMBS for name in limb.landmarks))
_WHY = {"hidden": "hidden", "outside": "outside the picture"}


def seen_limbs(landmarks: tuple[str, ...], confidence: np.ndarray) -> np.ndarray:
    """Flags of the limbs that a keypoint shows.

    Args:
        landmarks: Names of J keypoints.
        confidence: Confidence in the keypoints of N people, shape (N, J).

    Returns:
        Flags in the order of ``LIMBS``, shape (N, 5), bool.
    """
    shown = confidence >= MIN_CONFIDENCE
    return np.stack([shown[:, limb.rows(landmarks)].any(axis=1) for limb in LIMBS], axis=1)


def limbs_outside(landmarks: tuple[str, ...], pixels: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Flags of the limbs that lie outside the picture with all their landmarks.

    Args:
        landmarks: Names of L landmarks, some of each limb's.
        pixels: Landmarks of N bodies in the picture [px], shape (N, L, 2).
        size: Size (H, W) of the picture [px].

    Returns:
        Flags in the order of ``LIMBS``, shape (N, 5), bool.
    """
    outside = np.any((pixels < 0) | (pixels > (size[1], size[0])), axis=-1)
    return np.stack([outside[:, limb.rows(landmarks)].all(axis=1) for limb in LIMBS], axis=1)


def limb_sights(seen: np.ndarray, outside: np.ndarray) -> np.ndarray:
    """Indices in ``SIGHTS`` of limbs that are seen or lie outside the picture, of the flags' shape, uint8."""
    unseen = np.where(outside, SIGHTS.index("outside"), SIGHTS.index("hidden"))
    found: np.ndarray = np.where(seen, SIGHTS.index("seen"), unseen).astype(np.uint8)
    return found


def sight_in_words(sight: Sight) -> str:
    """Say how a limb is known: "seen", "hidden, guessed" or "outside the picture, guessed"."""
    return sight if sight == "seen" else f"{_WHY[sight]}, guessed"


def describe_guessed(sights: Mapping[str, Sight]) -> str:
    """Words for the limbs that are guessed and why, such as "left arm hidden, guessed"; empty if all are seen."""
    groups: dict[str, list[str]] = {}
    for name, sight in sights.items():
        if sight != "seen":
            groups.setdefault(sight_in_words(sight), []).append(name)
    return "; ".join(f"{' and '.join(names)} {words}" for words, names in groups.items())
