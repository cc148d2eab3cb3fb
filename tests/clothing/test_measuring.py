"""EllipBody measured from a detailed body: its inverse is the detailed body's pose."""

from __future__ import annotations

import torch

from warp_partdr.body.posing import pose
from warp_partdr.body.rotations import rotation_from_axis_angle, rotation_to_axis_angle
from warp_partdr.body.template import JOINT_NAMES, LENGTH_NAMES, LOCKED_PARTS
from warp_partdr.clothing.anny import anny, anny_shape
from warp_partdr.clothing.growth import MEASURES, Growth
from warp_partdr.clothing.measuring import measure_ellipbody
from warp_partdr.clothing.model import DetailedModel
from warp_partdr.clothing.pose import pose_from_ellipbody
from warp_partdr.clothing.registration import Registered, ungrown
from warp_partdr.clothing.surfaces import vertex_parts

# Two people, as shares from female to male, young to old, and so on.
_PEOPLE = [[0.2, 0.6, 0.4, 0.6, 0.5, 0.5], [0.8, 0.5, 0.6, 0.3, 0.7, 0.4]]


def dressed(device: str, turns: float) -> tuple[DetailedModel, torch.Tensor, Registered]:
    """Anny's bodies in poses of so large turns [rad], the turns, and the bodies."""
    model = anny(torch.device(device))
    shape = anny_shape(torch.tensor(_PEOPLE, device=device))
    vectors = turns * torch.randn(2, 20, 3, generator=torch.Generator().manual_seed(3)).to(device)
    vectors[:, list(LOCKED_PARTS)] = 0
    sizes = Growth(model, *vertex_parts(model), shape).measured(shape).exp()
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


def test_ellipbodys_turns_come_back(device: str) -> None:
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
