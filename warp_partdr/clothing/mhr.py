"""MHR (Momentum Human Rig, Apache-2.0), which SAM 3D Body gives out, as a detailed model; needs the extra ``bodies``.

Read by the package ``body-models`` from a folder of MHR's files. Two things are not MHR's own: its pose correctives, a
small network over all joints, are left out, and the 18 controls that scale head and body, which act by powers of two on
joints, are taken to first order. At rest, all else is exact.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..body.template import PART_NAMES
from ..errors import InputError, cause
from .model import DetailedModel
from .smpl import joint_landmarks, parts_of_faces

_SHAPES = 45  # of identity, of unit variance
# Controls of skeleton and scale are the last of these poses; of hands' there are 50 more, which stay 0.
_SCALES = {"body_pose": 15, "head_pose": 3}
_SCALE_SPREAD = 0.1  # taken for their standard deviation: their own is not in MHR's files
_STEP = 1e-2
# SMPL's name of joints that both have. The spine's are found by the tree.
_JOINTS = {"root": "pelvis", "c_neck": "neck", "c_head": "head"}
for _side, _letter in (("left", "l"), ("right", "r")):
    _pairs = "upleg hip, lowleg knee, foot ankle, ball foot, clavicle collar, uparm shoulder, lowarm elbow, wrist wrist"
    _fingers = "thumb3 thumb3, index1 index1, pinky1 pinky1"
    for _pair in f"{_pairs}, {_fingers}".split(", "):
        _own, _smpl = _pair.split()
        _JOINTS[f"{_letter}_{_own}"] = f"{_side}_{_smpl}"
_CARRIES = {"neck": "neck", "head": "head", "collar": "shoulder", "shoulder": "upper_arm", "elbow": "forearm"}
_CARRIES |= {"wrist": "hand", "hip": "upper_leg", "knee": "lower_leg", "ankle": "foot"}


def mhr_model(
    folder: str | Path, *, device: torch.device | str = "cpu", dtype: torch.dtype = torch.float32
) -> DetailedModel:
    """MHR from the folder of its files: ``mhr_model.pt``, ``corrective_activation.npz`` and so on; none is unpickled.

    63 shape values: 45 of identity, which leave the joints, and 18 of skeleton and scale, of body and head.

    Raises:
        InputError: If the package is missing, or a file is missing or damaged, or no MHR.
    """
    try:
        from body_models import create_model
    except ImportError as error:
        raise InputError(f"{folder}: MHR needs the extra 'bodies': pip install warp-partdr[bodies]") from error
    try:
        rig: Any = create_model("mhr", model_path=Path(folder), runtime="numpy")
        return _detailed(rig, device, dtype)
    except InputError:
        raise
    except Exception as error:  # of many kinds: the package's readers have no one for a damaged file
        raise InputError(f"{folder}: {cause(error)}; expected a folder of MHR's files") from error


def _detailed(rig: Any, device: torch.device | str, dtype: torch.dtype) -> DetailedModel:
    rest = {name: np.asarray(value, dtype=np.float64) for name, value in rig.get_rest_pose().items()}

    def shown(**changes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Vertices and joints but ``body_world``, which is no joint of the body."""
        values = rest | changes
        transforms = np.asarray(rig.forward_skeleton(**values), dtype=np.float64)
        return np.asarray(rig.forward_vertices(**values), dtype=np.float64), transforms[1:, :3, 3]

    def slope(name: str, place: int) -> tuple[np.ndarray, np.ndarray]:
        step = np.zeros_like(rest[name])
        step[place] = _STEP
        (high, far), (low, near) = (shown(**{name: rest[name] + sign * step}) for sign in (1, -1))
        return (high - low) / (2 * _STEP), (far - near) / (2 * _STEP)

    vertices, joints = shown()
    units = np.eye(_SHAPES)
    # Identity is linear, and leaves the joints.
    moves = [(shown(shape=unit)[0] - vertices, np.zeros_like(joints)) for unit in units]
    for name, count in _SCALES.items():
        first = len(rest[name]) - count
        slopes = (slope(name, place) for place in range(first, first + count))
        moves += [(_SCALE_SPREAD * points, _SCALE_SPREAD * ends) for points, ends in slopes]
    own = list(rig.joint_names)[1:]
    parents = [parent - 1 for parent in list(rig.parents)[1:]]
    if missing := [name for name in ("root", "c_neck", "c_head", "l_uparm", "r_upleg") if name not in own]:
        raise InputError(f"MHR: no joint {missing[0]}; expected those of MHR")
    names = _smpl_names(own, parents)
    parts, part_joints = _parts(names, parents)
    weights = np.asarray(rig.skin_weights, dtype=np.float64)
    weights = np.column_stack([weights[:, 0] + weights[:, 1], weights[:, 2:]])
    faces = np.asarray(rig.faces)
    vertex_parts = parts[weights.argmax(1)]
    left, right = (PART_NAMES.index(f"{side}_hip") for side in ("left", "right"))
    of_pelvis = vertex_parts < 0
    vertex_parts[of_pelvis] = np.where(vertices[of_pelvis, 0] > 0, left, right)
    landmarks = joint_landmarks(names, vertices, joints, vertex_parts)

    def numbers(values: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(np.ascontiguousarray(values)).to(device, dtype)

    return DetailedModel(
        name="mhr",
        joint_names=tuple(own),
        parents=tuple(parents),
        part_joints=part_joints,
        landmark_names=tuple(landmarks),
        faces=torch.from_numpy(faces.astype(np.int32)).to(device),
        face_parts=torch.from_numpy((parts_of_faces(faces, vertex_parts) + 1).astype(np.uint8)).to(device),
        rest_vertices=numbers(vertices),
        shape_directions=numbers(np.stack([points for points, _ in moves])),
        rest_joints=numbers(joints),
        joint_directions=numbers(np.stack([ends for _, ends in moves])),
        skin_weights=numbers(weights / weights.sum(1, keepdims=True)),
        landmark_weights=numbers(np.stack(list(landmarks.values()))),
    )


def _smpl_names(own: list[str], parents: list[int]) -> list[str]:
    """Joints by SMPL's names where it has them, the spine's by the tree, others by their own."""
    names = [_JOINTS.get(name, name) for name in own]
    spine: list[int] = []
    joint = parents[names.index("neck")]
    while parents[joint] >= 0:
        spine.insert(0, joint)
        joint = parents[joint]
    for place, joint in enumerate(spine):  # spine1 is the abdomen's; the middle one is the landmark
        names[joint] = f"spine{1 + place}"
    return names


def _parts(names: list[str], parents: list[int]) -> tuple[np.ndarray, tuple[int, ...]]:
    """Part of each joint's skin, -1 for the pelvis', and the joint that carries each part."""
    spine = [name for name in names if name.startswith("spine")]
    carried = {"pelvis": -1} | {
        name: PART_NAMES.index("abdomen" if 2 * place < len(spine) else "chest") for place, name in enumerate(spine)
    }
    for name in names:
        side, _, joint = name.partition("_")
        part = _CARRIES.get(joint or side)
        if part is not None:
            carried[name] = PART_NAMES.index(f"{side}_{part}" if joint else part)
    parts: list[int] = []
    for name, parent in zip(names, parents, strict=True):
        parts.append(carried.get(name, parts[parent] if parent >= 0 else -1))
    return np.array(parts), tuple(0 if name.endswith("_hip") else parts.index(k) for k, name in enumerate(PART_NAMES))
