"""SKEL, the skin of SMPL on a skeleton of biomechanics, as a detailed model.

Source: Keller et al., "From Skin to Skeleton: Towards Biomechanically Accurate 3D Digital Humans" (SIGGRAPH Asia 2023).
SKEL's joints turn by 46 angles about axes of their own, and some slide. Here each turns freely, which takes in all that
angles can do, in axes that are the body frame's at rest; what slides does so as far as a turn about another point has
it. ``load.py`` reads the files.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch

from ..errors import InputError
from .model import DetailedModel
from .skin import RiggedSkin, skinned_model
from .smpl import ARRAYS, SMPL_JOINTS, Layout, check_layout, choose_shapes, joint_landmarks, parts_of_joints

# Name in SKEL's files of each of SMPL's arrays, and of SMPL's own regressor, which SKEL keeps.
_CALLED = {
    "v_template": "skin_template_v",
    "shapedirs": "shapedirs",
    "posedirs": "posedirs",
    "J_regressor": "J_regressor_osim",
    "weights": "skin_weights",
    "kintree_table": "osim_kintree_table",
    "f": "skin_template_f",
    "smpl_regressor": "J_regressor",
}
_LAYOUT: Layout = {name: ARRAYS.get(name, ARRAYS["J_regressor"]) for name in _CALLED}
SKEL_ARRAYS = tuple(_CALLED.values())

# SKEL's joints in order, and the name that SMPL has for each or for what is next to it. SKEL's head is the whole
# cervical section, so that it is the neck's; its talus is the ankle.
_LEG = {"femur": "hip", "tibia": "knee", "talus": "ankle", "calcn": "ankle", "toes": "foot"}
_ARM = {"scapula": "collar", "humerus": "shoulder", "ulna": "elbow", "radius": "elbow_turn", "hand": "wrist"}
_SECTIONS = {"lumbar_body": "spine1", "thorax": "spine2", "head": "neck"}


def _sided(limb: Mapping[str, str]) -> dict[str, str]:
    """The joints of both limbs, the right one's first."""
    return {f"{own}_{side[0]}": f"{side}_{name}" for side in ("right", "left") for own, name in limb.items()}


_JOINTS = {"pelvis": "pelvis", **_sided(_LEG), **_SECTIONS, **_sided(_ARM)}
_HEAD = list(_JOINTS).index("head")
# Added behind them: SMPL's head joint, at the base of the skull.
_SKULL = {"skull": "head"}


def check_skel(arrays: Mapping[str, np.ndarray], where: str) -> str:
    """Check a file's ``SKEL_ARRAYS``; returns "skel".

    Raises:
        ValueError: If an array is missing, or has a wrong shape, dtype or value; it begins with ``where``.
    """
    _by_role(arrays, where)
    return "skel"


def skel_model(
    arrays: Mapping[str, np.ndarray],
    where: str,
    *,
    num_shapes: int | None = None,
    device: torch.device | str = "cpu",
    dtype: torch.dtype = torch.float32,
) -> DetailedModel:
    """SKEL from a file's ``SKEL_ARRAYS``; messages begin with ``where``. Arguments are those of ``load_model``.

    At rest, with all rotations at identity, the body is SKEL's, in a T-pose; joints of limbs, skin weights and pose
    correctives (``posedirs``) are SKEL's. What is not:

    - The joints lumbar_body, thorax and head, which SKEL moves along an arc as they turn, lie halfway down their
      sections and stay there: to first order in the angle, that is the same body.
    - Scapulae turn without sliding around the thorax.
    - A 25th joint, skull, splits SKEL's head from its neck. Unturned, the two are SKEL's head.

    Raises:
        ValueError: If ``check_skel`` raises it, or if the file has fewer shape values than asked for.
        InputError: If the body stands in another frame than SMPL's.
    """
    own = _by_role(arrays, where)
    num_shapes = choose_shapes(num_shapes, own["shapedirs"].shape[2])
    vertices, weights, regressor, of_smpl = (
        own[name].astype(np.float64) for name in ("v_template", "weights", "J_regressor", "smpl_regressor")
    )
    parents = [-1, *own["kintree_table"][0, 1:].tolist(), _HEAD]
    names = [*_JOINTS.values(), *_SKULL.values()]

    def joints_of(points: np.ndarray) -> np.ndarray:
        """Joints of vertices (..., V, 3), or their changes, shape (..., 25, 3)."""
        skull = of_smpl[SMPL_JOINTS.index("head")] @ points
        return _lower_sections(np.concatenate([regressor @ points, skull[..., None, :]], axis=-2), parents)

    directions = np.moveaxis(own["shapedirs"][..., :num_shapes].astype(np.float64), 2, 0)
    joints = joints_of(vertices)
    left, right = (joints[names.index(f"{side}_shoulder"), 0] for side in ("left", "right"))
    if left <= right or joints[-1, 1] <= joints[0, 1]:
        raise InputError(f"{where}: stands otherwise; expected SMPL's frame: x to the person's left, y up")
    weights = _split_head(weights, vertices, of_smpl @ vertices)
    moved, parts = joints_of(directions), parts_of_joints(names)
    bones = [*_JOINTS, *_SKULL]
    skin = RiggedSkin(bones, parents, own["f"], vertices, directions, joints, moved, weights, parts)
    landmarks = _landmarks(names, vertices, joints, of_smpl, skin.vertex_parts)
    bends = _correctives(names, own["posedirs"])
    return skinned_model("skel", skin, landmarks, pose_directions=bends, device=device, dtype=dtype)


def find_skel(source: Path) -> Path:
    """The file of SKEL that a path names: itself, or the one ``skel_*.npz`` in a folder.

    Raises:
        InputError: If the folder has none or several.
    """
    if not source.is_dir():
        return source
    found = sorted(source.glob("skel_*.npz"))
    if len(found) != 1:
        has = ", ".join(path.name for path in found) or "none"
        raise InputError(f"{source}: {has}; expected one skel_*.npz, of partdr convert; or name it")
    return found[0]


def _by_role(arrays: Mapping[str, np.ndarray], where: str) -> dict[str, np.ndarray]:
    """A file's arrays by SMPL's names, checked."""
    own = {name: arrays[called] for name, called in _CALLED.items() if called in arrays}
    check_layout(own, where, _LAYOUT, _CALLED)
    joints = len(own["J_regressor"])
    if joints != len(_JOINTS):
        raise ValueError(f"{where}: {_CALLED['kintree_table']}: {joints} joints; expected {len(_JOINTS)}")
    return own


def _lower_sections(joints: np.ndarray, parents: list[int]) -> np.ndarray:
    """Joints (..., J, 3), those of the spine's sections halfway down to their parents'; linear.

    A section of height l whose top turns by a small angle a moves it by l a / 2, along an arc: a turn about its middle.
    """
    turning = joints.copy()
    for name in _SECTIONS:
        joint = list(_JOINTS).index(name)
        turning[..., joint, 1] = (joints[..., joint, 1] + joints[..., parents[joint], 1]) / 2
    return turning


def _split_head(weights: np.ndarray, vertices: np.ndarray, of_smpl: np.ndarray) -> np.ndarray:
    """Skin weights (V, 25): from SMPL's neck joint to its head joint, the skull takes over from SKEL's head."""
    neck, head = (of_smpl[SMPL_JOINTS.index(name)] for name in ("neck", "head"))
    bone = head - neck
    share = np.clip((vertices - neck) @ bone / (bone @ bone), 0, 1)
    whole = weights[:, _HEAD]
    split = np.column_stack([weights, share * whole])
    split[:, _HEAD] = (1 - share) * whole
    return split


def _landmarks(
    names: list[str], vertices: np.ndarray, joints: np.ndarray, of_smpl: np.ndarray, vertex_parts: np.ndarray
) -> dict[str, np.ndarray]:
    """SMPL's landmarks, of SKEL's joints, but of the trunk, where SMPL has other joints, by SMPL's regressor."""
    count = len(vertices)
    points = np.zeros((len(SMPL_JOINTS), count + len(joints)))
    for row, regressor, name in zip(points, of_smpl, SMPL_JOINTS, strict=True):
        if name in names and name not in ("pelvis", *_SECTIONS.values()):
            row[count + names.index(name)] = 1
        else:
            row[:count] = regressor
    rows = joint_landmarks(SMPL_JOINTS, vertices, points @ np.concatenate([vertices, joints]), vertex_parts)
    return {name: np.pad(row[:count], (0, len(joints))) + row[count:] @ points for name, row in rows.items()}


def _correctives(names: list[str], posedirs: np.ndarray) -> np.ndarray:
    """Pose directions, shape (9 (J - 1), 3 V): each of SMPL's by the turn of the joint that SKEL takes for SMPL's."""
    turned = {name: joint for joint, name in enumerate(names)}  # of talus and calcn the latter, as in SKEL
    turned["head"] = turned.pop("neck")
    found = np.zeros((len(names) - 1, 9, posedirs[..., 0].size))
    of_smpl = posedirs.reshape(-1, posedirs.shape[2]).T.reshape(-1, 9, found.shape[2])
    for joint, name in enumerate(SMPL_JOINTS[1:]):
        if name in turned:
            found[turned[name] - 1] = of_smpl[joint]
    return found.reshape(-1, found.shape[2])
