"""Comparison of people who are found in a photo with the truth about it."""

from __future__ import annotations

import numpy as np

from ..body.skeletons import MPJPE_JOINTS, skeleton
from ..pipelines.photo import PhotoFit
from ..solve.confidence.limbs import LIMBS
from .synthetic.hard_photos import HardPhoto, PhotographedPerson

_STATURE = 1.7  # [m], to which errors are scaled
_FEWEST = 3  # joints that must be seen; otherwise, all joints count
_SAME = 0.2  # largest median distance of a found person's keypoints from the true ones, as a share of the height
_BODY = tuple(skeleton("coco17").landmarks[5:])
_LIMB_JOINTS = {"head": ("neck", "head_top")}


def match_truth(fit: PhotoFit, photo: HardPhoto) -> dict[int, int]:
    """Index of the true person for each found person; the nearest pairs come first."""
    format_rows = [fit.people[0].keypoints.format.landmarks.index(name) for name in skeleton("coco17").landmarks]
    distances = np.array(
        [
            [
                np.median(np.linalg.norm(found.keypoints.points[format_rows] - true.keypoints, axis=1)) / true.height
                for true in photo.people
            ]
            for found in fit.people
        ]
    )
    same: dict[int, int] = {}
    for flat in np.argsort(distances, axis=None).tolist():
        found, true = divmod(flat, len(photo.people))
        if distances[found, true] < _SAME and found not in same and true not in same.values():
            same[found] = true
    return same


def seen_errors(joints: np.ndarray, person: PhotographedPerson) -> tuple[float, float, np.ndarray]:
    """Errors of a found body, for a person of 1.7 m.

    Args:
        joints: LSP's 14 joints of the found body [m], shape (14, 3).
        person: Person whom the body shows.

    Returns:
        Mean error of the joints that the photo shows in depth, and across the picture [m]; and the mean distance of
        each limb's joints [m], shape (5,). All are after a move that brings the mean of the seen joints to the truth.
    """
    differences = (joints - person.joints) * (_STATURE / person.stature)
    names = list(MPJPE_JOINTS)
    body = [names.index(name) for name in _BODY]
    seen = person.seen[5:] if person.seen[5:].sum() >= _FEWEST else np.ones(len(_BODY), dtype=bool)
    shown = differences[body][seen]
    depth, across = depth_and_across(shown)
    differences = differences - shown.mean(axis=0)
    limbs = []
    for limb in LIMBS:
        rows = [names.index(name) for name in _LIMB_JOINTS.get(limb.name, limb.joints)]
        limbs.append(np.linalg.norm(differences[rows], axis=1).mean())
    return float(depth), float(across), np.array(limbs)


def depth_and_across(differences: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean errors in depth and across the picture, after a move that brings the mean of the joints to the truth.

    Args:
        differences: Joints minus the true ones in the frame of a camera [m], NaN where unknown, shape (..., J, 3).

    Returns:
        Errors in depth, and across the picture [m], shape (...) each.
    """
    errors = differences - np.nanmean(differences, axis=-2, keepdims=True)
    return np.nanmean(np.abs(errors[..., 2]), axis=-1), np.nanmean(np.linalg.norm(errors[..., :2], axis=-1), axis=-1)
