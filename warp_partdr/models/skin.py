"""Detailed models made of a file's numbers: what readers of all formats share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch

from ..body.template import PART_NAMES
from .convention_landmarks import with_conventions
from .model import DetailedModel

# Both are carried by the pelvis; any other part by the first joint that its skin follows.
_HIPS = ("left_hip", "right_hip")


@dataclass(frozen=True)
class RiggedSkin:
    """A mesh and the joints that it follows, float64 on the host, in the body frame [m]; V, F, J, S of the model.

    Attributes:
        joint_names: Names of the J joints.
        parents: Parent of each joint, -1 for the root, the first.
        faces: Vertex indices of each face, shape (F, 3).
        vertices: Vertices for shape 0, shape (V, 3).
        directions: Change of the vertices by a unit of each shape value, shape (S, V, 3).
        joints: Joints for shape 0, shape (J, 3).
        joint_directions: Change of the joints by a unit of each shape value, shape (S, J, 3).
        weights: Skin weights, whose sums are normalised, shape (V, J).
        parts: Part 0 to 19 of the skin that follows each joint, -1 for the pelvis, shape (J,).
    """

    joint_names: Sequence[str]
    parents: Sequence[int]
    faces: np.ndarray
    vertices: np.ndarray
    directions: np.ndarray
    joints: np.ndarray
    joint_directions: np.ndarray
    weights: np.ndarray
    parts: np.ndarray

    @cached_property
    def vertex_parts(self) -> np.ndarray:
        """Part of each vertex, that of the joint it follows most. For the pelvis, it is the hip of its side."""
        found = self.parts[self.weights.argmax(1)]
        of_pelvis = found < 0
        left, right = (PART_NAMES.index(hip) for hip in _HIPS)
        found[of_pelvis] = np.where(self.vertices[of_pelvis, 0] > 0, left, right)
        return found

    @property
    def face_parts(self) -> np.ndarray:
        """Part of each face, shape (F,), which is that of most of its corners."""
        corners = self.vertex_parts[self.faces]
        return np.where(corners[:, 1] == corners[:, 2], corners[:, 1], corners[:, 0])


def skinned_model(
    name: str,
    skin: RiggedSkin,
    landmarks: Mapping[str, np.ndarray],
    *,
    pose_directions: np.ndarray | None = None,
    device: torch.device | str,
    dtype: torch.dtype,
) -> DetailedModel:
    """Make a model.

    Args:
        name: Name of the model.
        skin: Mesh and joints of the model.
        landmarks: Weights of vertices and then joints, shape (V + J,), by name.
        pose_directions: Change of the vertices by rotations, as in ``DetailedModel``, shape (9 (J - 1), 3 V).
        device: Device of the model.
        dtype: Dtype of the model.
    """

    def numbers(values: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(np.ascontiguousarray(values)).to(device, dtype)

    carried = skin.parts.tolist()
    model = DetailedModel(
        name=name,
        joint_names=tuple(skin.joint_names),
        parents=tuple(skin.parents),
        part_joints=tuple(0 if part in _HIPS else carried.index(k) for k, part in enumerate(PART_NAMES)),
        landmark_names=tuple(landmarks),
        faces=torch.from_numpy(skin.faces.astype(np.int32)).to(device),
        face_parts=torch.from_numpy((skin.face_parts + 1).astype(np.uint8)).to(device),
        rest_vertices=numbers(skin.vertices),
        shape_directions=numbers(skin.directions),
        rest_joints=numbers(skin.joints),
        joint_directions=numbers(skin.joint_directions),
        skin_weights=numbers(skin.weights / skin.weights.sum(1, keepdims=True)),
        landmark_weights=numbers(np.stack(list(landmarks.values()))),
        pose_directions=None if pose_directions is None else numbers(pose_directions),
    )
    return with_conventions(model)
