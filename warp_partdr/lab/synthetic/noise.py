"""PartBench's noise: keypoints jitter and go missing, boundaries of labels wander, parts get lost.

Levels say how much of it there is. Strength 1 is about a good network on a clear photo; the rest is what goes wrong
altogether.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageFilter

from ...body.labels import BACKGROUND, LabelSet
from ...body.landmarks import mirror_order
from ...inputs.person import lower_near

KEYPOINT_NOISE = 0.01  # standard deviation of u and of v, of the person's height in the picture
# Times that for hidden joints: the packaged detector's hidden limb joints are off by 0.047 of the stature in the median
# (both coordinates), those seen by 0.017, all hidden landmarks by 0.030 (assets/detector_errors.npz).
HIDDEN_NOISE = 4.0
HIDDEN_CONFIDENCE = 0.5

# Lost, or taken for the other side, as one: parts of a limb from here on, and its joints.
LIMBS = (
    ("upper_arm", "forearm", "hand"),
    ("forearm", "hand"),
    ("upper_leg", "lower_leg", "foot"),
    ("lower_leg", "foot"),
)
SWAPPED_KEYPOINTS = (("elbow", "wrist"), ("knee", "ankle"), ("wrist",), ("ankle",))

# Boundaries move by the sum of smooth random fields: (standard deviation, distance over which they change) [px].
WAVES = ((1.2, 8.0), (1.5, 30.0))
SMOOTHING = 7  # [px], side of the window whose majority wins at the end; smaller blobs vanish
SMALL_PART = 0.012  # of the person's pixels: a part that shows less is lost with this chance:
LOSS = 0.35
CONFUSION = 0.12  # chance that the hands are confused; the same for the feet

_HOLE = (0.015, 0.05)  # radius of a hole, of the person's height
_OUTSIDE = -1.0  # [px]: a keypoint that far beyond the border is not found


@dataclass(frozen=True)
class Level:
    """Amount of noise."""

    strength: float  # of jitter, wandering boundaries, lost small parts, confused hands and feet; 0 leaves all as it is
    dropout: float = 0.0  # chance of each keypoint to be missing; twice that for hidden ones
    guessed: float = 0.0  # chance of each hidden keypoint to be as confident as those seen
    others: float = 0.0  # chance of a person's keypoints to lie where another data set than COCO marks them
    swap: float = 0.0  # chance that a limb's keypoints change sides; the same for a limb's labels
    growth: int = 0  # the most by which labels are dilated or eroded [px]
    holes: float = 0.0  # mean number of holes in the labels
    missing: float = 0.0  # chance that the labels miss a limb
    stranger: float = 0.0  # chance that somebody else stands before a part of the person


# Of the packaged detector's hidden limb joints, 35 % are of confidence above 0.5, of all its hidden landmarks 81 %
# (assets/detector_errors.npz).
LEVELS: dict[str, Level] = {
    "clean": Level(0.0),
    "mild": Level(0.5, dropout=0.02, guessed=0.1, growth=1, holes=0.3),
    "realistic": Level(
        1.0, dropout=0.05, guessed=0.35, others=0.4, swap=0.03, growth=2, holes=1.0, missing=0.05, stranger=0.1
    ),
    "hard": Level(
        2.0, dropout=0.15, guessed=0.5, others=0.4, swap=0.15, growth=4, holes=3.0, missing=0.25, stranger=0.4
    ),
}


def noisy_keypoints(
    points: np.ndarray,  # (J, 2), true positions [px]
    hidden: np.ndarray,  # (J,), those that are occluded
    landmarks: tuple[str, ...],
    person_height: float,  # [px], stature in the picture
    size: tuple[int, ...],  # (H, W) of the picture; nothing beyond it is found
    *,
    level: Level,
    rng: np.random.Generator,
) -> np.ndarray:
    """Keypoints as a detector gives them, shape (J, 3): u, v [px] and confidence, all 0 where missing."""
    spread = level.strength * KEYPOINT_NOISE * person_height * np.where(hidden, HIDDEN_NOISE, 1.0)
    noisy = points + spread[:, None] * rng.standard_normal(points.shape)
    doubted = hidden & (rng.random(len(points)) >= level.guessed)
    noisy = np.column_stack([noisy, np.where(doubted, HIDDEN_CONFIDENCE, 1.0)])
    for joints in SWAPPED_KEYPOINTS:
        if rng.random() < level.swap / len(SWAPPED_KEYPOINTS):
            noisy = noisy[mirror_order(landmarks, joints)]
    lost = rng.random(len(points)) < level.dropout * np.where(hidden, 2.0, 1.0)
    beyond = (noisy[:, :2] < _OUTSIDE) | (noisy[:, :2] > np.array(size[::-1]) - _OUTSIDE)
    noisy[lost | beyond.any(axis=1)] = 0.0
    return noisy


def noisy_labels(
    groups: np.ndarray, labels: LabelSet, person_height: float, level: Level, rng: np.random.Generator
) -> np.ndarray:
    """Group ids (H, W), uint8, as a segmentation network gives them, of a person so tall in the picture [px].

    The label set must have left and right limbs of three parts.
    """
    if level.strength:
        groups = _wander(_confuse(groups, labels, level.strength, rng), level.strength, rng)
    table = np.arange(256, dtype=np.uint8)
    if rng.random() < level.swap:
        left, right = _sides(labels, LIMBS[rng.integers(len(LIMBS))])
        table[left + right] = right + left
    if rng.random() < level.missing:
        limb = LIMBS[rng.integers(len(LIMBS))]
        table[np.isin(table, _sides(labels, limb)[rng.integers(2)])] = BACKGROUND
    noisy = table[groups]
    rows, columns = np.nonzero(noisy)
    holes = np.zeros(noisy.shape, dtype=bool)
    for _ in range(rng.poisson(level.holes) if rows.size else 0):
        at = rng.integers(rows.size)
        centre = np.array([columns[at], rows[at]] * 2) + 0.5
        lower_near(holes, centre, rng.uniform(*_HOLE) * person_height)
    noisy[holes] = BACKGROUND
    return _grow(noisy, int(rng.integers(-level.growth, level.growth + 1)))


def _confuse(groups: np.ndarray, labels: LabelSet, strength: float, rng: np.random.Generator) -> np.ndarray:
    """Small parts get lost, and hands and feet are taken for the other side's, now and then."""
    noisy = groups.copy()
    for group in np.unique(groups[groups > 0]):
        mask = groups == group
        if rng.random() < strength * LOSS and mask.sum() < SMALL_PART * (groups > 0).sum():
            grown = np.array(Image.fromarray(mask.astype(np.uint8)).filter(ImageFilter.MaxFilter(5)), dtype=bool)
            noisy[mask] = np.bincount(groups[grown & ~mask]).argmax()  # the label that is most common around it
    for kind in ("hand", "foot"):
        if rng.random() < strength * CONFUSION:
            left, right = _sides(labels, (kind,))
            table = np.arange(256, dtype=np.uint8)
            # Exchanged, both taken for the left one, or both for the right one.
            table[left + right] = (right + left, left + left, right + right)[rng.integers(3)]
            noisy = table[noisy]
    return noisy


def _wander(groups: np.ndarray, strength: float, rng: np.random.Generator) -> np.ndarray:
    """Labels taken from a little beside, so that boundaries wander; smooth in the end."""
    height, width = groups.shape
    v, u = np.mgrid[:height, :width]
    dv, du = (sum(strength * _wave(groups.shape, *wave, rng) for wave in WAVES) for _ in range(2))
    rows = np.clip(np.rint(v + dv), 0, height - 1).astype(int)
    columns = np.clip(np.rint(u + du), 0, width - 1).astype(int)
    return np.array(Image.fromarray(groups[rows, columns]).filter(ImageFilter.ModeFilter(SMOOTHING)))


def _sides(labels: LabelSet, parts: tuple[str, ...]) -> list[list[int]]:
    """Group ids of the left parts and of the right ones."""
    return [[labels.group_names.index(f"{side}_{part}") + 1 for part in parts] for side in ("left", "right")]


def _grow(groups: np.ndarray, pixels: int) -> np.ndarray:
    """The person dilated by a number of pixels, or eroded if negative. New pixels take a label from beside them."""
    grown = groups.copy()
    for _ in range(abs(pixels)):
        padded = np.pad(grown, 1, mode="edge")
        beside = np.stack([padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]])
        if pixels > 0:
            grown = np.where(grown == BACKGROUND, beside.max(0), grown)
        else:
            grown = np.where(beside.min(0) == BACKGROUND, BACKGROUND, grown)
    return grown.astype(np.uint8)


def _wave(shape: tuple[int, ...], deviation: float, period: float, rng: np.random.Generator) -> np.ndarray:
    """A smooth random field of about this standard deviation, shape (H, W)."""
    coarse = rng.standard_normal([int(np.ceil(size / period)) + 1 for size in shape]).astype(np.float32)
    fine = np.array(Image.fromarray(coarse).resize((shape[1], shape[0]), Image.Resampling.BICUBIC))
    return deviation * fine / max(float(fine.std()), 1e-6)
