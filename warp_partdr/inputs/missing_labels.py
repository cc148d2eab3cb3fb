"""Limbs that part labels miss though confident keypoints show them: background there becomes "ignore".

Networks miss limbs that are dark, blurred or behind something. Background where an arm is would make a fit hide the
arm: thin, or pointing along the line of sight. Where labels contradict keypoints, keypoints decide.
"""

from __future__ import annotations

import numpy as np

from ..body.labels import BACKGROUND, IGNORE
from ..body.template import MEAN_STATURE, PART_NAMES, SHAPE_INDICES, template
from .agreement import bone_ends, confident_points, labels_along
from .keypoints import Keypoints2D, person_height
from .person import lower_near

_LIMBS = ("upper_arm", "forearm", "upper_leg", "lower_leg")
_MISSING = 1 / 3  # share of a bone on background from which on its limb is missing
_SAMPLES = 64  # points along a bone
_MARGIN = 0.01  # of the person's height: about how far keypoints are off


def ignore_missing_limbs(groups: np.ndarray, keypoints: Keypoints2D) -> np.ndarray:
    """Turn background into 255, ignore, along the limbs that the labels miss.

    A limb is missing if at least a third of the bone between its two confident keypoints lies on background. What is
    then ignored is as wide as the limb of a mean adult of the person's height, and a little wider, for keypoints are
    not exact; with a forearm the hand, which few formats have keypoints of, straight on. Only background changes, so a
    limb behind another part is not missing.

    Args:
        groups: Group ids with only this person's in them (``select_person``), shape (H, W).
        keypoints: The person's.

    Returns:
        Group ids of shape (H, W), uint8.
    """
    shape = template()
    height = person_height(keypoints)
    points = confident_points(keypoints)
    near = np.zeros(groups.shape, dtype=bool)
    for side in ("left", "right"):
        for limb in _LIMBS:
            part = PART_NAMES.index(f"{side}_{limb}")
            joints = bone_ends(part)
            if not points.keys() >= set(joints):
                continue
            start, end = (points[joint] for joint in joints)
            if _background_share(groups, start, end) < _MISSING:
                continue
            length, thickness, _ = SHAPE_INDICES[part]
            if limb == "forearm":
                hand = SHAPE_INDICES[PART_NAMES.index(f"{side}_hand")][0]
                end = end + (end - start) * (shape.mean_lengths[hand] / shape.mean_lengths[length])
            half = shape.mean_thicknesses[thickness] / (2 * MEAN_STATURE) + _MARGIN
            lower_near(near, np.concatenate([start, end]), half * height)
    return np.where(near & (groups == BACKGROUND), IGNORE, groups).astype(np.uint8)


def _background_share(groups: np.ndarray, start: np.ndarray, end: np.ndarray) -> float:
    """Share of the line from one point (x, y) to another that lies on background; beyond the picture none does."""
    shown = labels_along(groups, start, end, samples=_SAMPLES)
    return np.count_nonzero(shown == BACKGROUND) / _SAMPLES
