"""Template of EllipBody: its 20 ellipsoids, their tree, and the shape values that they share.

Every name, order and index of the model is defined here and nowhere else (paper, section 3.3 and table 1;
the pelvis is two ellipsoids, left and right hip). Label k of a part image is ``PART_NAMES[k - 1]``; 0 is background.

Body frame: x to the person's left, y up, z forward; metres. In the rest pose the body stands upright, legs down,
arms out to the sides (T-pose), palms down.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources

import numpy as np

PART_NAMES: tuple[str, ...] = (
    "left_hip",
    "right_hip",
    "abdomen",
    "chest",
    "neck",
    "left_shoulder",
    "right_shoulder",
    "head",
    "left_upper_leg",
    "right_upper_leg",
    "left_lower_leg",
    "right_lower_leg",
    "left_foot",
    "right_foot",
    "left_upper_arm",
    "right_upper_arm",
    "left_forearm",
    "right_forearm",
    "left_hand",
    "right_hand",
)
NUM_PARTS = len(PART_NAMES)

MEAN_STATURE = 1.63  # [m], of the mean adult of mean_body.json

# Joint 0 is the root; joint k + 1 is the end of bone k. A bone starts where its parent ends.
JOINT_NAMES: tuple[str, ...] = (
    "pelvis",
    "left_hip",
    "right_hip",
    "spine",
    "neck",
    "head",
    "left_shoulder",
    "right_shoulder",
    "head_top",
    "left_knee",
    "right_knee",
    "left_ankle",
    "right_ankle",
    "left_toe",
    "right_toe",
    "left_elbow",
    "right_elbow",
    "left_wrist",
    "right_wrist",
    "left_fingertip",
    "right_fingertip",
)
NUM_JOINTS = len(JOINT_NAMES)

# Parent bone of each bone; -1 is the root.
PARENTS: tuple[int, ...] = (-1, -1, -1, 2, 3, 3, 3, 4, 0, 1, 8, 9, 10, 11, 5, 6, 14, 15, 16, 17)

LENGTH_NAMES: tuple[str, ...] = (
    "hip",
    "abdomen",
    "chest",
    "neck",
    "shoulder",
    "head",
    "upper leg",
    "lower leg",
    "foot",
    "upper arm",
    "forearm",
    "hand",
)
THICKNESS_NAMES: tuple[str, ...] = (
    "torso depth",
    "pelvis height",
    "abdomen width",
    "chest width",
    "neck thickness",
    "shoulder thickness",
    "head thickness",
    "upper leg thickness",
    "lower leg thickness",
    "foot width",
    "foot height",
    "upper arm thickness",
    "forearm thickness",
    "hand width",
    "hand thickness",
)

# Per part: (length, first thickness, second thickness), indices into the two tuples above (paper, table 1).
SHAPE_INDICES: tuple[tuple[int, int, int], ...] = (
    (0, 0, 1),
    (0, 0, 1),
    (1, 0, 2),
    (2, 0, 3),
    (3, 4, 4),
    (4, 5, 5),
    (4, 5, 5),
    (5, 6, 6),
    (6, 7, 7),
    (6, 7, 7),
    (7, 8, 8),
    (7, 8, 8),
    (8, 9, 10),
    (8, 9, 10),
    (9, 11, 11),
    (9, 11, 11),
    (10, 12, 12),
    (10, 12, 12),
    (11, 13, 14),
    (11, 13, 14),
)

# Body direction that the first thickness axis of a part follows in the rest pose, as near as the bone allows:
# depth (z) everywhere but the feet, whose first thickness is their width (x).
_FEET = (12, 13)
_FIRST_THICKNESS_AXIS = np.array([(1.0, 0.0, 0.0) if k in _FEET else (0.0, 0.0, 1.0) for k in range(NUM_PARTS)])

# Bones whose local rotation stays at identity unless a user frees it: the hips are the pelvis.
LOCKED_PARTS: tuple[int, ...] = (0, 1)


@dataclass(frozen=True)
class Template:
    """Constant numbers of EllipBody, float64 on the host.

    Attributes:
        rest_directions: Unit direction O of each bone in the rest pose, body frame, shape (20, 3).
        rest_axes: Ellipsoid axes in the rest pose as columns (bone, first thickness, second thickness), right-handed,
            shape (20, 3, 3).
        mean_lengths: Mean adult lengths [m], shape (12,).
        mean_thicknesses: Mean adult thicknesses [m], full widths, shape (15,).
        source: Source of the mean shape.
    """

    rest_directions: np.ndarray
    rest_axes: np.ndarray
    mean_lengths: np.ndarray
    mean_thicknesses: np.ndarray
    source: str


@lru_cache(maxsize=1)
def template() -> Template:
    """Template with the mean shape of ``mean_body.json`` (made by ``scripts/measure_mean_body.py``)."""
    data = json.loads(resources.files(__package__).joinpath("mean_body.json").read_text())
    directions = np.array([data["rest_directions"][name] for name in PART_NAMES], dtype=np.float64)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    first = _FIRST_THICKNESS_AXIS - (_FIRST_THICKNESS_AXIS * directions).sum(1, keepdims=True) * directions
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    axes = np.stack([directions, first, np.cross(directions, first)], axis=-1)
    return Template(
        rest_directions=directions,
        rest_axes=axes,
        mean_lengths=np.array([data["lengths_m"][name] for name in LENGTH_NAMES]),
        mean_thicknesses=np.array([data["thicknesses_m"][name] for name in THICKNESS_NAMES]),
        source=data["source"],
    )
