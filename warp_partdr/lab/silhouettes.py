"""Thicknesses of ellipsoids whose silhouettes match a person's best.

Thicknesses can't be read off a person, because an ellipsoid is pinned at the two ends of its bone. They are those for
which the mean intersection over union of the parts' silhouettes from the front, the side and above is greatest
(coordinate ascent, millimetre steps). Pelvis, abdomen, chest and shoulders count as one part there, the torso: skinning
weights do not say where one ends.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from PIL import Image, ImageDraw

from ..body.template import (
    _FIRST_THICKNESS_AXIS,
    BONE_STARTS,
    JOINT_NAMES,
    LENGTH_NAMES,
    NUM_PARTS,
    PART_NAMES,
    SHAPE_INDICES,
)
from ..models.model import DetailedModel
from .synthetic.people import pose_anny
from .synthetic.poses import mean_body

PIXEL = 0.005  # [m], of the silhouettes
# Rows: picture's right, picture's up, toward the viewer, in the body frame.
VIEWS: dict[str, np.ndarray] = {
    "front": np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]]),
    "side": np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]]),
    "above": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
}
EXTENT = 1.05  # [m], half the width of a silhouette's picture
TORSO = frozenset({"left_hip", "right_hip", "abdomen", "chest", "left_shoulder", "right_shoulder"})


@dataclass(frozen=True)
class Surface:
    """Skin of a person.

    Attributes:
        vertices: Vertices [m], shape (V, 3).
        faces: Vertex indices, shape (F, 3).
        face_parts: Part of each face, 0 to 19, shape (F,).
    """

    vertices: np.ndarray
    faces: np.ndarray
    face_parts: np.ndarray


# The parts whose silhouettes are compared: each of the 20 on its own, but the torso as one.
PART_GROUPS = {
    "torso": [k for k, name in enumerate(PART_NAMES) if name in TORSO],
    **{name: [k] for k, name in enumerate(PART_NAMES) if name not in TORSO},
}


class Silhouettes:
    """Silhouettes of ellipsoids beside a person's, part group by part group and view by view.

    Args:
        surface: Skin of the person in EllipBody's rest pose.
        starts: Position at which each part's bone begins [m], shape (20, 3).
        ends: Position at which each part's bone ends [m], shape (20, 3).
    """

    def __init__(self, surface: Surface, starts: np.ndarray, ends: np.ndarray) -> None:
        self.surface = surface
        self.centres = (starts + ends) / 2
        self.lengths = np.linalg.norm(ends - starts, axis=1)
        directions = (ends - starts) / self.lengths[:, None]
        first = _FIRST_THICKNESS_AXIS - (_FIRST_THICKNESS_AXIS * directions).sum(1, keepdims=True) * directions
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        self.axes = np.stack([directions, first, np.cross(directions, first)], axis=-1)
        self.origin = (surface.vertices.min(0) + surface.vertices.max(0)) / 2
        self.size = int(2 * EXTENT / PIXEL)
        self.targets = {
            (group, view): self.person_mask(parts, view) for group, parts in PART_GROUPS.items() for view in VIEWS
        }

    def to_pixels(self, points: np.ndarray, view: str) -> np.ndarray:
        """Pixel positions (column, row) of points [m], shape (..., 2)."""
        flat = (points - self.origin) @ VIEWS[view][:2].T
        return np.stack([EXTENT + flat[..., 0], EXTENT - flat[..., 1]], axis=-1) / PIXEL

    def person_mask(self, parts: Sequence[int], view: str) -> np.ndarray:
        """Silhouette of some of the person's parts, shape (S, S), bool."""
        surface = self.surface
        corners = surface.vertices[surface.faces[np.isin(surface.face_parts, parts)]]
        picture = Image.new("L", (self.size, self.size))
        draw = ImageDraw.Draw(picture)
        for face in self.to_pixels(corners, view):
            draw.polygon([tuple(corner) for corner in face], fill=1)
        return np.array(picture, dtype=bool)

    def ellipsoid_mask(self, part: int, thicknesses: np.ndarray, view: str) -> np.ndarray:
        """Silhouette of one ellipsoid, thicknesses of shape (15,) [m]."""
        _, t1, t2 = SHAPE_INDICES[part]
        semi_axes = np.array([self.lengths[part], thicknesses[t1], thicknesses[t2]]) / 2
        flat = VIEWS[view][:2] @ self.axes[part] * semi_axes
        dual = flat @ flat.T / PIXEL**2  # The silhouette of an ellipsoid Q is the ellipse of the projected dual.
        grid = np.arange(self.size) + 0.5
        column, row = self.to_pixels(self.centres[part], view)
        dx, dy = grid[None, :] - column, -(grid[:, None] - row)
        inverse = np.linalg.inv(dual)
        return inverse[0, 0] * dx * dx + 2 * inverse[0, 1] * dx * dy + inverse[1, 1] * dy * dy < 1

    def masks(self, parts: Sequence[int], thicknesses: np.ndarray, view: str) -> np.ndarray:
        """Silhouette of some parts' ellipsoids, shape (S, S), bool."""
        return np.logical_or.reduce([self.ellipsoid_mask(part, thicknesses, view) for part in parts])

    def group_iou(self, group: str, thicknesses: np.ndarray) -> np.ndarray:
        """Intersection over union of a part group in each view, shape (3,)."""
        parts = PART_GROUPS[group]
        return np.array([mask_iou(self.masks(parts, thicknesses, v), self.targets[group, v]) for v in VIEWS])


def mask_iou(a: np.ndarray, b: np.ndarray) -> float:
    """Intersection over union of two masks."""
    return float((a & b).sum() / (a | b).sum())


def fit_thicknesses(silhouettes: Silhouettes) -> np.ndarray:
    """The 15 thicknesses [m] of greatest mean IoU, by coordinate ascent."""
    thicknesses = np.array([0.2, 0.2, 0.3, 0.32, 0.12, 0.12, 0.17, 0.16, 0.11, 0.08, 0.08, 0.1, 0.08, 0.09, 0.04])
    groups = {group: parts for group, parts in PART_GROUPS.items() if not group.startswith("right_")}
    users = [[g for g, parts in groups.items() if any(t in SHAPE_INDICES[p][1:] for p in parts)] for t in range(15)]
    for step in (0.016, 0.004, 0.001):
        improved = True
        while improved:
            improved = False
            for t, affected in enumerate(users):
                before = sum(silhouettes.group_iou(g, thicknesses).sum() for g in affected)
                for sign in (1, -1):
                    trial = thicknesses.copy()
                    trial[t] += sign * step
                    if trial[t] > step and sum(silhouettes.group_iou(g, trial).sum() for g in affected) > before:
                        thicknesses, improved = trial, True
                        break
    return thicknesses


def measure_by_silhouettes(model: DetailedModel, shape: torch.Tensor) -> tuple[np.ndarray, np.ndarray]:
    """Measure EllipBody's lengths (12,) and thicknesses (15,) of a person [m], in EllipBody's rest pose.

    Args:
        model: The packaged Anny.
        shape: Shape values of the person, shape (1, S).
    """
    standing = pose_anny(model, shape, mean_body(torch.eye(3).repeat(1, NUM_PARTS, 1, 1)))
    joints = model.landmarks(standing, JOINT_NAMES)[0].double().numpy()
    bones = np.linalg.norm(joints[1:] - joints[BONE_STARTS], axis=1)
    lengths = np.array([bones[[row[0] == i for row in SHAPE_INDICES]].mean() for i in range(len(LENGTH_NAMES))])
    vertices = standing.vertices[0].double().numpy()
    surface = Surface(vertices, model.faces.numpy(), model.face_parts.numpy().astype(int) - 1)
    return lengths, fit_thicknesses(Silhouettes(surface, joints[BONE_STARTS], joints[1:]))
