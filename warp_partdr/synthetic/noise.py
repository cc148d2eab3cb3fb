"""PartBench's noise: keypoints jitter and go missing, boundaries of labels wander, parts get lost.

Levels say how much of it there is. At strength 1, ``noisy_keypoints`` and ``noisy_labels`` are about as good as a good
network on a clear photo; ``spoil_keypoints`` and ``spoil_labels`` add what goes wrong altogether.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageFilter

from ..body.labels import BACKGROUND, LabelSet
from ..body.landmarks import mirror_name
from ..inputs.person import lower_near

KEYPOINT_NOISE = 0.01  # standard deviation of u and of v, of the person's height in the picture
HIDDEN_NOISE = 2.0  # times that for hidden joints
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
    """Amount of noise.

    Attributes:
        strength: Of keypoint jitter, of wandering boundaries, of lost small parts and of confused hands and feet; 0
            leaves labels and keypoints as they are.
        dropout: Chance of each keypoint to be missing; twice that for hidden ones.
        swap: Chance that a limb's keypoints change sides; the same for a limb's labels.
        growth: The most by which labels are dilated or eroded [px].
        holes: Mean number of holes in the labels.
        missing: Chance that the labels miss a limb.
        stranger: Chance that somebody else stands before a part of the person.
    """

    strength: float
    dropout: float = 0.0
    swap: float = 0.0
    growth: int = 0
    holes: float = 0.0
    missing: float = 0.0
    stranger: float = 0.0


LEVELS: dict[str, Level] = {
    "clean": Level(0.0),
    "mild": Level(0.5, dropout=0.02, growth=1, holes=0.3),
    "realistic": Level(1.0, dropout=0.05, swap=0.03, growth=2, holes=1.0, missing=0.05, stranger=0.1),
    "hard": Level(2.0, dropout=0.15, swap=0.15, growth=4, holes=3.0, missing=0.25, stranger=0.4),
}


def noisy_keypoints(
    points: np.ndarray, hidden: np.ndarray, person_height: float, rng: np.random.Generator, strength: float = 1.0
) -> np.ndarray:
    """Keypoints as a detector gives them, shape (J, 3): u, v [px] and confidence.

    Args:
        points: True positions [px], shape (J, 2).
        hidden: Those that are occluded, shape (J,), bool.
        person_height: Stature in the picture [px].
        rng: Source of the noise.
        strength: Factor of the noise.
    """
    spread = strength * KEYPOINT_NOISE * person_height * np.where(hidden, HIDDEN_NOISE, 1.0)
    noisy = points + spread[:, None] * rng.standard_normal(points.shape)
    return np.column_stack([noisy, np.where(hidden, HIDDEN_CONFIDENCE, 1.0)])


def spoil_keypoints(
    keypoints: np.ndarray, landmarks: tuple[str, ...], size: tuple[int, int], level: Level, rng: np.random.Generator
) -> np.ndarray:
    """Keypoints with some missing (confidence 0, at 0) and some on the wrong side, shape (J, 3).

    Args:
        keypoints: u, v [px] and confidence, shape (J, 3).
        landmarks: Their names.
        size: Of the picture, (H, W); nothing beyond it is found.
        level: How much.
        rng: Source of chance.
    """
    spoiled = keypoints.copy()
    for joints in SWAPPED_KEYPOINTS:
        if rng.random() < level.swap / len(SWAPPED_KEYPOINTS):
            left = [landmarks.index(f"left_{joint}") for joint in joints]
            right = [landmarks.index(mirror_name(landmarks[joint])) for joint in left]
            spoiled[[*left, *right]] = spoiled[[*right, *left]]
    lost = rng.random(len(keypoints)) < level.dropout * np.where(keypoints[:, 2] < 1.0, 2.0, 1.0)
    beyond = (spoiled[:, :2] < _OUTSIDE) | (spoiled[:, :2] > np.array(size[::-1]) - _OUTSIDE)
    spoiled[lost | beyond.any(axis=1)] = 0.0
    return spoiled


def noisy_labels(groups: np.ndarray, labels: LabelSet, rng: np.random.Generator, strength: float = 1.0) -> np.ndarray:
    """Group ids as a segmentation network gives them, shape (H, W), uint8.

    Args:
        groups: True group ids, shape (H, W), uint8.
        labels: Their label set; it must have hands and feet.
        rng: Source of the noise.
        strength: Factor of chances and distances.
    """
    noisy = _lose_small_parts(groups, rng, strength * LOSS)
    for kind in ("hand", "foot"):
        if rng.random() < strength * CONFUSION:
            pair = [labels.group_names.index(f"{side}_{kind}") + 1 for side in ("left", "right")]
            # Exchanged, both taken for the left one, or both for the right one.
            taken_for = ((pair[1], pair[0]), (pair[0], pair[0]), (pair[1], pair[1]))[rng.integers(3)]
            table = np.arange(256, dtype=np.uint8)
            table[pair] = taken_for
            noisy = table[noisy]
    height, width = noisy.shape
    v, u = np.mgrid[:height, :width]
    dv, du = (sum(strength * _wave(noisy.shape, *wave, rng) for wave in WAVES) for _ in range(2))
    rows = np.clip(np.rint(v + dv), 0, height - 1).astype(int)
    columns = np.clip(np.rint(u + du), 0, width - 1).astype(int)
    moved = Image.fromarray(noisy[rows, columns])
    return np.array(moved.filter(ImageFilter.ModeFilter(SMOOTHING)))


def spoil_labels(
    groups: np.ndarray, labels: LabelSet, person_height: float, level: Level, rng: np.random.Generator
) -> np.ndarray:
    """Group ids with limbs on the wrong side or missing, holes, and an outline too wide or too narrow, shape (H, W).

    Args:
        groups: Group ids, shape (H, W), uint8.
        labels: Their label set, with left and right limbs of three parts.
        person_height: Stature in the picture [px].
        level: How much.
        rng: Source of chance.
    """
    table = np.arange(256, dtype=np.uint8)
    if rng.random() < level.swap:
        parts = LIMBS[rng.integers(len(LIMBS))]
        left, right = ([labels.group_names.index(f"{side}_{part}") + 1 for part in parts] for side in ("left", "right"))
        table[[*left, *right]] = [*right, *left]
    if rng.random() < level.missing:
        parts, side = LIMBS[rng.integers(len(LIMBS))], ("left", "right")[rng.integers(2)]
        lost = [labels.group_names.index(f"{side}_{part}") + 1 for part in parts]
        table[np.isin(table, lost)] = BACKGROUND
    spoiled = table[groups]
    rows, columns = np.nonzero(spoiled)
    holes = np.zeros(spoiled.shape, dtype=bool)
    for _ in range(rng.poisson(level.holes) if rows.size else 0):
        at = rng.integers(rows.size)
        centre = np.array([columns[at], rows[at]] * 2) + 0.5
        lower_near(holes, centre, rng.uniform(*_HOLE) * person_height)
    spoiled[holes] = BACKGROUND
    return _grow(spoiled, int(rng.integers(-level.growth, level.growth + 1)))


def _grow(groups: np.ndarray, pixels: int) -> np.ndarray:
    """The person dilated by so many pixels, or eroded if negative; new pixels take a label from beside them."""
    grown = groups.copy()
    for _ in range(abs(pixels)):
        padded = np.pad(grown, 1, mode="edge")
        beside = np.stack([padded[:-2, 1:-1], padded[2:, 1:-1], padded[1:-1, :-2], padded[1:-1, 2:]])
        if pixels > 0:
            grown = np.where(grown == BACKGROUND, beside.max(0), grown)
        else:
            grown = np.where(beside.min(0) == BACKGROUND, BACKGROUND, grown)
    return grown.astype(np.uint8)


def _lose_small_parts(groups: np.ndarray, rng: np.random.Generator, chance: float) -> np.ndarray:
    """Give small parts, now and then, the label that is most common around them."""
    noisy = groups.copy()
    for group in np.unique(groups[groups > 0]):
        mask = groups == group
        if rng.random() < chance and mask.sum() < SMALL_PART * (groups > 0).sum():
            grown = np.array(Image.fromarray(mask.astype(np.uint8)).filter(ImageFilter.MaxFilter(5)), dtype=bool)
            noisy[mask] = np.bincount(groups[grown & ~mask]).argmax()
    return noisy


def _wave(shape: tuple[int, ...], deviation: float, period: float, rng: np.random.Generator) -> np.ndarray:
    """A smooth random field of about this standard deviation, shape (H, W)."""
    coarse = rng.standard_normal([int(np.ceil(size / period)) + 1 for size in shape]).astype(np.float32)
    fine = np.array(Image.fromarray(coarse).resize((shape[1], shape[0]), Image.Resampling.BICUBIC))
    return deviation * fine / max(float(fine.std()), 1e-6)
