"""Skeletons: which landmarks the keypoint formats hold, in the formats' own order.

Left and right are the person's own. Where a format has no exact counterpart, the landmark nearest to what its
annotators meant stands in:

* "neck" is the point between the shoulders: OpenPose's Neck, LSP's neck, MPII's thorax, Human3.6M's Thorax (its joint
  13); "head" is the base of the skull: MPII's upper neck, Human3.6M's Neck/Nose (its joint 14, where the head turns);
* "mid_hip" is the middle of the hips: OpenPose's MidHip, MPII's pelvis, Human3.6M's Hip.

COCO's annotators marked what they saw, and OpenPose's BODY_25 learned from them; these two have ``marks`` nearer the
skin than joints. Human3.6M's and BlazePose's joints are centres; of LSP's and MPII's nothing is known here.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from .landmarks import LANDMARKS, annotated, mirror_order

_ANNOTATED_FORMATS = ("coco17", "body25")


@dataclass(frozen=True)
class Skeleton:
    """Keypoint format: its joints, as landmarks, and the edges between them.

    Attributes:
        name: Its name here, such as "coco17".
        landmarks: Landmark of each of its J joints, in the format's order.
        edges: Pairs of joint indices to draw.
    """

    name: str
    landmarks: tuple[str, ...]
    edges: tuple[tuple[int, int], ...]

    @cached_property
    def marks(self) -> tuple[str, ...]:
        """Point of the body (``LANDMARKS``) that each joint marks, in the same order."""
        return annotated(self.landmarks) if self.name in _ANNOTATED_FORMATS else self.landmarks

    @cached_property
    def mirror(self) -> np.ndarray:
        """Joint that each joint becomes in a mirrored picture, shape (J,), int64."""
        return mirror_order(self.landmarks)

    def __len__(self) -> int:
        """J, the number of joints."""
        return len(self.landmarks)


def _skeleton(name: str, landmarks: str, edges: str) -> Skeleton:
    """Build a skeleton from words: landmarks, and chains ``a-b-c``, where ``*`` means left and, once more, right."""
    order = tuple(landmarks.split())
    if unknown := set(order) - set(LANDMARKS):
        raise ValueError(f"{name}: no landmarks {sorted(unknown)}")
    pairs: dict[tuple[int, int], None] = {}
    for chain in edges.split():
        for side in ("left", "right") if "*" in chain else ("",):
            joints = [order.index(word.replace("*", side)) for word in chain.split("-")]
            pairs.update(dict.fromkeys(pairwise(joints)))
    return Skeleton(name, order, tuple(pairs))


_ARMS_AND_LEGS = "*_shoulder-*_elbow-*_wrist *_hip-*_knee-*_ankle"
_BOX = "left_shoulder-right_shoulder left_hip-right_hip *_shoulder-*_hip"
_FEET = "*_ankle-*_heel *_ankle-*_big_toe-*_small_toe"

SKELETONS: dict[str, Skeleton] = {
    skeleton.name: skeleton
    for skeleton in (
        _skeleton(
            "coco17",
            "nose left_eye right_eye left_ear right_ear left_shoulder right_shoulder left_elbow right_elbow left_wrist "
            "right_wrist left_hip right_hip left_knee right_knee left_ankle right_ankle",
            f"nose-*_eye-*_ear-*_shoulder {_BOX} {_ARMS_AND_LEGS}",
        ),
        _skeleton(
            "body25",
            "nose neck right_shoulder right_elbow right_wrist left_shoulder left_elbow left_wrist mid_hip right_hip "
            "right_knee right_ankle left_hip left_knee left_ankle right_eye left_eye right_ear left_ear left_big_toe "
            "left_small_toe left_heel right_big_toe right_small_toe right_heel",
            f"mid_hip-neck-nose nose-*_eye-*_ear neck-*_shoulder mid_hip-*_hip {_ARMS_AND_LEGS} {_FEET}",
        ),
        _skeleton(
            "blazepose33",
            "nose left_eye_inner left_eye left_eye_outer right_eye_inner right_eye right_eye_outer left_ear right_ear "
            "mouth_left mouth_right left_shoulder right_shoulder left_elbow right_elbow left_wrist right_wrist "
            "left_pinky right_pinky left_index right_index left_thumb right_thumb left_hip right_hip left_knee "
            "right_knee left_ankle right_ankle left_heel right_heel left_foot_index right_foot_index",
            f"nose-*_eye_inner-*_eye-*_eye_outer-*_ear mouth_left-mouth_right {_BOX} {_ARMS_AND_LEGS} "
            "*_wrist-*_thumb *_wrist-*_index-*_pinky-*_wrist *_ankle-*_heel-*_foot_index-*_ankle",
        ),
        _skeleton(
            "h36m17",
            "mid_hip right_hip right_knee right_ankle left_hip left_knee left_ankle spine neck head head_top "
            "left_shoulder left_elbow left_wrist right_shoulder right_elbow right_wrist",
            f"mid_hip-spine-neck-head-head_top neck-*_shoulder mid_hip-*_hip {_ARMS_AND_LEGS}",
        ),
        _skeleton(
            "lsp14",
            "right_ankle right_knee right_hip left_hip left_knee left_ankle right_wrist right_elbow right_shoulder "
            "left_shoulder left_elbow left_wrist neck head_top",
            f"neck-head_top neck-*_shoulder *_shoulder-*_hip left_hip-right_hip {_ARMS_AND_LEGS}",
        ),
        _skeleton(
            "mpii16",
            "right_ankle right_knee right_hip left_hip left_knee left_ankle mid_hip neck head head_top right_wrist "
            "right_elbow right_shoulder left_shoulder left_elbow left_wrist",
            f"mid_hip-neck-head-head_top neck-*_shoulder mid_hip-*_hip {_ARMS_AND_LEGS}",
        ),
    )
}

# The joints that MPJPE and PA-MPJPE are computed over, and the two whose middle they are measured from.
MPJPE_SKELETON = "lsp14"
MPJPE_JOINTS = SKELETONS[MPJPE_SKELETON].landmarks
MPJPE_HIPS = [MPJPE_JOINTS.index(name) for name in ("left_hip", "right_hip")]


def skeleton(name: str) -> Skeleton:
    """Keypoint format called ``name``.

    Raises:
        ValueError: If there is none.
    """
    if name not in SKELETONS:
        raise ValueError(f"skeleton: {name!r}; expected one of {', '.join(SKELETONS)}")
    return SKELETONS[name]
