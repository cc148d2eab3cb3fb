"""Rigs of the package ``body-models`` as detailed models: MHR and SOMA; needs the extra ``bodies``.

A rig is asked for its body at rest and for the changes of that body; pose correctives, which rigs work out from all
joints, are left out. At rest, a body is the rig's own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..body.template import PART_NAMES
from ..errors import InputError, cause, install_command
from .model import DetailedModel
from .skin import RiggedSkin, skinned_model
from .smpl import joint_landmarks

_STEP = 1e-2
_CARRIES = {"neck": "neck", "head": "head", "collar": "shoulder", "shoulder": "upper_arm", "elbow": "forearm"}
_CARRIES |= {"wrist": "hand", "hip": "upper_leg", "knee": "lower_leg", "ankle": "foot"}

Body = tuple[np.ndarray, np.ndarray]  # vertices and joints, or their changes [m]


def named_joints(middle: Mapping[str, str], limbs: str, sides: Mapping[str, str]) -> dict[str, str]:
    """SMPL's name of each of a rig's joints.

    Args:
        middle: SMPL's name of each joint in the middle of the body, by the rig's name.
        limbs: Names of the other joints without their sides, in pairs of the rig and SMPL: "upleg hip, lowleg knee".
        sides: Prefix of the rig's joint names for "left" and for "right".
    """
    pairs = [pair.split() for pair in limbs.split(", ")]
    return {**middle, **{f"{sides[side]}{own}": f"{side}_{smpl}" for side in sides for own, smpl in pairs}}


@dataclass(frozen=True)
class Rig:
    """A rig of the package, and the first of its joints that is one of the body."""

    own: Any
    first: int = 0

    def rest(self) -> dict[str, np.ndarray]:
        """Values at rest, by name."""
        return {name: np.asarray(value, dtype=np.float64) for name, value in self.own.get_rest_pose().items()}

    def shown(self, **changes: np.ndarray) -> Body:
        """Vertices and joints at rest but for ``changes``."""
        values = self.rest() | changes
        transforms = np.asarray(self.own.forward_skeleton(**values), dtype=np.float64)
        return np.asarray(self.own.forward_vertices(**values), dtype=np.float64), transforms[self.first :, :3, 3]

    def slope(self, name: str, index: int) -> Body:
        """Change by a unit of a value, to first order."""
        step = np.zeros_like(self.rest()[name])
        step[index] = _STEP
        (high, far), (low, near) = (self.shown(**{name: self.rest()[name] + sign * step}) for sign in (1, -1))
        return (high - low) / (2 * _STEP), (far - near) / (2 * _STEP)


def read_rig(kind: str, folder: str | Path, build: Callable[[Any], DetailedModel]) -> DetailedModel:
    """Model that ``build`` makes of the package's rig, read from the folder of its files.

    Raises:
        InputError: If the package is missing, or a file is missing or damaged, or of no such rig.
    """
    shown = kind.upper()
    try:
        from body_models import create_model
    except ImportError as error:
        raise InputError(f"{folder}: {shown} needs body-models: {install_command('bodies')}") from error
    try:
        return build(create_model(kind, model_path=Path(folder), runtime="numpy"))
    except InputError:
        raise
    except Exception as error:  # of many kinds: the package's readers have no one for a damaged file
        raise InputError(f"{folder}: {cause(error)}; expected a folder of {shown}'s files") from error


def rig_model(
    kind: str,
    rig: Rig,
    names_of_smpl: Mapping[str, str],
    moves: Iterable[Body],
    weights: np.ndarray,
    *,
    device: torch.device | str,
    dtype: torch.dtype,
) -> DetailedModel:
    """Model of a rig.

    Args:
        kind: Name of the model.
        rig: Rig with the mesh and the skeleton.
        names_of_smpl: SMPL's name of joints that both have. Fingers may be missing. Those of the spine are found by the
            tree.
        moves: Changes of the body by each shape value.
        weights: Skin weights of the joints, whose sums are normalised, shape (V, J).
        device: Device of the model.
        dtype: Dtype of the model.

    Raises:
        InputError: If a joint is missing.
    """
    vertices, joints = rig.shown()
    own = list(rig.own.joint_names)[rig.first :]
    parents = [parent - rig.first for parent in list(rig.own.parents)[rig.first :]]
    if missing := [name for name, smpl in names_of_smpl.items() if name not in own and not smpl[-1].isdigit()]:
        raise InputError(f"{kind.upper()}: no joint {missing[0]}; expected those of {kind.upper()}")
    if (sums := weights.sum(1)).min() <= 0:
        raise InputError(f"{kind.upper()}: vertex {int(sums.argmin())} follows no joint; expected skin weights of all")
    points, ends = zip(*moves, strict=True)
    names = _smpl_names([names_of_smpl.get(name, name) for name in own], parents)
    faces, parts = np.asarray(rig.own.faces), _parts(names, parents)
    skin = RiggedSkin(own, parents, faces, vertices, np.stack(points), joints, np.stack(ends), weights, parts)
    landmarks = joint_landmarks(names, vertices, joints, skin.vertex_parts)
    return skinned_model(kind, skin, landmarks, device=device, dtype=dtype)


def _smpl_names(names: list[str], parents: list[int]) -> list[str]:
    """SMPL's names of joints. The spine's joints are found by the tree."""
    names = list(names)
    spine: list[int] = []
    joint = parents[names.index("neck")]
    while parents[joint] >= 0:
        spine.insert(0, joint)
        joint = parents[joint]
    for index, joint in enumerate(spine):  # spine1 is the abdomen's; the middle one is the landmark
        names[joint] = f"spine{1 + index}"
    return names


def _parts(names: list[str], parents: list[int]) -> np.ndarray:
    """Part of each joint's skin, -1 for the pelvis'."""
    spine = [name for name in names if name.startswith("spine")]
    carried = {"pelvis": -1} | {
        name: PART_NAMES.index("abdomen" if 2 * index < len(spine) else "chest") for index, name in enumerate(spine)
    }
    for name in names:
        side, _, joint = name.partition("_")
        part = _CARRIES.get(joint or side)
        if part is not None:
            carried[name] = PART_NAMES.index(f"{side}_{part}" if joint else part)
    parts: list[int] = []
    for name, parent in zip(names, parents, strict=True):
        parts.append(carried.get(name, parts[parent] if parent >= 0 else -1))
    return np.array(parts)
