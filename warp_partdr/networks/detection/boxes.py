"""Boxes of the detector: anchors, decoding, and one box for the many that mean the same person.

A box is a row of four points, each (x, y): its centre and size, then four points of the person, of which the first two
count: the middle of the hips, and a point on the circle about it that holds the whole body.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import torch

STRIDES = ((8, 2), (16, 2), (32, 6))  # [px] between the cells of each grid, and anchors of each cell
SAME = 0.3  # Intersection over union above which two boxes are of one person.
NUM_POINTS = 6  # rows of a box: centre, size, four points


@lru_cache
def anchors(size: int) -> np.ndarray:
    """Centres of the detector's anchors in a picture of side ``size`` [px], shape (A, 2), float64."""
    rows = []
    for stride, count in STRIDES:
        cells = (np.arange(size // stride) + 0.5) * stride
        y, x = np.meshgrid(cells, cells, indexing="ij")
        rows.append(np.repeat(np.stack([x, y], axis=-1).reshape(-1, 2), count, axis=0))
    return np.concatenate(rows)


def decode(boxes: torch.Tensor, scores: torch.Tensor, size: int, min_score: float) -> tuple[np.ndarray, ...]:
    """Boxes of B pictures with a score above ``min_score``; only these leave the device.

    Args:
        boxes: The detector's, relative to the anchors [px], shape (B, A, 12).
        scores: Logits, shape (B, A).
        size: Side of the pictures [px].
        min_score: Least score of a box, 0 to 1.

    Returns:
        Boxes [px], shape (N, 6, 2), scores from 0 to 1, shape (N,), and the picture of each, shape (N,), in order.
    """
    confidence = scores.double().sigmoid()
    chosen = confidence > min_score
    pictures, kept = (each.cpu().numpy() for each in chosen.nonzero(as_tuple=True))
    found = boxes[chosen].double().cpu().numpy().reshape(-1, NUM_POINTS, 2)
    moved = np.arange(NUM_POINTS) != 1  # all but the size
    found = found + anchors(size)[kept, None] * moved[:, None]
    return found, confidence[chosen].cpu().numpy(), pictures


def overlap(box: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """Intersection over union of boxes (N, 6, 2) with one (6, 2), or each with its own (N, 6, 2), shape (N,)."""
    middle, size = box[..., 0, :], box[..., 1, :]
    low = np.maximum(middle - size / 2, boxes[:, 0] - boxes[:, 1] / 2)
    high = np.minimum(middle + size / 2, boxes[:, 0] + boxes[:, 1] / 2)
    common = np.clip(high - low, 0.0, None).prod(axis=1)
    return common / np.maximum(size.prod(axis=-1) + boxes[:, 1].prod(axis=1) - common, 1e-9)


def average_boxes(boxes: np.ndarray, scores: np.ndarray, pictures: np.ndarray) -> tuple[np.ndarray, ...]:
    """One box a person: the mean, by score, of those that overlap the best of them.

    Args:
        boxes: Boxes, shape (N, 6, 2).
        scores: Score of each box, shape (N,).
        pictures: Index of each box's picture, shape (N,).

    Returns:
        Boxes, shape (M, 6, 2), the best score of each, shape (M,), and its picture, shape (M,): picture by picture,
        best first.
    """
    left = np.lexsort((-scores, pictures))
    means, best, whose = [np.zeros((0, NUM_POINTS, 2))], [np.zeros(0)], [pictures[:0]]
    while len(left):
        there, first, counts = np.unique(pictures[left], return_index=True, return_counts=True)
        lead = left[first]
        same = overlap(boxes[np.repeat(lead, counts)], boxes[left]) > SAME
        same[first] = True  # also a box without an area
        weights = np.where(same, scores[left], 0.0)[:, None, None]
        means.append(np.add.reduceat(boxes[left] * weights, first) / np.add.reduceat(weights, first))
        best.append(scores[lead])
        whose.append(there)
        left = left[~same]
    order = np.argsort(np.concatenate(whose), kind="stable")
    return tuple(np.concatenate(each)[order] for each in (means, best, whose))
