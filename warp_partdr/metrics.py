"""Accuracy of part labels and joints, as the field computes it."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from .body.labels import IGNORE


def confusion(predicted: np.ndarray, target: np.ndarray, num_classes: int) -> np.ndarray:
    """Counts of (target class, predicted class), shape (C, C), int64; pixels whose target is 255 do not count.

    Add those of several pictures to pool them, as the LSP segmentation metric does.

    Args:
        predicted: Class ids, any integer shape; 255 counts as background.
        target: The same shape; 0 = background, 255 = ignore.
        num_classes: C, background included.

    Raises:
        ValueError: If the shapes differ or a class is out of range.
    """
    predicted, target = np.asarray(predicted), np.asarray(target)
    if predicted.shape != target.shape:
        raise ValueError(f"predicted: shape {predicted.shape}; expected {target.shape}, as target")
    counted = target != IGNORE
    have, want = predicted[counted].astype(np.int64), target[counted].astype(np.int64)
    have[have == IGNORE] = 0
    for name, values in (("predicted", have), ("target", want)):
        if values.size and values.max() >= num_classes:
            raise ValueError(f"{name}: class {values.max()}; expected 0 to {num_classes - 1}, or {IGNORE} = ignore")
    return np.bincount(want * num_classes + have, minlength=num_classes**2).reshape(num_classes, num_classes)


def f1_scores(counts: np.ndarray) -> np.ndarray:
    """2 TP / (2 TP + FP + FN) of each class, shape (C,); NaN for a class that is nowhere."""
    hits = np.diag(counts).astype(np.float64)
    total = counts.sum(0) + counts.sum(1)
    return np.divide(2 * hits, total, out=np.full(len(counts), np.nan), where=total > 0)


def part_f1(counts: np.ndarray) -> float:
    """Unweighted mean F1 over all classes that occur, background included."""
    return float(np.nanmean(f1_scores(counts)))


def foreground_counts(counts: np.ndarray) -> np.ndarray:
    """The same counts with all parts as one class, shape (2, 2)."""
    return np.array(
        [[counts[0, 0], counts[0, 1:].sum()], [counts[1:, 0].sum(), counts[1:, 1:].sum()]], dtype=counts.dtype
    )


def accuracy(counts: np.ndarray) -> float:
    """Share of pixels that are right."""
    return float(np.trace(counts) / max(counts.sum(), 1))


def align_similarity(points: np.ndarray, target: np.ndarray) -> np.ndarray:
    """``points`` after the similarity (proper rotation, scale, translation) that brings them nearest to ``target``.

    Args:
        points: Shape (..., J, 3).
        target: The same shape.
    """
    centre, target_centre = points.mean(-2, keepdims=True), target.mean(-2, keepdims=True)
    source, image = points - centre, target - target_centre
    u, s, vt = np.linalg.svd(np.swapaxes(image, -1, -2) @ source)
    sign = np.ones(s.shape)
    sign[..., -1] = np.sign(np.linalg.det(u @ vt))
    rotation = (u * sign[..., None, :]) @ vt
    spread = np.maximum((source**2).sum((-1, -2)), 1e-12)
    scale = (s * sign).sum(-1) / spread
    return scale[..., None, None] * (source @ np.swapaxes(rotation, -1, -2)) + target_centre


def mpjpe(points: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Mean distance of joints [as given], pelvis-centred by the caller, shape (...)."""
    return np.linalg.norm(points - target, axis=-1).mean(-1)


def pa_mpjpe(points: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Mean distance of joints after ``align_similarity``, shape (...)."""
    return mpjpe(align_similarity(points, target), target)


def pooled(matrices: Iterable[np.ndarray]) -> np.ndarray:
    """Sum of confusion counts over pictures."""
    return np.sum(list(matrices), axis=0)
