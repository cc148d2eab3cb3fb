"""What networks do to the truth: keypoints jitter, boundaries of labels wander, small parts get lost."""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageFilter

from warp_partdr.body.labels import LabelSet

KEYPOINT_NOISE = 0.01  # standard deviation of u and of v, of the person's height in the picture
HIDDEN_NOISE = 2.0  # times that for hidden joints
HIDDEN_CONFIDENCE = 0.5

# Boundaries move by the sum of smooth random fields: (standard deviation, distance over which they change) [px].
WAVES = ((1.2, 8.0), (1.5, 30.0))
SMOOTHING = 7  # [px], side of the window whose majority wins at the end; smaller blobs vanish
SMALL_PART = 0.012  # of the person's pixels: a part that shows less is lost with this chance:
LOSS = 0.35
CONFUSION = 0.12  # chance that the hands are confused; the same for the feet


def noisy_keypoints(
    points: np.ndarray, hidden: np.ndarray, person_height: float, rng: np.random.Generator
) -> np.ndarray:
    """Keypoints as a detector gives them, shape (J, 3): u, v [px] and confidence.

    Args:
        points: True positions [px], shape (J, 2).
        hidden: Which are occluded, shape (J,).
        person_height: Stature in the picture [px].
        rng: Source of the noise.
    """
    spread = KEYPOINT_NOISE * person_height * np.where(hidden, HIDDEN_NOISE, 1.0)
    noisy = points + spread[:, None] * rng.standard_normal(points.shape)
    return np.column_stack([noisy, np.where(hidden, HIDDEN_CONFIDENCE, 1.0)])


def noisy_labels(groups: np.ndarray, labels: LabelSet, rng: np.random.Generator) -> np.ndarray:
    """Group ids as a segmentation network gives them, shape (H, W), uint8.

    Args:
        groups: True group ids, shape (H, W), uint8.
        labels: Their label set; it must have hands and feet.
        rng: Source of the noise.
    """
    noisy = _lose_small_parts(groups, rng)
    for kind in ("hand", "foot"):
        if rng.random() < CONFUSION:
            pair = [labels.group_names.index(f"{side}_{kind}") + 1 for side in ("left", "right")]
            # Exchanged, both taken for the left one, or both for the right one.
            taken_for = ((pair[1], pair[0]), (pair[0], pair[0]), (pair[1], pair[1]))[rng.integers(3)]
            table = np.arange(256, dtype=np.uint8)
            table[pair] = taken_for
            noisy = table[noisy]
    height, width = noisy.shape
    v, u = np.mgrid[:height, :width]
    dv, du = (sum(_wave(noisy.shape, *wave, rng) for wave in WAVES) for _ in range(2))
    rows = np.clip(np.rint(v + dv), 0, height - 1).astype(int)
    columns = np.clip(np.rint(u + du), 0, width - 1).astype(int)
    moved = Image.fromarray(noisy[rows, columns])
    return np.array(moved.filter(ImageFilter.ModeFilter(SMOOTHING)))


def _lose_small_parts(groups: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Give small parts, now and then, the label that is most common around them."""
    noisy = groups.copy()
    for group in np.unique(groups[groups > 0]):
        mask = groups == group
        if rng.random() < LOSS and mask.sum() < SMALL_PART * (groups > 0).sum():
            grown = np.array(Image.fromarray(mask.astype(np.uint8)).filter(ImageFilter.MaxFilter(5)), dtype=bool)
            noisy[mask] = np.bincount(groups[grown & ~mask]).argmax()
    return noisy


def _wave(shape: tuple[int, ...], deviation: float, period: float, rng: np.random.Generator) -> np.ndarray:
    """A smooth random field of about this standard deviation, shape (H, W)."""
    coarse = rng.standard_normal([int(np.ceil(size / period)) + 1 for size in shape]).astype(np.float32)
    fine = np.array(Image.fromarray(coarse).resize((shape[1], shape[0]), Image.Resampling.BICUBIC))
    return deviation * fine / max(float(fine.std()), 1e-6)
