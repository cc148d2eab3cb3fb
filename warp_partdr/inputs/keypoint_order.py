"""Doubts about the order of keypoints without names: another format may have the same number of them.

A body's bones have about the same proportions in every picture; if they are seen at an angle, they only get shorter. In
a wrong order, "bones" lead across the body, and many are far too long beside the others. Nothing is changed here: if
another format with as many points fits far better, a warning names it.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ..body.landmarks import without_side
from ..body.skeletons import SKELETONS, Skeleton

# Lengths of the formats' edges as shares of the stature, of the mean adult of body/mean_body.json in the rest pose.
_SHARES = {
    "ankle-big_toe": 0.117,
    "ankle-heel": 0.031,
    "ankle-knee": 0.242,
    "big_toe-small_toe": 0.04,
    "ear-eye": 0.057,
    "ear-nose": 0.077,
    "ear-shoulder": 0.136,
    "elbow-shoulder": 0.152,
    "elbow-wrist": 0.137,
    "eye-nose": 0.029,
    "head-head_top": 0.109,
    "head-neck": 0.092,
    "head-shoulder": 0.136,
    "head_top-neck": 0.201,
    "head_top-nose": 0.103,
    "hip-hip": 0.123,
    "hip-knee": 0.236,
    "hip-mid_hip": 0.062,
    "hip-shoulder": 0.265,
    "mid_hip-neck": 0.262,
    "mid_hip-spine": 0.133,
    "neck-nose": 0.139,
    "neck-shoulder": 0.099,
    "neck-spine": 0.131,
    "shoulder-shoulder": 0.199,
}
_FEWEST_BONES = 6  # least number from which proportions are judged
# 400 random poses were seen from all sides, with an error of 4 px in 415. In their own order, 99 % have an excess below
# 0.16. In a wrong order, for body25, coco17 and lsp14 taken for formats with as many points, 95 % have 0.19 or more.
_MOST_EXCESS = 0.17
_FAR_BETTER = 0.5  # share of the excess
_FACE = ("nose", "left_eye", "right_eye")
_FACE_CONFIDENCE = 0.8  # least confidence of a face that is turned to the camera
_LEAST_EYES, _LEAST_SHOULDERS = 0.1, 0.4  # least distances of the two eyes, and of the two shoulders, as shares of the
# distance from eyes to shoulders


def alternatives(form: Skeleton) -> list[Skeleton]:
    """Other formats with as many points, in another order."""
    same_count = [other for other in SKELETONS.values() if other.count == form.count]
    return [other for other in same_count if other.landmarks != form.landmarks]


def order_question(form: Skeleton) -> str | None:
    """Question to the user if no body fits the keypoints; None if no other format has as many points."""
    others = [other.name for other in alternatives(form)]
    return f"are these keypoints of {form.name}, not of {' or '.join(others)}?" if others else None


def order_warning(form: Skeleton, points: np.ndarray, confidence: np.ndarray) -> str | None:
    """Warning if one person's keypoints fit another format with as many points far better; None if none does.

    Args:
        form: Format in ``SKELETONS``, chosen by its name or by the number of points.
        points: Keypoints of the person [px], shape (J, 2).
        confidence: Confidences of the keypoints, 0 where missing, shape (J,).
    """
    if SKELETONS.get(form.name) is not form:
        return None
    mine = bone_excess(form, points, confidence)
    if not _MOST_EXCESS < mine < np.inf:
        return None
    # If not all points of a format are landmarks, the numbers of rows may differ.
    others = [other for other in alternatives(form) if len(other) == len(form)]
    excesses = sorted((bone_excess(other, points, confidence), other.name) for other in others)
    better = [name for excess, name in excesses if excess < _FAR_BETTER * mine]
    if not better:
        return None
    return (
        f"keypoints: they look like {' or '.join(better)}, not {form.name}; expected --format {better[0]} if they are"
    )


def bone_excess(form: Skeleton, points: np.ndarray, confidence: np.ndarray) -> float:
    """Mean excess of the bones' lengths over the median bone [natural logarithm]; infinite if there are too few."""
    edges, shares = _bones(form)
    known = (confidence[edges] > 0).all(axis=1)
    if known.sum() < _FEWEST_BONES:
        return np.inf
    lengths = np.linalg.norm(points[edges[known, 0]] - points[edges[known, 1]], axis=1) / shares[known]
    middle = _median(lengths.tolist())
    if middle <= 0:
        return np.inf
    return float(np.log(np.maximum(lengths / middle, 1.0)).mean())


def _median(values: list[float]) -> float:
    """Median of at least one number. ``numpy.median`` takes ten times as long for so few."""
    ordered, half = sorted(values), len(values) // 2
    return ordered[half] if len(values) % 2 else (ordered[half - 1] + ordered[half]) / 2


@lru_cache
def _bones(form: Skeleton) -> tuple[np.ndarray, np.ndarray]:
    """Edges of a format whose length is known, shape (N, 2), and their shares of the stature, shape (N,)."""
    found = []
    for edge in form.edges:
        name = "-".join(sorted(without_side(form.landmarks[joint]) for joint in edge))
        if name in _SHARES:
            found.append((edge, _SHARES[name]))
    return np.array([edge for edge, _ in found]).reshape(-1, 2), np.array([share for _, share in found])


def mirror_warning(form: Skeleton, points: np.ndarray, confidence: np.ndarray) -> str | None:
    """Warning if a face is turned to the camera, but its left eye lies where a mirrored person's does; else None.

    There is a warning only if eyes and shoulders agree, and if confidences differ: equal ones do not say what is
    visible. Arguments are those of ``order_warning``, but of any skeleton.
    """
    names = (*_FACE, "left_shoulder", "right_shoulder")
    if not set(names) <= set(form.landmarks) or confidence.min() == confidence.max():
        return None
    joints = [form.landmarks.index(name) for name in names]
    if confidence[joints].min() < _FACE_CONFIDENCE:
        return None
    _, left_eye, right_eye, left, right = points[joints].astype(np.float64)
    down = (left + right - left_eye - right_eye) / 2
    height = float(np.linalg.norm(down))
    # If a person faces the camera, head up, the person's left is to the right in the picture.
    between_eyes = left_eye - right_eye
    between_shoulders = left - right
    eyes = float(down[0] * between_eyes[1] - down[1] * between_eyes[0])
    shoulders = float(down[0] * between_shoulders[1] - down[1] * between_shoulders[0])
    if eyes <= _LEAST_EYES * height**2 or shoulders <= _LEAST_SHOULDERS * height**2:
        return None
    return "keypoints: the face is seen, but lies as in a mirror; are left and right exchanged?"
