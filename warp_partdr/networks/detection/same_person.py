"""People who were found twice: their crops are about the same, or their landmarks coincide."""

from __future__ import annotations

import numpy as np

from .crops import TurnedCrops

_SPREAD = 0.05  # of a landmark between two looks at one person, as a share of the crop's side
_ALIKE = 0.5  # Similarity above which two are one.

# Crops about one person: distance of centres as a share of the larger side, ratio of sides, angle between them [rad].
_NEAR, _RATIO, _TURN = 0.15, 0.5, 0.8


# Of people: landmarks (..., K, 2) [px], their confidence (..., K), and sides of their crops (...) [px].
Landmarks = tuple[np.ndarray, np.ndarray, np.ndarray]


def similarity(ours: Landmarks, theirs: Landmarks) -> np.ndarray:
    """Likeness of people's landmarks to those of others, as COCO's object keypoint similarity, 0 to 1, shape (N,)."""
    squares = ((theirs[0] - ours[0]) ** 2).sum(axis=-1)
    spreads = (_SPREAD**2 * ours[2] * theirs[2])[:, None]
    weights = np.minimum(ours[1], theirs[1]) + 1e-3  # where nothing is sure, all count alike
    return (weights * np.exp(-squares / (2 * spreads))).sum(axis=1) / weights.sum(axis=1)


def first_of_each(
    points: np.ndarray, confidence: np.ndarray, sides: np.ndarray, pictures: np.ndarray, quality: np.ndarray
) -> np.ndarray:
    """Rows of the best look at each person, in their order.

    Args:
        points: Landmarks [px], shape (N, K, 2).
        confidence: Confidence of each landmark, shape (N, K).
        sides: Sides of the crops [px], shape (N,).
        pictures: Index of each one's picture, shape (N,).
        quality: Quality of each look, where higher is better, shape (N,).
    """
    kept = []
    for left in _by_picture(np.argsort(-quality, kind="stable"), pictures):
        while len(left):
            best, left = left[0], left[1:]
            kept.append(best)
            if len(left):
                ours, theirs = ((points[rows], confidence[rows], sides[rows]) for rows in (best, left))
                left = left[similarity(ours, theirs) < _ALIKE]
    return np.sort(np.array(kept, dtype=np.int64))


def _by_picture(rows: np.ndarray, pictures: np.ndarray) -> list[np.ndarray]:
    """Rows of each picture, in their order."""
    rows = rows[np.argsort(pictures[rows], kind="stable")]
    return np.split(rows, np.flatnonzero(np.diff(pictures[rows])) + 1)


def distinct_crops(crops: TurnedCrops, scores: np.ndarray) -> tuple[TurnedCrops, np.ndarray]:
    """Crops without those that are about the same as one before them; two people arm in arm keep their own.

    Returns:
        The crops, and of each the best score (N,) of those that it stands for.
    """
    every: list[int] = []
    best = scores.copy()
    for some in _by_picture(np.arange(len(crops)), crops.pictures):
        kept: list[int] = []
        for row in some.tolist():
            first = _first_alike(crops, row, kept)
            if first is None:
                kept.append(row)
            else:
                best[first] = max(best[first], scores[row])
        every += kept
    rows = np.sort(np.array(every, dtype=np.int64))
    return crops[rows], best[rows]


def _first_alike(crops: TurnedCrops, row: int, kept: list[int]) -> int | None:
    """The first of the kept crops that is about the same as this one; None if there is none."""
    if not kept:
        return None
    ours, theirs = crops[np.array([row])], crops[np.array(kept, dtype=np.int64)]
    larger, smaller = np.maximum(ours.sides, theirs.sides), np.minimum(ours.sides, theirs.sides)
    near = np.linalg.norm(ours.centres - theirs.centres, axis=1) < _NEAR * larger
    turned = np.abs(np.angle(np.exp(1j * (ours.angles - theirs.angles))))
    alike = near & (smaller > _RATIO * larger) & (turned < _TURN)
    return kept[int(alike.argmax())] if alike.any() else None
