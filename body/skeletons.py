"""Skeletons: landmarks of the keypoint formats, in the formats' own order.

Left and right are the person's own. Where a format has no exact counterpart, the landmark nearest to what its
annotators meant stands in:

* "neck" is the point between the shoulders: OpenPose's Neck, LSP's neck, MPII's thorax, Human3.6M's Thorax (its joint
  13); "head" is the base of the skull: MPII's upper neck, Human3.6M's Neck/Nose (its joint 14, where the head turns);
* "mid_hip" is the middle of the hips: OpenPose's MidHip, MPII's pelvis, Human3.6M's Hip.

COCO's annotators marked what they saw, OpenPose learned from them, and Halpe and COCO-WholeBody add to them; these have
``marks`` nearer the skin than joints. PoseTrack's, CrowdPose's and AI Challenger's (``aic14``) people were marked in
photos, too, and are taken likewise, and so are CMU Panoptic's, which are triangulated from detections of a network that
learned from COCO. Human3.6M's joints, and those of Shelf and Campus, are ``CONVENTIONS`` of their own. BlazePose's
joints are taken as the body's own. In pictures of synthetic people they lie nearer to COCO's marks, but a fit that
takes them so is no nearer to these people's true joints. Of LSP's and MPII's nothing is known here.

Points of a format that are no landmark, such as a cheek or a fingertip, which bends, are left out: ``places`` tells
where in a file's rows the others are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, shown
from ..files.json_files import read_json
from .landmarks import LANDMARKS, annotated, mirror_name, mirror_order, plain_landmark

_ANNOTATED_FORMATS = (
    *("coco17", "body25", "body25b", "body135", "coco18", "halpe26", "halpe136", "wholebody133"),
    *("posetrack17", "crowdpose14", "aic14", "panoptic19"),
)
# Formats whose joints lie as one of ``CONVENTIONS`` has them.
_CONVENTION_OF = {"h36m17": "h36m", "shelf14": "shelf"}
_FEWEST = 2  # points that tell anything


@dataclass(frozen=True)
class Skeleton:
    """Keypoint format: its joints, as landmarks, and the edges between them.

    Attributes:
        name: Name of the format in this package, such as "coco17".
        landmarks: Landmark of each of its J joints, in the format's order.
        marks: Point of the body (``LANDMARKS``) that each joint marks, in the same order.
        edges: Pairs of joint indices to draw.
        places: Row of each joint among the points of a file; -1 for a joint that such files lack.
        count: Points that a file holds of a person, J or, with those that are no landmark, more.
    """

    name: str
    landmarks: tuple[str, ...]
    marks: tuple[str, ...]
    edges: tuple[tuple[int, int], ...]
    places: tuple[int, ...]
    count: int

    @cached_property
    def mirror(self) -> np.ndarray:
        """Joint that each joint becomes in a mirrored picture, shape (J,), int64."""
        return mirror_order(self.landmarks)

    def __len__(self) -> int:
        """Number of joints, J."""
        return len(self.landmarks)


def _skeleton(name: str, landmarks: str, edges: str, rows: Mapping[int, str] | None = None, count: int = 0) -> Skeleton:
    """Build a skeleton from words: landmarks, and chains ``a-b-c``, where ``*`` means left and, once more, right.

    ``rows`` are landmarks further down in a file of ``count`` points.
    """
    first, rows = landmarks.split(), rows or {}
    order = (*first, *rows.values())
    if unknown := set(order) - set(LANDMARKS):
        raise ValueError(f"{name}: no landmarks {sorted(unknown)}")
    pairs: dict[tuple[int, int], None] = {}
    for chain in edges.split():
        for side in ("left", "right") if "*" in chain else ("",):
            joints = [order.index(word.replace("*", side)) for word in chain.split("-")]
            pairs.update(dict.fromkeys(pairwise(joints)))
    marks = order
    if name in _ANNOTATED_FORMATS:
        marks = annotated(order)
    elif name in _CONVENTION_OF:
        marks = annotated(order, convention=_CONVENTION_OF[name])
    places = (*range(len(first)), *rows)
    return Skeleton(name, order, marks, tuple(pairs), places, count or len(order))


_ARMS_AND_LEGS = "*_shoulder-*_elbow-*_wrist *_hip-*_knee-*_ankle"
_BOX = "left_shoulder-right_shoulder left_hip-right_hip *_shoulder-*_hip"
_FEET = "*_ankle-*_heel *_ankle-*_big_toe-*_small_toe"
_COCO = (
    "nose left_eye right_eye left_ear right_ear left_shoulder right_shoulder left_elbow right_elbow left_wrist "
    "right_wrist left_hip right_hip left_knee right_knee left_ankle right_ankle"
)
_FACE = "nose-*_eye-*_ear-*_shoulder"
_BODY_25B = f"{_COCO} head head_top left_big_toe left_small_toe left_heel right_big_toe right_small_toe right_heel"
_BODY_25B_EDGES = f"head-head_top head-*_shoulder {_FACE} {_BOX} {_ARMS_AND_LEGS} {_FEET}"
_HALPE = f"{_COCO} head_top neck mid_hip left_big_toe right_big_toe left_small_toe right_small_toe left_heel right_heel"
_HALPE_EDGES = f"mid_hip-neck-head_top neck-nose-*_eye-*_ear neck-*_shoulder mid_hip-*_hip {_ARMS_AND_LEGS} {_FEET}"
_NECK_AND_BOX = f"neck-head_top neck-*_shoulder {_BOX} {_ARMS_AND_LEGS}"
# Of COCO-WholeBody's 68 points of a face, from row 23 on, and its 21 of either hand, from rows 91 and 112 on.
_FACE_AND_HANDS = {
    59: "right_eye_outer",
    62: "right_eye_inner",
    65: "left_eye_inner",
    68: "left_eye_outer",
    71: "mouth_right",
    77: "mouth_left",
    94: "left_thumb",
    96: "left_index",
    108: "left_pinky",
    115: "right_thumb",
    117: "right_index",
    129: "right_pinky",
}
_FACE_AND_HANDS_EDGES = "*_wrist-*_thumb *_wrist-*_index-*_pinky-*_wrist mouth_left-mouth_right *_eye_inner-*_eye_outer"

SKELETONS: dict[str, Skeleton] = {
    skeleton.name: skeleton
    for skeleton in (
        _skeleton("coco17", _COCO, f"{_FACE} {_BOX} {_ARMS_AND_LEGS}"),
        _skeleton(
            "body25",
            "nose neck right_shoulder right_elbow right_wrist left_shoulder left_elbow left_wrist mid_hip right_hip "
            "right_knee right_ankle left_hip left_knee left_ankle right_eye left_eye right_ear left_ear left_big_toe "
            "left_small_toe left_heel right_big_toe right_small_toe right_heel",
            f"mid_hip-neck-nose nose-*_eye-*_ear neck-*_shoulder mid_hip-*_hip {_ARMS_AND_LEGS} {_FEET}",
        ),
        _skeleton(
            "coco18",
            "nose neck right_shoulder right_elbow right_wrist left_shoulder left_elbow left_wrist right_hip right_knee "
            "right_ankle left_hip left_knee left_ankle right_eye left_eye right_ear left_ear",
            f"neck-nose-*_eye-*_ear neck-*_shoulder neck-*_hip {_ARMS_AND_LEGS}",
        ),
        _skeleton("body25b", _BODY_25B, _BODY_25B_EDGES),
        # OpenPose's whole bodies: BODY_25B, then 20 points of either hand and 70 of the face.
        _skeleton("body135", _BODY_25B, _BODY_25B_EDGES, count=135),
        _skeleton("halpe26", _HALPE, _HALPE_EDGES),
        _skeleton(
            "halpe136",
            _HALPE,
            f"{_HALPE_EDGES} {_FACE_AND_HANDS_EDGES}",
            rows={row + 3: name for row, name in _FACE_AND_HANDS.items()},
            count=136,
        ),
        _skeleton(
            "wholebody133",
            f"{_COCO} left_big_toe left_small_toe left_heel right_big_toe right_small_toe right_heel",
            f"{_FACE} {_BOX} {_ARMS_AND_LEGS} {_FEET} {_FACE_AND_HANDS_EDGES}",
            rows=_FACE_AND_HANDS,
            count=133,
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
            "panoptic19",
            "neck nose mid_hip left_shoulder left_elbow left_wrist left_hip left_knee left_ankle right_shoulder "
            "right_elbow right_wrist right_hip right_knee right_ankle left_eye left_ear right_eye right_ear",
            f"mid_hip-neck-nose nose-*_eye-*_ear neck-*_shoulder mid_hip-*_hip {_ARMS_AND_LEGS}",
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
        _skeleton(
            "crowdpose14",
            "left_shoulder right_shoulder left_elbow right_elbow left_wrist right_wrist left_hip right_hip left_knee "
            "right_knee left_ankle right_ankle head_top neck",
            _NECK_AND_BOX,
        ),
        _skeleton(
            "aic14",
            "right_shoulder right_elbow right_wrist left_shoulder left_elbow left_wrist right_hip right_knee "
            "right_ankle left_hip left_knee left_ankle head_top neck",
            _NECK_AND_BOX,
        ),
        _skeleton(
            "posetrack17",
            "nose neck head_top left_ear right_ear left_shoulder right_shoulder left_elbow right_elbow left_wrist "
            "right_wrist left_hip right_hip left_knee right_knee left_ankle right_ankle",
            f"neck-nose-head_top nose-*_ear neck-*_shoulder {_BOX} {_ARMS_AND_LEGS}",
        ),
        # Shelf's and Campus's, in the order of LSP's.
        _skeleton(
            "shelf14",
            "right_ankle right_knee right_hip left_hip left_knee left_ankle right_wrist right_elbow right_shoulder "
            "left_shoulder left_elbow left_wrist neck head_top",
            f"neck-head_top neck-*_shoulder *_shoulder-*_hip left_hip-right_hip {_ARMS_AND_LEGS}",
        ),
    )
}

# Keypoints at joints of the trunk and the limbs. A face has too many of them, close together, to tell how well a body
# was fitted.
BODY_LANDMARKS = tuple(
    f"{side}_{name}" for side in ("left", "right") for name in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
)

# The joints that MPJPE and PA-MPJPE are computed over, and the two whose middle they are measured from.
MPJPE_SKELETON = "lsp14"
MPJPE_JOINTS = SKELETONS[MPJPE_SKELETON].landmarks
MPJPE_HIPS = [MPJPE_JOINTS.index(name) for name in ("left_hip", "right_hip")]


def skeleton(source: str | Path | Skeleton | Mapping[str, Any]) -> Skeleton:
    """Read a keypoint format by name, or one's own from a JSON file or its content.

    Such a file holds ``{"name": "mine", "landmarks": ["nose", null, "left_wrist", ...]}``: for each point, in the order
    of the keypoints, the landmark (``LANDMARKS``) that it marks; null leaves a point out. ``name`` may be missing.

    Raises:
        InputError: If there is no such format or file, or its content does not fit.

    Examples:
        >>> from warp_partdr import skeleton
        >>> skeleton("coco17").landmarks[:3]
        ('nose', 'left_eye', 'right_eye')
        >>> skeleton({"landmarks": ["nose", None, "left_wrist", "right_wrist"]}).landmarks
        ('nose', 'left_wrist', 'right_wrist')
    """
    if isinstance(source, Skeleton):
        return source
    if isinstance(source, Mapping):
        try:
            return _from_json(source, Path("skeleton"))
        except ValueError as error:
            raise InputError(f"skeleton: {error}") from error
    if str(source) in SKELETONS:
        return SKELETONS[str(source)]
    path = Path(source)
    if path.suffix != ".json":
        raise InputError(f"skeleton: {str(source)!r}; expected one of {', '.join(SKELETONS)}, or a JSON file")
    data = read_json(path, "a skeleton in JSON")
    try:
        return _from_json(data, path)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error


def describe_skeleton(form: str | Skeleton) -> str | dict[str, Any]:
    """Describe a format for JSON, so that ``skeleton`` gives its joints again: by its name or its landmarks."""
    own = skeleton(form)
    known = SKELETONS.get(own.name)
    if known is not None and (own.landmarks, own.marks) == (known.landmarks, known.marks):
        return own.name
    return {"name": own.name, "landmarks": list(own.marks)}


def _from_json(data: Any, path: Path) -> Skeleton:
    """Skeleton that a user defines; its edges are those that the project's formats have between the same landmarks."""
    points = data.get("landmarks") if isinstance(data, Mapping) else None
    if not isinstance(points, list):
        raise ValueError('no list of "landmarks"; expected {"landmarks": [name or null, ...]}')
    for row, name in enumerate(points):
        if name is not None and (not isinstance(name, str) or name not in LANDMARKS):
            raise ValueError(f"point {row}: {shown(name)}; expected null or one of {', '.join(LANDMARKS)}")
    places = tuple(row for row, name in enumerate(points) if name is not None)
    marks = tuple(points[row] for row in places)
    landmarks = tuple(map(plain_landmark, marks))
    if len(places) < _FEWEST:
        raise ValueError(f"{len(places)} landmarks; expected {_FEWEST} at least")
    for name in landmarks:
        if landmarks.count(name) > 1:
            raise ValueError(f"{name} twice; expected each landmark once, and null for other points")
        if mirror_name(name) not in landmarks:
            raise ValueError(f"{name} without {mirror_name(name)}; expected both sides")
    name = str(data.get("name", path.stem))
    return Skeleton(name, landmarks, marks, known_edges(landmarks), places, len(points))


def known_edges(landmarks: tuple[str, ...]) -> tuple[tuple[int, int], ...]:
    """Edges that the project's formats have between some landmarks, as pairs of their indices."""
    known = {(form.landmarks[a], form.landmarks[b]) for form in SKELETONS.values() for a, b in form.edges}
    pairs = [(landmarks.index(a), landmarks.index(b)) for a, b in known if {a, b} <= set(landmarks)]
    return tuple(sorted({(min(pair), max(pair)) for pair in pairs}))
