"""Stray labels, a stranger's or a thing's pixels far from the part whose label they have: they become "ignore".

They would pull limbs away, and F1 of the foreground hides it. Confident keypoints bound where each part may be.
"""

from __future__ import annotations

import numpy as np

from ..body.labels import BACKGROUND, IGNORE, LabelSet
from .agreement import coarse, distances_beyond
from .keypoints import Keypoints2D
from .person import connected

_FAR = 0.1  # of the person's height, beyond a part's bones and flesh: nothing of it reaches there, clothes included
_LEAST = 0.01  # of the person's pixels: less does no harm
_CONFIRMED = 0.25  # pixels about a part's bones for each one far away; with fewer, its keypoints are in doubt


def ignore_stray_labels(groups: np.ndarray, keypoints: Keypoints2D, labels: LabelSet) -> tuple[np.ndarray, set[str]]:
    """Turn blobs of labels far from any bone of their part, or of its mirror image, into 255, ignore.

    A whole connected blob is turned, up to the part's flesh. A label whose part has no confident keypoints stays, and
    so does one that is mostly elsewhere than its keypoints.

    Args:
        groups: Group ids with only this person's in them (``select_person``), shape (H, W), uint8.
        keypoints: The person's.
        labels: What the group ids mean.

    Returns:
        Group ids of shape (H, W), uint8, and the names of the groups that had stray pixels.
    """
    cleaned, names = groups.copy(), set()
    stride = coarse(groups)
    thin = groups[::stride, ::stride]
    least = max(_LEAST * np.count_nonzero((thin != BACKGROUND) & (thin != IGNORE)), 1.0)
    for glance in distances_beyond(groups, keypoints, labels, stride=stride):
        far = np.count_nonzero(glance.distances > _FAR)
        if far < least or np.count_nonzero(glance.distances <= 0.0) < _CONFIRMED * far:
            continue
        for each in distances_beyond(groups, keypoints, labels, only=glance.group):
            blob, seeds = np.zeros((2, *groups.shape), dtype=bool)
            blob[each.rows, each.columns] = each.distances > 0.0
            seeds[each.rows, each.columns] = each.distances > _FAR
            cleaned[connected(blob, seeds)] = IGNORE
        names.add(glance.name)
    return cleaned, names
