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

# Of each part: its name, the joints where its bone starts and ends, its length, first and second thickness (table 1).
_PARTS = (
    ("left_hip", "pelvis", "left_hip", "hip", "torso depth", "pelvis height"),
    ("right_hip", "pelvis", "right_hip", "hip", "torso depth", "pelvis height"),
    ("abdomen", "pelvis", "spine", "abdomen", "torso depth", "abdomen width"),
    ("chest", "spine", "neck", "chest", "torso depth", "chest width"),
    ("neck", "neck", "head", "neck", "neck thickness", "neck thickness"),
    ("left_shoulder", "neck", "left_shoulder", "shoulder", "shoulder thickness", "shoulder thickness"),
    ("right_shoulder", "neck", "right_shoulder", "shoulder", "shoulder thickness", "shoulder thickness"),
    ("head", "head", "head_top", "head", "head thickness", "head thickness"),
    ("left_upper_leg", "left_hip", "left_knee", "upper leg", "upper leg thickness", "upper leg thickness"),
    ("right_upper_leg", "right_hip", "right_knee", "upper leg", "upper leg thickness", "upper leg thickness"),
    ("left_lower_leg", "left_knee", "left_ankle", "lower leg", "lower leg thickness", "lower leg thickness"),
    ("right_lower_leg", "right_knee", "right_ankle", "lower leg", "lower leg thickness", "lower leg thickness"),
    ("left_foot", "left_ankle", "left_toe", "foot", "foot width", "foot height"),
    ("right_foot", "right_ankle", "right_toe", "foot", "foot width", "foot height"),
    ("left_upper_arm", "left_shoulder", "left_elbow", "upper arm", "upper arm thickness", "upper arm thickness"),
    ("right_upper_arm", "right_shoulder", "right_elbow", "upper arm", "upper arm thickness", "upper arm thickness"),
    ("left_forearm", "left_elbow", "left_wrist", "forearm", "forearm thickness", "forearm thickness"),
    ("right_forearm", "right_elbow", "right_wrist", "forearm", "forearm thickness", "forearm thickness"),
    ("left_hand", "left_wrist", "left_fingertip", "hand", "hand width", "hand thickness"),
    ("right_hand", "right_wrist", "right_fingertip", "hand", "hand width", "hand thickness"),
)

PART_NAMES: tuple[str, ...] = tuple(row[0] for row in _PARTS)
"""Names of the 20 parts, an ellipsoid and a bone each. Part k has the label k + 1 in a picture, where 0 is background.

Examples:
    >>> from warp_partdr import PART_NAMES
    >>> len(PART_NAMES), PART_NAMES[0], PART_NAMES.index("head")
    (20, 'left_hip', 7)
"""
NUM_PARTS = len(PART_NAMES)

MEAN_STATURE = 1.63  # [m], of the mean adult of mean_body.json

JOINT_NAMES: tuple[str, ...] = ("pelvis", *(row[2] for row in _PARTS))
"""Names of the 21 joints. Joint 0 is the root, and joint k + 1 is the end of bone k, that of part ``PART_NAMES[k]``.

Examples:
    >>> from warp_partdr import JOINT_NAMES, BodyParameters
    >>> joints = BodyParameters.mean(1).posed().joints
    >>> joints[0, JOINT_NAMES.index("left_wrist")].shape
    torch.Size([3])
"""
NUM_JOINTS = len(JOINT_NAMES)

# Parent bone of each bone; -1 is the root.
PARENTS: tuple[int, ...] = tuple(JOINT_NAMES.index(row[1]) - 1 for row in _PARTS)
BONE_STARTS = [parent + 1 for parent in PARENTS]
"""Joint where each of the 20 bones starts, as an index of ``JOINT_NAMES``. Bone k ends at joint k + 1,
and begins where its parent ends.

Examples:
    >>> from warp_partdr import BONE_STARTS, JOINT_NAMES, PART_NAMES
    >>> JOINT_NAMES[BONE_STARTS[PART_NAMES.index("left_forearm")]]
    'left_elbow'
"""

LENGTH_NAMES: tuple[str, ...] = tuple(dict.fromkeys(row[3] for row in _PARTS))
"""Names of the 12 lengths, in the order of ``lengths``. A left and a right limb share one.

Examples:
    >>> from warp_partdr import LENGTH_NAMES, BodyParameters
    >>> lengths = BodyParameters.mean(1).lengths
    >>> f"{lengths[0, LENGTH_NAMES.index('upper leg')]:.2f} m"
    '0.39 m'
"""
THICKNESS_NAMES: tuple[str, ...] = tuple(dict.fromkeys(name for row in _PARTS for name in row[4:]))
"""Names of the 15 thicknesses, which are full widths, in the order of ``thicknesses``.

Examples:
    >>> from warp_partdr import THICKNESS_NAMES, BodyParameters
    >>> thicknesses = BodyParameters.mean(1).thicknesses
    >>> f"{thicknesses[0, THICKNESS_NAMES.index('chest width')]:.2f} m"
    '0.37 m'
"""

# Shape of each argument of ``pose``, without the batch.
BODY_SHAPES: dict[str, tuple[int, ...]] = {
    "global_orient": (3, 3),
    "translation": (3,),
    "rotations": (NUM_PARTS, 3, 3),
    "lengths": (len(LENGTH_NAMES),),
    "thicknesses": (len(THICKNESS_NAMES),),
}

BODY_SIZES = ("lengths", "thicknesses")  # which of these are positive [m]

# Per part: (length, first thickness, second thickness), indices into the two tuples above.
SHAPE_INDICES: tuple[tuple[int, int, int], ...] = tuple(
    (LENGTH_NAMES.index(length), THICKNESS_NAMES.index(first), THICKNESS_NAMES.index(second))
    for *_, length, first, second in _PARTS
)

SIZE_COLUMNS = [
    [length, *(len(LENGTH_NAMES) + index for index in thicknesses)] for length, *thicknesses in SHAPE_INDICES
]
"""Columns of each part's length, first and second thickness in lengths and thicknesses side by side, 20 rows.

Examples:
    >>> import torch
    >>> from warp_partdr import PART_NAMES, SIZE_COLUMNS, BodyParameters
    >>> body = BodyParameters.mean(1)
    >>> sizes = torch.cat([body.lengths, body.thicknesses], dim=1)[:, SIZE_COLUMNS]  # (1, 20, 3) [m]
    >>> torch.allclose(sizes / 2, body.posed().semi_axes)
    True
"""

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
    """Template with the mean shape of ``mean_body.json`` (made by ``scripts/make_mean_body.py``)."""
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


def subtree_masks() -> list[int]:
    """Bit mask of each part's subtree, itself included; the last one is the root's."""
    masks = [1 << part for part in range(NUM_PARTS)] + [0]
    for part in reversed(range(NUM_PARTS)):  # parents come before their children; -1 is the last entry
        masks[PARENTS[part]] |= masks[part]
    return masks
