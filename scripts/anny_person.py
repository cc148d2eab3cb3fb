"""Anny people for the scripts that make assets: vertices, faces, part labels and joints in EllipBody's terms.

Anny (code Apache-2.0, assets CC0) has Z up, faces -Y and has +X on the person's left. Everything that leaves this
file is in the body frame (x left, y up, z forward; metres).
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from warp_partdr.body.rotations import rotation_between
from warp_partdr.body.template import PART_NAMES
from warp_partdr.lab.silhouettes import Surface

# Anny bones -> part, by the bones' names without their side; the first part with a matching prefix wins.
_SIDED_BONES: dict[str, tuple[str, ...]] = {
    "hip": ("pelvis",),
    "upper_leg": ("upperleg",),
    "lower_leg": ("lowerleg",),
    "foot": ("foot", "toe"),
    "shoulder": ("clavicle", "shoulder"),
    "upper_arm": ("upperarm",),
    "forearm": ("lowerarm",),
    "hand": ("wrist", "metacarpal", "finger"),
}
_MIDDLE_BONES: dict[str, str] = {
    **dict.fromkeys(("spine05", "spine04", "spine03"), "abdomen"),
    **dict.fromkeys(("spine02", "spine01"), "chest"),
    **dict.fromkeys(("neck01", "neck02", "neck03"), "neck"),
    "head": "head",
}
# Joints that are heads of Anny bones; {} is the side.
JOINT_BONES: dict[str, str] = {
    "{}_hip": "upperleg01.{}",
    "{}_knee": "lowerleg01.{}",
    "{}_ankle": "foot.{}",
    "{}_shoulder": "upperarm01.{}",
    "{}_elbow": "lowerarm01.{}",
    "{}_wrist": "wrist.{}",
}


def write_json(path: Path, data: dict[str, object]) -> None:
    """JSON with one line a number or point."""
    path.write_text(re.sub(r"\[[^\[\]{}]*\]", lambda m: " ".join(m[0].split()), json.dumps(data, indent=1)) + "\n")


def body_from_anny(points: np.ndarray) -> np.ndarray:
    """Anny's axes to the body frame, shape (..., 3): x stays, y is Anny's z, z is Anny's -y."""
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1)


def part_of_bone(bone: str) -> str | None:
    """Part of an Anny bone; None for the root, whose vertices go to the hip of their side."""
    if bone.startswith("eye"):
        return "head"
    name, dot, side = bone.partition(".")
    if not dot:
        return _MIDDLE_BONES.get(name)
    part = next(part for part, prefixes in _SIDED_BONES.items() if name.startswith(prefixes))
    return f"{'left' if side == 'L' else 'right'}_{part}"


@dataclass(frozen=True)
class Person(Surface):
    """One posed Anny person in the body frame [m]."""

    bones: dict[str, np.ndarray]  # head of each Anny bone, by name
    coco: dict[str, np.ndarray]  # COCO-17 and foot keypoints of Anny's regressor, by name

    def joints(self) -> dict[str, np.ndarray]:
        """EllipBody's joints [m] that are Anny bones: hips, knees, ankles, shoulders, elbows, wrists."""
        return {
            joint.format(side): self.bones[bone.format(side[0].upper())]
            for joint, bone in JOINT_BONES.items()
            for side in ("left", "right")
        }

    def skin(self, *parts: str) -> np.ndarray:
        """Vertices of parts, in order, each once [m], shape (N, 3)."""
        chosen = np.isin(self.face_parts, [PART_NAMES.index(part) for part in parts])
        return self.vertices[np.unique(self.faces[chosen])]


class PersonFactory:
    """Poses Anny people. The model is built once."""

    def __init__(self) -> None:
        import anny  # an extra, which a ``Person`` alone does not need

        self.model = anny.Anny().to(dtype=torch.float32)
        self.keypoints = anny.KeypointsRegressor.coco(self.model)
        self.bones: list[str] = list(self.model.bone_labels)
        self.parents: list[int] = [int(parent) for parent in self.model.bone_parents]
        self.faces = self.model.get_triangular_faces().numpy()

    def __call__(self, turns: dict[str, np.ndarray] | None = None, phenotype: dict[str, float] | None = None) -> Person:
        """Pose a person.

        Args:
            turns: Rotation of an Anny bone from its rest pose (an A-pose), against the world, in body-frame axes, by
                bone name, shape (3, 3) each. A bone without one turns with its parent.
            phenotype: Anny's phenotype values, 0 to 1; what is missing is 0.5.
        """
        turns = turns or {}
        to_anny = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # body frame to Anny's axes
        pose = torch.eye(4).repeat(1, len(self.bones), 1, 1)
        for name, turn in turns.items():
            matrix = to_anny @ self.turn_of_parent(name, turns).T @ turn @ to_anny.T
            pose[0, self.bones.index(name), :3, :3] = torch.from_numpy(matrix).float()
        with torch.no_grad():
            output = self.model(
                pose_parameters=pose,
                phenotype_kwargs={key: torch.tensor([value]) for key, value in (phenotype or {}).items()} or None,
                pose_parameterization="local-ref",
            )
            coco = body_from_anny(self.keypoints(output)[0].double().numpy())
            rest = output["rest_vertices"][0].double().numpy()
            vertices = body_from_anny(output["vertices"][0].double().numpy())
            heads = body_from_anny(output["bone_poses"][0, :, :3, 3].double().numpy())
        return Person(
            vertices=vertices,
            faces=self.faces,
            face_parts=self._face_parts(rest),
            bones=dict(zip(self.bones, heads, strict=True)),
            coco=dict(zip(self.keypoints.labels, coco, strict=True)),
        )

    def turn_of_parent(self, bone: str, turns: dict[str, np.ndarray]) -> np.ndarray:
        """Rotation against the world that a bone inherits, shape (3, 3)."""
        index = self.bones.index(bone)
        while (index := self.parents[index]) >= 0:
            if self.bones[index] in turns:
                return turns[self.bones[index]]
        return np.eye(3)

    def aim(self, rest: Person, turns: dict[str, np.ndarray], bone: str, end: str, direction: np.ndarray) -> None:
        """Add to ``turns`` the least further turn that points a bone (its head to that of ``end``) in a direction."""
        inherited = self.turn_of_parent(bone, turns)
        now = inherited @ (rest.bones[end] - rest.bones[bone])
        turn = rotation_between(*(torch.from_numpy(each / np.linalg.norm(each)) for each in (now, direction)))
        turns[bone] = turn.numpy() @ inherited

    def _face_parts(self, rest_vertices: np.ndarray) -> np.ndarray:
        """Part of each face, shape (F,): the majority of its vertices' dominant bones (a draw: the first vertex)."""
        weights = self.model.vertex_bone_weights.numpy()
        dominant = np.take_along_axis(self.model.vertex_bone_indices.numpy(), weights.argmax(1)[:, None], 1)[:, 0]
        parts = np.array([PART_NAMES.index(p) if (p := part_of_bone(b)) else -1 for b in self.bones])[dominant]
        of_root = parts < 0
        parts[of_root] = np.where(rest_vertices[of_root, 0] > 0, 0, 1)
        corners = parts[self.faces]
        return np.where(corners[:, 1] == corners[:, 2], corners[:, 1], corners[:, 0])
