"""People who were found twice: their landmarks coincide."""

from __future__ import annotations

import numpy as np

_SPREAD = 0.05  # of a landmark between two looks at one person, as a share of the crop's side
SAME = 0.5  # Similarity above which two are one.


def similarity(
    points: np.ndarray, confidence: np.ndarray, sides: np.ndarray, others: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> np.ndarray:
    """Likeness of a person's landmarks to those of others, as COCO's object keypoint similarity, 0 to 1.

    Args:
        points: The person's [px], shape (K, 2).
        confidence: Shape (K,).
        sides: Side of the person's crop [px], shape ().
        others: The same of N others.

    Returns:
        Shape (N,).
    """
    their_points, their_confidence, their_sides = others
    squares = ((their_points - points) ** 2).sum(axis=-1)
    spreads = (_SPREAD**2 * sides * their_sides)[:, None]
    weights = np.minimum(confidence, their_confidence) + 1e-3  # where nothing is sure, all count alike
    return (weights * np.exp(-squares / (2 * spreads))).sum(axis=1) / weights.sum(axis=1)


def first_of_each(
    points: np.ndarray, confidence: np.ndarray, sides: np.ndarray, pictures: np.ndarray, quality: np.ndarray
) -> np.ndarray:
    """Rows of the best look at each person, in their order.

    Args:
        points: Landmarks [px], shape (N, K, 2).
        confidence: Shape (N, K).
        sides: Of the crops [px], shape (N,).
        pictures: Index of each one's picture, shape (N,).
        quality: The higher the better, shape (N,).
    """
    left = np.argsort(-quality, kind="stable")
    kept = []
    while len(left):
        best, left = left[0], left[1:]
        kept.append(best)
        alike = similarity(points[best], confidence[best], sides[best], (points[left], confidence[left], sides[left]))
        left = left[(alike < SAME) | (pictures[left] != pictures[best])]
    return np.sort(np.array(kept, dtype=np.int64))
