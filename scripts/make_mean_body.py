"""Measure Anny's default adult and write EllipBody's mean body, ``body/mean_body.json``.

    python scripts/make_mean_body.py

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

Thicknesses are those of best silhouettes (``warp_partdr/lab/silhouettes.py``).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from anny_person import Person, PersonFactory, write_json

from warp_partdr.body.rotations import rotation_from_6d
from warp_partdr.body.template import (
    BONE_STARTS,
    JOINT_NAMES,
    LENGTH_NAMES,
    PART_NAMES,
    SHAPE_INDICES,
    THICKNESS_NAMES,
)
from warp_partdr.lab.silhouettes import PART_GROUPS, TORSO, VIEWS, Silhouettes, fit_thicknesses, mask_iou

MEAN_BODY = Path(__file__).resolve().parents[1] / "body" / "mean_body.json"


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
        "measured by scripts/make_mean_body.py",
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
        whole = silhouettes.person_mask(everything, view)
        print(f"IoU whole {view}: {mask_iou(silhouettes.masks(everything, thicknesses, view), whole):.3f}")


if __name__ == "__main__":
    main()
