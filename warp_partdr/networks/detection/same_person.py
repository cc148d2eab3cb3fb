"""People who were found twice: their landmarks coincide."""

from __future__ import annotations

import numpy as np

_SPREAD = 0.05  # of a landmark between two looks at one person, as a share of the crop's side
_ALIKE = 0.5  # Similarity above which two are one.

# Of people: landmarks (..., K, 2) [px], their confidence (..., K), and sides of their crops (...) [px].
Landmarks = tuple[np.ndarray, np.ndarray, np.ndarray]


def similarity(ours: Landmarks, theirs: Landmarks) -> np.ndarray:
    """Likeness of people's landmarks to those of others, as COCO's object keypoint similarity, 0 to 1, shape (N,)."""
    squares = ((theirs[0] - ours[0]) ** 2).sum(axis=-1)
    spreads = (_SPREAD**2 * ours[2] * theirs[2])[:, None]
    weights = np.minimum(ours[1], theirs[1]) + 1e-3  # where nothing is sure, all count alike
    return (weights * np.exp(-squares / (2 * spreads))).sum(axis=1) / weights.sum(axis=1)


def first_of_each(
    points: np.ndarray,
    confidence: np.ndarray,
    sides: np.ndarray,
    pictures: np.ndarray,
    quality: np.ndarray,
    head: slice | None = None,
) -> np.ndarray:
    """Rows of the best look at each person, in their order.

    Args:
        points: Landmarks [px], shape (N, K, 2).
        confidence: Confidence of each landmark, shape (N, K).
        sides: Sides of the crops [px], shape (N,).
        pictures: Index of each one's picture, shape (N,).
        quality: Quality of each look, where higher is better, shape (N,).
        head: Landmarks of the head. If they are given, looks at one head are of one person, too.
    """
    kept = []
    for left in _by_picture(np.argsort(-quality, kind="stable"), pictures):
        while len(left):
            best, left = left[0], left[1:]
            kept.append(best)
            if not len(left):
                break
            alike = similarity(
                (points[best], confidence[best], sides[best]), (points[left], confidence[left], sides[left])
            )
            if head is not None:
                heads = similarity(
                    (points[best, head], confidence[best, head], sides[best]),
                    (points[left, head], confidence[left, head], sides[left]),
                )
                alike = np.maximum(alike, heads)
            left = left[alike < _ALIKE]
    return np.sort(np.array(kept, dtype=np.int64))


def _by_picture(rows: np.ndarray, pictures: np.ndarray) -> list[np.ndarray]:
    """Rows of each picture, in their order."""
    rows = rows[np.argsort(pictures[rows], kind="stable")]
    return np.split(rows, np.flatnonzero(np.diff(pictures[rows])) + 1)
