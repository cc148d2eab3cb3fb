"""Doubts about the order of keypoints that no names tell: their number may be another format's, too.

A body's bones have about the same proportions in every picture; seen at an angle they only get shorter. In a wrong
order, "bones" lead across the body, and many are far too long beside the others. Nothing is changed here: where another
format of as many points fits far better, a warning names it.
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
_FEWEST_BONES = 6  # that tell proportions
# Of 400 random poses, seen from all sides with an error of 4 px of 415, 99 % have an excess below 0.16 in their own
# order. In a wrong one, 95 % have 0.19 or more, where body25, coco17 or lsp14 were taken for others of their number.
_MOST_EXCESS = 0.17
_FAR_BETTER = 0.5  # times the excess
_FACE = ("nose", "left_eye", "right_eye")
_SURELY_SEEN = 0.8  # confidence of a face that the camera looks at
_LEAST_EYES, _LEAST_SHOULDERS = 0.1, 0.4  # of the distance from eyes to shoulders, between those of the two sides


def alternatives(form: Skeleton) -> list[Skeleton]:
    """Other formats with as many points, in another order."""
    alike = [other for other in SKELETONS.values() if other.count == form.count]
    return [other for other in alike if other.landmarks != form.landmarks]


def order_question(form: Skeleton) -> str | None:
    """Question about the format of keypoints that no body fits; None if no other format has as many points."""
    others = [other.name for other in alternatives(form)]
    return f"are these keypoints of {form.name}, not of {' or '.join(others)}?" if others else None


def order_warning(form: Skeleton, points: np.ndarray, confidence: np.ndarray) -> str | None:
    """Sentence about one person's keypoints that fit another format of their number far better; None if none does.

    Args:
        form: A format of ``SKELETONS``, which was told by its name or by the number of points.
        points: The person's [px], shape (J, 2).
        confidence: Of these, 0 where missing, shape (J,).
    """
    if SKELETONS.get(form.name) is not form:
        return None
    mine = bone_excess(form, points, confidence)
    if not _MOST_EXCESS < mine < np.inf:
        return None
    # Of formats of which parts alone are landmarks, the rows differ.
    others = [other for other in alternatives(form) if len(other) == len(form)]
    excesses = sorted((bone_excess(other, points, confidence), other.name) for other in others)
    better = [name for excess, name in excesses if excess < _FAR_BETTER * mine]
    if not better:
        return None
    return (
        f"keypoints: they look like {' or '.join(better)}, not {form.name}; expected --format {better[0]} if they are"
    )


def bone_excess(form: Skeleton, points: np.ndarray, confidence: np.ndarray) -> float:
    """Mean of how much too long bones are beside the median one [natural logarithm]; infinite of too few bones."""
    edges, shares = _bones(form)
    there = (confidence[edges] > 0).all(axis=1)
    if there.sum() < _FEWEST_BONES:
        return np.inf
    lengths = np.linalg.norm(points[edges[there, 0]] - points[edges[there, 1]], axis=1) / shares[there]
    middle = float(np.median(lengths))
    if middle <= 0:
        return np.inf
    return float(np.log(np.maximum(lengths / middle, 1.0)).mean())


@lru_cache
def _bones(form: Skeleton) -> tuple[np.ndarray, np.ndarray]:
    """Edges (N, 2) of a format whose length is known, and their shares of the stature (N,)."""
    found = []
    for edge in form.edges:
        name = "-".join(sorted(without_side(form.landmarks[joint]) for joint in edge))
        if name in _SHARES:
            found.append((edge, _SHARES[name]))
    return np.array([edge for edge, _ in found]).reshape(-1, 2), np.array([share for _, share in found])


def mirror_warning(form: Skeleton, points: np.ndarray, confidence: np.ndarray) -> str | None:
    """Sentence about a face that the camera surely sees, but whose left eye lies where a mirrored person's does.

    Eyes and shoulders must agree, and confidences differ: if all are equal, they do not say what the camera sees.
    Arguments as of ``order_warning``, of any skeleton.
    """
    names = (*_FACE, "left_shoulder", "right_shoulder")
    if not set(names) <= set(form.landmarks) or confidence.min() == confidence.max():
        return None
    joints = [form.landmarks.index(name) for name in names]
    if confidence[joints].min() < _SURELY_SEEN:
        return None
    _, left_eye, right_eye, left, right = points[joints].astype(np.float64)
    down = (left + right - left_eye - right_eye) / 2
    height = float(np.linalg.norm(down))
    # Seen from in front, with the head up, a person's left is to the right in the picture.
    eyes, shoulders = (
        float(down[0] * across[1] - down[1] * across[0]) for across in (left_eye - right_eye, left - right)
    )
    if eyes <= _LEAST_EYES * height**2 or shoulders <= _LEAST_SHOULDERS * height**2:
        return None
    return "keypoints: the face is seen, but lies as in a mirror; are left and right exchanged?"
