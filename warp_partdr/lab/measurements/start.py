"""Gain of part labels for a body that another method found.

True bodies at the level "realistic" are made as wrong as a method is that has a PA-MPJPE of 36 or 55 mm (on 3DPW): all
joints turned, a shape beside the true one, the pelvis elsewhere by 1 % of the person's height in the picture, the
distance 5 % off. "Depth": axes of the turns lie in the picture's plane, so that limbs are wrong along the view most.
"Any": axes have any direction. Shown are the mean PA-MPJPE and the mean change, with intervals of 95 % over people.
"Alone" is the mesh stage from our own network's start.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch

from ...body.rotations import rotation_from_axis_angle
from ...body.skeletons import MPJPE_JOINTS
from ...cameras import Camera, Perspective
from ...metrics import pa_mpjpe
from ...models.anny import anny
from ...models.joint_turns import turn_joints
from ...models.pose import free_joints, pose_from_ellipbody
from ...models.registration import Registered, ungrown
from ...solve.ellipsoids.fitting import fit_body
from ...solve.ellipsoids.options import FitOptions
from ...solve.mesh.given_start import refine_given
from ...solve.mesh.mesh_stage import refine_mesh
from ..evaluation.partbench.samples import make_sample
from ..options import People, tracked
from ..synthetic import people as synthetic_people
from ..synthetic.partbench_people import _PITCH, draw_shape, make_person, pose_kind
from ..synthetic.pose_recipes import draw_pose
from ..synthetic.poses import mean_body
from ..tables import FigureTable, estimate_mean

_LEVELS = (36.0, 55.0)  # [mm], PA-MPJPE of starts
_KINDS = ("depth", "any")
_SHAPE, _PELVIS, _DISTANCE = 0.5, 0.01, 0.05  # spreads of a start's shape values, place (of the height) and distance
_HALVINGS = 30
_COLUMNS = {
    "start": "",
    "PA-MPJPE [mm]": ".1f",
    "from": ".1f",
    "change": "+.1f",
    "better": ".0%",
}


def measure_start(*, people: People = range(300, 340)) -> Iterator[FigureTable]:
    """Refine wrong bodies by labels, and by labels and keypoints.

    Args:
        people: People to fit; nothing was chosen on the default ones.
    """
    before: dict[str, list[float]] = {}
    after: dict[str, list[float]] = {}
    for index in tracked(people):
        truth, sample = _true_body(index), make_sample(index, "realistic")
        assert sample.parts is not None
        own = fit_body(sample.keypoints, sample.parts, others=sample.others, options=FitOptions.at("fast"))
        after.setdefault("alone", []).append(_aligned_error(refine_mesh(own).body, truth.joints))
        for kind in _KINDS:
            for level in _LEVELS:
                start = _wrong_body(truth, level, kind, index)
                for seen, keypoints in (("labels", None), ("labels and keypoints", sample.keypoints)):
                    fit = refine_given(start, truth.camera, sample.parts, keypoints, others=sample.others)
                    name = f"{kind}, {level:.0f} mm, {seen}"
                    before.setdefault(name, []).append(_aligned_error(start, truth.joints))
                    after.setdefault(name, []).append(_aligned_error(fit.body, truth.joints))
    table = FigureTable(f"{len(people)} people", _COLUMNS)
    for name, errors in after.items():
        if name in before:
            changes = np.array(errors) - np.array(before[name])
            better = float((changes < 0).mean())
            table.add(name, estimate_mean(errors), float(np.mean(before[name])), estimate_mean(changes), better)
        else:
            table.add(name, estimate_mean(errors), None, None, None)
    yield table


@dataclass(frozen=True)
class _Truth:
    """A true body before its camera."""

    body: Registered
    camera: Camera
    joints: np.ndarray
    height: float  # [px]


def _true_body(index: int) -> _Truth:
    """Person ``index`` as ``make_person`` draws it."""
    person, model = make_person(index), anny()
    shape, rng = draw_shape(index)
    pose = draw_pose(pose_kind(index), rng)
    values = (pose.up, pose.yaw, np.radians(rng.uniform(*_PITCH)), 0.0)
    up, yaw, pitch, roll = (torch.tensor(value, dtype=torch.float64)[None] for value in values)
    rotations = rotation_from_axis_angle(torch.from_numpy(pose.rotations)[None].float())
    orientation = synthetic_people.seen_by_camera(synthetic_people.upright(up, yaw), pitch, roll).float()
    posed = mean_body(rotations, orientation)
    body = ungrown(model, shape, *pose_from_ellipbody(model, posed, shape), {})
    vertices = torch.from_numpy(person.vertices)
    body = body.moved((vertices - body.detailed.vertices[0]).mean(0, keepdim=True))
    assert (body.detailed.vertices[0] - vertices).abs().max() < 1e-4
    return _Truth(body, person.camera, person.joints, person.height)


def _aligned_error(body: Registered, joints: np.ndarray) -> float:
    """PA-MPJPE [mm]."""
    found = body.model.landmarks(body.detailed, MPJPE_JOINTS)[0].numpy()
    return 1000 * float(pa_mpjpe(found, joints))


def _wrong_body(truth: _Truth, level: float, kind: str, seed: int) -> Registered:
    """A body whose PA-MPJPE is ``level`` [mm], wrong in the same way at every level."""
    model, body, rng = truth.body.model, truth.body, np.random.default_rng([seed, _KINDS.index(kind)])
    free = torch.tensor(free_joints(model))
    axes = rng.normal(size=(len(free), 3))
    if kind == "depth":
        axes[:, 2] = 0.0
    world = body.detailed.transforms[0, free, :3, :3]
    turns = (world.mT @ torch.from_numpy(axes).float()[..., None])[None, ..., 0]
    shape = body.shape + _SHAPE * torch.from_numpy(rng.normal(size=body.shape.shape)).float()
    aside, far = rng.normal(size=2), np.exp(_DISTANCE * rng.normal())

    def turned(share: float) -> Registered:
        rotations = turn_joints(body.rotations, free, share * turns)
        return ungrown(model, shape, rotations, body.translation, {})

    low, high = 0.0, 1.5
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if _aligned_error(turned(middle), truth.joints) < level else (low, middle)
    start, focal = turned(low), float(truth.camera.intrinsics[0, 0])
    depth = float(body.translation[0, 2]) if isinstance(truth.camera, Perspective) else 1.0
    move = torch.zeros(1, 3)
    move[0, :2] = torch.from_numpy(aside * _PELVIS * truth.height * depth / focal)
    if isinstance(truth.camera, Perspective):
        move = move + (far - 1) * body.translation
    return start.moved(move)
