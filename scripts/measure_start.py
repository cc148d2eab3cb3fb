"""Measure and print by how much part labels improve a body that another method found.

    python scripts/measure_start.py [FIRST] [LAST]

PartBench's people FIRST to LAST, 300 to 339 unless told, which nothing was chosen on, level "realistic". Their true
bodies are made as wrong as a method is that has a PA-MPJPE of 36 or 55 mm (on 3DPW): all joints turned, a shape beside
the true one, the pelvis elsewhere by 1 % of the person's height in the picture, the distance 5 % off. "depth": axes of
the turns lie in the picture's plane, so that limbs are wrong along the view most; "any": axes of any direction. Mean
PA-MPJPE, and the mean change, with intervals (95 %). "alone" is the mesh stage from our own network's start.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np
import torch
import warp as wp

from warp_partdr import FitOptions, fit_body
from warp_partdr.body.rotations import rotation_from_axis_angle
from warp_partdr.body.skeletons import MPJPE_JOINTS
from warp_partdr.cameras import Camera, Perspective
from warp_partdr.lab.evaluation.partbench.samples import make_sample
from warp_partdr.lab.synthetic import people
from warp_partdr.lab.synthetic.partbench_people import _PITCH, draw_shape, make_person, pose_kind
from warp_partdr.lab.synthetic.pose_recipes import draw_pose
from warp_partdr.lab.synthetic.poses import mean_body
from warp_partdr.metrics import bootstrap_sum, pa_mpjpe
from warp_partdr.models.anny import anny
from warp_partdr.models.joint_turns import turn_joints
from warp_partdr.models.pose import free_joints, pose_from_ellipbody
from warp_partdr.models.registration import Registered, ungrown
from warp_partdr.solve.mesh.given_start import refine_given
from warp_partdr.solve.mesh.mesh_stage import refine_mesh

LEVELS = (36.0, 55.0)  # [mm], PA-MPJPE of starts
KINDS = ("depth", "any")
SHAPE, PELVIS, DISTANCE = 0.5, 0.01, 0.05  # spreads of a start's shape values, place (of the height) and distance
_HALVINGS = 30


@dataclass(frozen=True)
class Truth:
    """A true body before its camera."""

    body: Registered
    camera: Camera
    joints: np.ndarray
    height: float  # [px]


def true_body(index: int) -> Truth:
    """Person ``index`` as ``make_person`` draws it."""
    person, model = make_person(index), anny()
    shape, rng = draw_shape(index)
    pose = draw_pose(pose_kind(index), rng)
    values = (pose.up, pose.yaw, np.radians(rng.uniform(*_PITCH)), 0.0)
    up, yaw, pitch, roll = (torch.tensor(value, dtype=torch.float64)[None] for value in values)
    rotations = rotation_from_axis_angle(torch.from_numpy(pose.rotations)[None].float())
    posed = mean_body(rotations, people.seen_by_camera(people.upright(up, yaw), pitch, roll).float())
    body = ungrown(model, shape, *pose_from_ellipbody(model, posed, shape), {})
    vertices = torch.from_numpy(person.vertices)
    body = body.moved((vertices - body.detailed.vertices[0]).mean(0, keepdim=True))
    assert (body.detailed.vertices[0] - vertices).abs().max() < 1e-4
    return Truth(body, person.camera, person.joints, person.height)


def error(body: Registered, joints: np.ndarray) -> float:
    """PA-MPJPE [mm]."""
    found = body.model.landmarks(body.detailed, MPJPE_JOINTS)[0].numpy()
    return 1000 * float(pa_mpjpe(found, joints))


def wrong_body(truth: Truth, level: float, kind: str, seed: int) -> Registered:
    """A body whose PA-MPJPE is ``level`` [mm], wrong in the same way at every level."""
    model, body, rng = truth.body.model, truth.body, np.random.default_rng([seed, KINDS.index(kind)])
    free = torch.tensor(free_joints(model))
    axes = rng.normal(size=(len(free), 3))
    if kind == "depth":
        axes[:, 2] = 0.0
    world = body.detailed.transforms[0, free, :3, :3]
    turns = (world.mT @ torch.from_numpy(axes).float()[..., None])[None, ..., 0]
    shape = body.shape + SHAPE * torch.from_numpy(rng.normal(size=body.shape.shape)).float()
    aside, far = rng.normal(size=2), np.exp(DISTANCE * rng.normal())

    def turned(share: float) -> Registered:
        rotations = turn_joints(body.rotations, free, share * turns)
        return ungrown(model, shape, rotations, body.translation, {})

    low, high = 0.0, 1.5
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if error(turned(middle), truth.joints) < level else (low, middle)
    start, focal = turned(low), float(truth.camera.intrinsics[0, 0])
    depth = float(body.translation[0, 2]) if isinstance(truth.camera, Perspective) else 1.0
    move = torch.zeros(1, 3)
    move[0, :2] = torch.from_numpy(aside * PELVIS * truth.height * depth / focal)
    if isinstance(truth.camera, Perspective):
        move = move + (far - 1) * body.translation
    return start.moved(move)


def main(first: str = "300", last: str = "339") -> None:
    wp.config.log_level = wp.LOG_WARNING
    before: dict[str, list[float]] = {}
    after: dict[str, list[float]] = {}
    for index in range(int(first), int(last) + 1):
        truth, sample = true_body(index), make_sample(index, "realistic")
        assert sample.parts is not None
        own = fit_body(sample.keypoints, sample.parts, others=sample.others, options=FitOptions.at("fast"))
        after.setdefault("alone", []).append(error(refine_mesh(own).body, truth.joints))
        for kind in KINDS:
            for level in LEVELS:
                start = wrong_body(truth, level, kind, index)
                for seen, keypoints in (("labels", None), ("labels and keypoints", sample.keypoints)):
                    fit = refine_given(start, truth.camera, sample.parts, keypoints, others=sample.others)
                    name = f"{kind}, {level:.0f} mm, {seen}"
                    before.setdefault(name, []).append(error(start, truth.joints))
                    after.setdefault(name, []).append(error(fit.body, truth.joints))
    for name, errors in after.items():
        print(f"{name:40s} {mean(errors)}", end="")
        if name in before:
            changes = np.array(errors) - np.array(before[name])
            print(f", from {np.mean(before[name]):.1f}: {mean(changes)}, {(changes < 0).mean():.0%} better", end="")
        print(f", {len(errors)} people")


def mean(values: list[float] | np.ndarray) -> str:
    """The mean and its interval."""
    low, high = bootstrap_sum(np.asarray(values), lambda sums: sums / len(values))
    return f"{np.mean(values):.1f} ({low:.1f} to {high:.1f}) mm"


if __name__ == "__main__":
    main(*sys.argv[1:])
