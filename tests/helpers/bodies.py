"""Bodies in known poses, what is seen of them, and motion capture."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from helpers.quick import QUICK_REGISTRATION
from warp_partdr.body.labels import BACKGROUND, LabelSet, label_set
from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.pose_prior import PosePrior
from warp_partdr.body.posing import LandmarkGather, Posed, pose
from warp_partdr.body.rotations import rotation_from_axis_angle, rotation_to_6d
from warp_partdr.body.skeletons import skeleton
from warp_partdr.body.template import LENGTH_NAMES, NUM_PARTS, PART_NAMES, THICKNESS_NAMES, template
from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.inputs.observation import Observation
from warp_partdr.inputs.part_labels import PartLabels
from warp_partdr.lab.synthetic import mocap, mocap_files
from warp_partdr.lab.synthetic.pose_sampler import PoseBank
from warp_partdr.models.anny import anny
from warp_partdr.models.registration import Registered, register
from warp_partdr.render.ellipsoids import draw_ellipsoids
from warp_partdr.render.mesh import draw_mesh
from warp_partdr.render.part_mesh import ellipbody_mesh
from warp_partdr.solve.ellipsoids.stepper import EnergyFunction, Refined, Refinement


def refine_by_autograd(start: BodyParameters, energy: EnergyFunction, **options: Any) -> Refined:
    """``refine`` without its captured graph."""
    return Refinement(start, energy, **options).run()


PICTURE_SIZE = (200, 160)


def walker(device="cpu") -> BodyParameters:
    """A body in one of the prior's own poses, turned by 40 degrees."""
    prior = PosePrior().to(device)
    mean = BodyParameters.mean(1, device=device)
    turn = rotation_from_axis_angle(torch.tensor([[0.0, 0.7, 0.0]], device=device))
    facing = torch.diag(torch.tensor([1.0, -1.0, -1.0], device=device))
    return replace(
        mean,
        orientation=rotation_to_6d(turn @ facing),
        rotations=prior.exemplars[:1].clone(),
        log_scale=torch.full_like(mean.log_scale, -0.1),
    )


def seen_by(body: BodyParameters, fmt: str = "coco17") -> tuple[Keypoints2D, PartLabels]:
    """Perfect keypoints and 20-part labels of a body in a picture of ``PICTURE_SIZE``."""
    posed, device = body.posed(), body.shift.device
    down = torch.tensor([0.0, 20.0], device=device)
    camera = replace(body.camera(160), translation=body.camera(160).translation + down)
    points = camera.project(LandmarkGather(skeleton(fmt).marks, device)(posed))[0, :, :2].cpu().numpy()
    mesh = ellipbody_mesh(2, device=device)
    labels = draw_mesh(posed.vertices(2), mesh, camera, PICTURE_SIZE).labels[0].cpu().numpy()
    keypoints = Keypoints2D(fmt, points.astype(np.float32), np.ones(len(points), dtype=np.float32))
    return keypoints, PartLabels(label_set("ellipbody20"), labels)


def observation_of(
    body: BodyParameters, labels: LabelSet | None = None, size: int = 256, fmt: str = "coco17"
) -> Observation:
    """Observation of ``body`` itself: sure keypoints, and the exact renderer's labels."""
    form, labels = skeleton(fmt), labels or label_set("ellipbody20")
    points = body.camera(2).project(LandmarkGather(form.marks, body.shift.device)(body.posed()))[0, :, :2] - 1
    image = drawn_labels(body, labels, size)[0]
    return Observation(form.landmarks, points.detach(), torch.ones_like(points[:, 0]), image, labels, marks=form.marks)


def drawn_labels(body: BodyParameters, labels: LabelSet, size: int) -> torch.Tensor:
    """The exact renderer's picture of the body's crop."""
    groups = labels.part_groups[1:].tolist()
    return draw_ellipsoids(body.posed(), body.camera(size), (size, size), part_labels=groups).labels


def standing_adult(*lost: str) -> tuple[Keypoints2D, PartLabels]:
    """The mean adult with arms out to the sides, 97 px tall; the labels of some parts are lost."""
    keypoints, parts = seen_by(replace(BodyParameters.mean(1), log_scale=torch.full((1,), -0.3)))
    groups = parts.groups.copy()
    groups[np.isin(groups, [PART_NAMES.index(name) + 1 for name in lost])] = BACKGROUND
    return keypoints, replace(parts, groups=groups)


def moved_bodies(body: BodyParameters, batch: int, seed: int = 0, amount: float = 0.15) -> BodyParameters:
    """Bodies near ``body``, no two alike."""
    rng = np.random.default_rng(seed)
    return BodyParameters(
        **{
            name: tensor + amount * (0.1 if name in ("lengths", "thicknesses") else 1.0) * noise(rng, tensor, batch)
            for name, tensor in body.tensors().items()
        }
    )


def noise(rng: np.random.Generator, like: torch.Tensor, batch: int) -> torch.Tensor:
    return torch.from_numpy(rng.standard_normal((batch, *like.shape[1:])).astype(np.float32)).to(like.device)


def unsure_observation(body: BodyParameters, fmt: str = "body25", labels: LabelSet | None = None) -> Observation:
    """Keypoints of a body, from unsure to sure, and its labels [64 px] in a set if asked for."""
    seen = observation_of(body, labels, 64, fmt)
    seen = replace(seen, confidence=torch.linspace(0.0, 1.0, len(seen.landmarks), device=body.shift.device))
    return seen if labels else replace(seen, labels=None, label_set=None)


def random_bodies(count: int, device: str) -> BodyParameters:
    generator = torch.Generator().manual_seed(count)

    def noise(like: torch.Tensor, spread: float) -> torch.Tensor:
        return (spread * torch.randn(like.shape, generator=generator)).to(device)

    mean = BodyParameters.mean(count, device=device)
    return replace(
        mean,
        orientation=mean.orientation + noise(mean.orientation, 0.5),
        rotations=noise(mean.rotations, 0.4),
        lengths=mean.lengths * noise(mean.lengths, 0.1).exp(),
        thicknesses=mean.thicknesses * noise(mean.thicknesses, 0.2).exp(),
        log_scale=noise(mean.log_scale, 0.3) - 0.3,
    )


TIPS = ("left_hand", "right_hand", "left_foot", "right_foot")
WITHOUT_TIPS = LabelSet(
    "tipless",
    {name: (name,) for name in PART_NAMES if name not in TIPS},
    {0: "background", **{part: name for part, name in enumerate(PART_NAMES, start=1) if name not in TIPS}},
    left_out=TIPS,
)


def bent_bodies(device: str = "cpu", batch: int = 2) -> BodyParameters:
    mean = BodyParameters.mean(batch, device=device)
    generator = torch.Generator().manual_seed(4)
    bend = 0.3 * torch.randn(mean.rotations.shape, generator=generator).to(device)
    return replace(mean, rotations=bend, log_scale=mean.log_scale - 0.1)


def random_parameters(seed: int, batch: int, device="cpu", dtype=torch.float64):
    rng = np.random.default_rng(seed)
    parameters = (
        Rotation.random(batch, rng=rng).as_matrix(),
        rng.normal(size=(batch, 3)),
        Rotation.random(batch * 20, rng=rng).as_matrix().reshape(batch, 20, 3, 3),
        rng.uniform(0.05, 0.5, (batch, 12)),
        rng.uniform(0.05, 0.3, (batch, 15)),
    )
    return [torch.from_numpy(p).to(device, dtype) for p in parameters]


def random_turns(count: int, num_joints: int, scale: float, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return rotation_from_axis_angle(scale * torch.randn(count, num_joints, 3, generator=generator, dtype=torch.float64))


def ellipbodies(
    device: str, count: int = 2, *, longer: dict[str, float] | None = None, thicker: dict[str, float] | None = None
) -> Posed:
    """Bodies in random poses near the rest pose, camera frame; one length or thickness times a factor."""
    generator = torch.Generator().manual_seed(0)
    turns = 0.3 * torch.randn(count, NUM_PARTS, 3, generator=generator)
    turns[:, :2] = 0
    lengths, thicknesses = (
        torch.tensor(values * [factors.get(name, 1.0) for name in names], dtype=torch.float32)
        for values, factors, names in (
            (template().mean_lengths, longer or {}, LENGTH_NAMES),
            (template().mean_thicknesses, thicker or {}, THICKNESS_NAMES),
        )
    )
    given = (
        torch.diag(torch.tensor([1.0, -1.0, -1.0])).repeat(count, 1, 1),
        torch.tensor([0.1, -0.2, 3.0]).repeat(count, 1),
        rotation_from_axis_angle(turns),
        lengths.repeat(count, 1),
        thicknesses.repeat(count, 1),
    )
    return pose(*(tensor.to(device) for tensor in given))


@pytest.fixture(scope="module")
def registered(device: str) -> Registered:
    return _registered(device)


@cache  # one for all files that ask for it
def _registered(device: str) -> Registered:
    return register(ellipbodies(device), anny(torch.device(device)), options=QUICK_REGISTRATION)


@cache
def clips(folder: Path) -> tuple[mocap.Clip, ...]:
    return tuple(mocap_files.load_clips(folder / "data" / "mocap"))


@cache
def bank() -> PoseBank:
    return PoseBank.of_prior(64)


def upright(x: float = 0.0, z: float = 0.0) -> Registered:
    """Anny at rest, facing the camera at a place in its frame [m]."""
    model = anny()
    shape, place = torch.zeros(1, model.num_shapes), torch.tensor([[x, 0.0, z]])
    rotations = torch.eye(3).repeat(1, model.num_joints, 1, 1)
    rotations[:, 0] = torch.diag(torch.tensor([1.0, -1.0, -1.0]))  # y down, z away
    posed, sizes = model.pose(shape, rotations, place), torch.zeros(1, 27)
    stretches = torch.eye(3).repeat(1, 20, 1, 1)
    return Registered(model, shape, rotations, place, stretches, torch.exp(sizes), sizes, posed, {})
