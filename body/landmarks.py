"""Landmarks: the keypoints that data sets name, each a fixed point of one of the 20 ellipsoids.

A point n in an ellipsoid's own axes (bone, first thickness, second thickness), in units of its semi-axes, lies at
``centre + axes @ (semi_axes * n)``; (-1, 0, 0) is the start of the bone and (1, 0, 0) its end. So a landmark moves with
its bone and scales with the body, and every landmark is linear in what posing returns.

The joints of the model are landmarks under their own names. The others were read off Anny's default adult in the rest
pose, the body that ``mean_body.json`` measures: nose, eyes, ears, toes and heels of its COCO regressor, knuckles from
its finger bones. Some lie off the ellipsoid's surface, as a nose and a heel do.

Every data set has its own idea of where a hip is. What COCO's annotators marked is a landmark of its own, such as
"coco_left_hip", and so are the joints of ``CONVENTIONS``, such as "h36m_head_top". Which landmark a format's joint
stands for is in ``skeletons.py``.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from .template import BONE_STARTS, PART_NAMES, SHAPE_INDICES, template

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
# 2,000 random people by ``python -m warp_partdr.lab landmarks``, against whose bodies they move by 4 to 12 mm.
_ANNOTATED: dict[str, Point] = {
    "shoulder": ("left_shoulder", (0.84, -0.01, -0.23)),
    "elbow": ("left_upper_arm", (0.84, 0.10, 0.01)),
    "wrist": ("left_forearm", (0.98, 0.08, -0.06)),
    "hip": ("left_upper_leg", (-0.89, 0.15, 0.16)),
    "knee": ("left_lower_leg", (-0.88, 0.00, -0.04)),
    "ankle": ("left_lower_leg", (0.91, -0.02, -0.06)),
}
_SUFFIXED = ("mouth",)  # BlazePose says mouth_left.
_COCO = "coco"

Offset = tuple[float, float, float]  # to the person's left, up and forward in the rest pose [mm], of the mean adult

# Where joints of data sets lie from the landmarks of the same names, of the left side, fixed to the trunk or
# the head. Joints that are not here lie at the landmarks. Offsets were learned as ``scripts/learn_landmarks.py``
# does it, from people whose 3D joints are known; docs/reference/inputs.md says from how many, and how well each offset
# is known.
CONVENTIONS: dict[str, dict[str, tuple[str, Offset]]] = {
    "h36m": {
        "mid_hip": ("pelvis", (0.0, 29.3, 24.2)),
        "hip": ("pelvis", (17.1, 29.3, 24.2)),
        "spine": ("abdomen", (0.0, 40.8, -20.0)),
        "neck": ("chest", (0.0, 48.8, 16.7)),
        "head": ("head", (0.0, -17.6, 74.3)),
        "head_top": ("head", (0.0, -103.8, 7.7)),
        "shoulder": ("chest", (-23.6, -2.1, -0.7)),
    },
    "shelf": {
        "hip": ("pelvis", (4.9, -48.9, 70.3)),
        "shoulder": ("chest", (-12.6, -16.7, -11.5)),
        "neck": ("chest", (0.0, 98.5, 57.8)),
        "head_top": ("head", (0.0, -56.1, 54.0)),
    },
}


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
    for convention, offsets in CONVENTIONS.items():
        for name, (part, offset) in offsets.items():
            for side in ("left", "right") if name in _SIDED else ("",):
                own = f"{side}_{name}" if side else name
                table[f"{convention}_{own}"] = _offset_points(table[own], part, _sided_offset(offset, side), side)
    return table


def _sided_offset(offset: Offset, side: str) -> np.ndarray:
    """Offset of one side in the body frame [m]."""
    return np.array(offset) * ((-1.0 if side == "right" else 1.0), 1.0, 1.0) / 1000.0


def _offset_points(points: tuple[Point, ...], part: str, offset: np.ndarray, side: str) -> tuple[Point, ...]:
    """Points that carry what lies so far from the mean of other points in the mean adult at rest."""
    place = _rest_place(points) + offset
    if part == "pelvis":  # The hips are the pelvis.
        carriers = [f"{side}_hip"] if side else ["left_hip", "right_hip"]
    else:
        carriers = [part]
    return tuple((carrier, _normalised(carrier, place)) for carrier in carriers)


@lru_cache(maxsize=len(PART_NAMES))
def _rest_ellipsoid(part: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centre, axes as columns, and semi-axes of a part of the mean adult at rest, body frame [m]."""
    constants, index = template(), PART_NAMES.index(part)
    start, bone = np.zeros(3), index
    length = constants.mean_lengths[SHAPE_INDICES[index][0]]
    while (bone := BONE_STARTS[bone] - 1) >= 0:
        start = start + constants.mean_lengths[SHAPE_INDICES[bone][0]] * constants.rest_directions[bone]
    _, first, second = SHAPE_INDICES[index]
    sizes = np.array([length, constants.mean_thicknesses[first], constants.mean_thicknesses[second]])
    return start + length / 2 * constants.rest_directions[index], constants.rest_axes[index], sizes / 2


def _rest_place(points: tuple[Point, ...]) -> np.ndarray:
    """Mean of points of the mean adult at rest, body frame, shape (3,) [m]."""
    places = []
    for part, coordinates in points:
        centre, axes, semi_axes = _rest_ellipsoid(part)
        places.append(centre + axes @ (semi_axes * coordinates))
    return np.mean(places, axis=0)


def _normalised(part: str, place: np.ndarray) -> tuple[float, float, float]:
    centre, axes, semi_axes = _rest_ellipsoid(part)
    bone, first, second = (axes.T @ (place - centre) / semi_axes).tolist()
    return bone, first, second


def annotated(names: Sequence[str], known: Collection[str] | None = None, convention: str = _COCO) -> tuple[str, ...]:
    """Points where a data set marks the landmarks ``names``. They are the landmarks where it marks the body's own.

    Args:
        names: Landmarks.
        known: Landmarks that a model has. If it is None, they are EllipBody's.
        convention: Convention of the points: "coco", where COCO's annotators mark them, or one of ``CONVENTIONS``.
    """
    known = LANDMARKS if known is None else known
    return tuple(f"{convention}_{name}" if f"{convention}_{name}" in known else name for name in names)


def plain_landmark(mark: str) -> str:
    """Landmark that a data set's ``mark`` stands for: coco_left_hip -> left_hip."""
    convention, _, name = mark.partition("_")
    return name if convention in (_COCO, *CONVENTIONS) else mark


def rest_offset(mark: str) -> np.ndarray:
    """Way from a landmark to its ``mark`` in a data set, mean adult at rest, body frame [m], shape (3,)."""
    return _rest_place(LANDMARKS[mark]) - _rest_place(LANDMARKS[plain_landmark(mark)])


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
    """Positions of landmarks on posed ellipsoids, by NumPy.

    Args:
        names: Names of L landmarks, such as "left_wrist".
        centres: Ellipsoid centres [m], shape (..., 20, 3).
        axes: Ellipsoid axes as columns, shape (..., 20, 3, 3).
        semi_axes: Semi-axes [m], shape (..., 20, 3).

    Returns:
        Positions in the frame of the centres [m], shape (..., L, 3).

    Raises:
        ValueError: If there is no landmark of a name; the message lists all.

    Examples:
        >>> from warp_partdr import EllipBody, landmark_positions
        >>> posed = EllipBody.mean().pose().numpy()
        >>> points = landmark_positions(["nose", "left_wrist"], posed["centres"], posed["axes"], posed["semi_axes"])
        >>> points.shape
        (1, 2, 3)
    """
    parts, normalised, weights = landmark_points(names)
    offsets = np.einsum("...ij,...j->...i", axes[..., parts, :, :], semi_axes[..., parts, :] * normalised)
    return np.einsum("lp,...lpi->...li", weights, centres[..., parts, :] + offsets)
