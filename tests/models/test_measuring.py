"""EllipBody measured from a detailed body: its inverse is the detailed body's pose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
import trimesh
from scipy.spatial import ConvexHull

from warp_partdr.body.posing import pose
from warp_partdr.body.rotations import rotation_from_axis_angle, rotation_to_axis_angle
from warp_partdr.body.template import JOINT_NAMES, LENGTH_NAMES, LOCKED_PARTS, PART_NAMES
from warp_partdr.models.anny import anny, anny_shape
from warp_partdr.models.growth import MEASURES, Growth
from warp_partdr.models.measuring import measure_body, measure_ellipbody
from warp_partdr.models.model import DetailedModel
from warp_partdr.models.pose import pose_from_ellipbody
from warp_partdr.models.registration import Registered, ungrown

# Two people, as shares from female to male, young to old, and so on.
_PEOPLE = [[0.2, 0.6, 0.4, 0.6, 0.5, 0.5], [0.8, 0.5, 0.6, 0.3, 0.7, 0.4]]


def dressed(device: str, turns: float) -> tuple[DetailedModel, torch.Tensor, Registered]:
    """Anny's bodies in poses of so large turns [rad], the turns, and the bodies."""
    model = anny(torch.device(device))
    shape = anny_shape(torch.tensor(_PEOPLE, device=device))
    vectors = turns * torch.randn(2, 20, 3, generator=torch.Generator().manual_seed(3)).to(device)
    vectors[:, list(LOCKED_PARTS)] = 0
    sizes = Growth(model, shape).measured(shape).exp()
    orientation = rotation_from_axis_angle(torch.tensor([[0.3, 2.0, -0.4], [0.0, 3.0, 0.2]], device=device))
    place = torch.tensor([[0.1, 0.2, 3.0], [0.0, -0.3, 4.0]], device=device)
    count = len(LENGTH_NAMES)
    posed = pose(orientation, place, rotation_from_axis_angle(vectors), sizes[:, :count], sizes[:, count:])
    return model, vectors, ungrown(model, shape, *pose_from_ellipbody(model, posed, shape, trunk_along=True), {})


def test_bones_and_joints_are_the_detailed_bodys(device: str) -> None:
    model, _, body = dressed(device, 0.2)
    posed = pose(*measure_ellipbody(body))
    joints = model.landmarks(body.detailed, JOINT_NAMES)
    apart = (posed.joints - joints).norm(dim=-1)
    assert apart.mean() < 0.015
    assert apart.max() < 0.03  # where skin turns little by little, so do landmarks on it
    assert (posed.joints - joints).mean(1).abs().max() < 1e-5


def test_measuring_a_posed_body_returns_ellipbodys_turns(device: str) -> None:
    _, vectors, body = dressed(device, 0.3)
    orientation, _, rotations, lengths, thicknesses = measure_ellipbody(body)
    off = rotation_to_axis_angle(rotation_from_axis_angle(vectors).mT @ rotations).norm(dim=-1)
    assert off.median() < 0.06
    assert off.max() < 0.5
    assert (rotations[:, list(LOCKED_PARTS)] - torch.eye(3, device=device)).abs().max() < 1e-5
    measures = torch.cat([lengths, thicknesses], dim=1)
    assert measures.shape == (2, len(MEASURES))
    assert (measures[:, :2] > 0.05).all()
    assert (torch.linalg.det(orientation) - 1).abs().max() < 1e-5


def tape(vertices: np.ndarray, faces: np.ndarray, height: float) -> float:
    """Length of a tape around a horizontal section."""
    lines = trimesh.intersections.mesh_plane(trimesh.Trimesh(vertices, faces, process=False), [0, 1, 0], [0, height, 0])
    return float(ConvexHull(lines.reshape(-1, 3)[:, [0, 2]]).area)  # of a plane figure, its outline


def test_girths_agree_with_a_tape_around_the_mesh(device: str) -> None:
    model = anny(torch.device(device))
    rest = model.rest(anny_shape(torch.tensor(_PEOPLE, device=device)))
    measures = measure_body(model, rest).cpu().numpy()
    faces, parts = model.faces.cpu().numpy(), model.face_parts.cpu().numpy()

    def around(person: int, names: list[str], end: str, shares: list[float]) -> list[float]:
        start, stop = model.landmarks(rest, ["left_hip", end])[person, :, 1].tolist()
        chosen = faces[np.isin(parts, [1 + PART_NAMES.index(name) for name in names])]
        return [tape(rest.vertices[person].cpu().numpy(), chosen, start + each * (stop - start)) for each in shares]

    trunk = ["left_hip", "right_hip", "abdomen", "chest"]
    legs = ["left_upper_leg", "right_upper_leg"]
    for person in range(2):
        chest = around(person, trunk, "left_shoulder", [0.75])[0]
        waist = min(around(person, trunk, "left_shoulder", np.linspace(0.2, 0.6, 9).tolist()))
        hips = max(around(person, trunk + legs, "left_shoulder", np.linspace(-0.15, 0.15, 9).tolist()))
        thigh = max(around(person, legs[:1], "left_knee", np.linspace(0.3, 0.5, 9).tolist()))
        np.testing.assert_allclose(measures[person, 1:], [chest, waist, hips, thigh], rtol=1e-3)
    heights = rest.vertices[..., 1].cpu().numpy()
    np.testing.assert_allclose(measures[:, 0], np.ptp(heights, axis=1), rtol=1e-6)


def test_girths_grow_with_the_body_and_have_a_gradient(device: str) -> None:
    model = anny(torch.device(device))
    shape = anny_shape(torch.tensor(_PEOPLE, device=device)).requires_grad_()
    rest = model.rest(shape)
    double = replace(rest, vertices=2 * rest.vertices, joints=2 * rest.joints)
    torch.testing.assert_close(measure_body(model, double), 2 * measure_body(model, rest))
    arms = torch.isin(model.face_parts, torch.tensor([15, 16, 17, 18, 19, 20], device=device))
    raised = rest.vertices.detach().clone()
    raised[:, model.faces[arms].unique().long(), 2] += 1.0  # as long as they stand in no section of the trunk
    torch.testing.assert_close(measure_body(model, replace(rest, vertices=raised)), measure_body(model, rest))
    (slopes,) = torch.autograd.grad(measure_body(model, rest).sum(), shape)
    assert slopes.isfinite().all()
    assert (slopes.abs().amax(1) > 1e-3).all()


def test_bodies_split_as_they_are_selected(device: str) -> None:
    _, _, body = dressed(device, 0.2)
    body = replace(body, losses={"proj": torch.tensor([1.0, 2.0], device=device)})
    for index, alone in enumerate(body.split()):
        selected = body.select(slice(index, index + 1))
        assert torch.equal(alone.losses["proj"], selected.losses["proj"])
        for name in ("shape", "rotations", "translation", "stretches", "growth", "unexplained"):
            assert torch.equal(getattr(alone, name), getattr(selected, name))
        for name in vars(body.detailed):
            assert torch.equal(getattr(alone.detailed, name), getattr(selected.detailed, name))
