"""Skinning against a slow reference, and its gradient."""

from __future__ import annotations

import helpers.files
import numpy as np
import pytest
import torch
from helpers.bodies import random_turns

from warp_partdr.body.template import PART_NAMES
from warp_partdr.models.anny import anny
from warp_partdr.models.load import load_model
from warp_partdr.models.model import DetailedModel

smpl_file = helpers.files.smpl_file  # a fixture


def slow_pose(model: DetailedModel, shape: np.ndarray, rotations: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """Vertices of one body: one vertex and one joint at a time."""
    rest = model.rest_vertices.numpy() + np.einsum("s,svi->vi", shape, model.shape_directions.numpy())
    joints = model.rest_joints.numpy() + np.einsum("s,sji->ji", shape, model.joint_directions.numpy())
    if model.pose_directions is not None:
        rest = rest + ((rotations[1:] - np.eye(3)).ravel() @ model.pose_directions.numpy()).reshape(-1, 3)
    skin_weights = model.skin_weights.numpy()
    vertices = np.zeros_like(rest)
    for v, vertex in enumerate(rest):
        for joint in np.flatnonzero(skin_weights[v]):
            point, j = vertex, int(joint)
            while j >= 0:  # turn about each joint on the way to the root
                point, j = joints[j] + rotations[j] @ (point - joints[j]), model.parents[j]
            vertices[v] += skin_weights[v, joint] * (point - joints[0] + translation)
    return vertices


@pytest.mark.parametrize("name", ["anny", "smpl"])
def test_pose_is_linear_blend_skinning(name, smpl_file, device):
    model = load_model("anny" if name == "anny" else smpl_file, dtype=torch.float64)
    shape = torch.randn(2, model.num_shapes, dtype=torch.float64)
    rotations, translation = random_turns(2, model.num_joints, 0.4), torch.randn(2, 3, dtype=torch.float64)
    moved = model.to(device)
    posed = moved.pose(shape.to(device), rotations.to(device), translation.to(device))
    wanted = slow_pose(model, shape[1].numpy(), rotations[1].numpy(), translation[1].numpy())
    np.testing.assert_allclose(posed.vertices[1].cpu(), wanted, atol=1e-10)
    np.testing.assert_allclose(posed.joints[:, 0].cpu(), translation, atol=1e-12)
    assert torch.equal(posed.transforms[..., :3, 3], posed.joints)


def test_pose_in_float32_is_that_in_float64(device):
    model = anny(device)
    shape, rotations = torch.randn(3, model.num_shapes), random_turns(3, model.num_joints, 0.4)
    single = model.pose(shape.to(device), rotations.float().to(device), torch.ones(3, 3, device=device))
    double = anny("cpu", torch.float64).pose(shape.double(), rotations, torch.ones(3, 3, dtype=torch.float64))
    np.testing.assert_allclose(single.vertices.cpu(), double.vertices, atol=2e-5)


def test_pose_has_the_gradient_of_its_value(smpl_file):
    model = load_model(smpl_file, num_shapes=3, dtype=torch.float64)
    inputs = (
        torch.randn(2, 3, dtype=torch.float64),
        random_turns(2, model.num_joints, 0.4),
        torch.randn(2, 3, dtype=torch.float64),
        0.01 * torch.randn(2, model.num_vertices, 3, dtype=torch.float64),
    )
    for tensor in inputs:
        tensor.requires_grad_()

    def numbers(shape, rotations, translation, offsets):
        posed = model.pose(shape, rotations, translation, offsets=offsets)
        return posed.vertices[:, ::7], posed.joints, model.landmarks(posed, ["head_top", "left_wrist"])

    assert torch.autograd.gradcheck(numbers, inputs, fast_mode=True)


def test_an_empty_batch_is_posed(smpl_file):
    for model in (anny(), load_model(smpl_file)):
        posed = model.pose(torch.zeros(0, model.num_shapes), torch.zeros(0, model.num_joints, 3, 3), torch.zeros(0, 3))
        assert posed.vertices.shape == (0, model.num_vertices, 3)
        assert model.landmarks(posed, ["neck"]).shape == (0, 1, 3)


def test_wrong_arguments_are_named(smpl_file):
    model = load_model(smpl_file)
    shape, rotations, translation = torch.zeros(2, 10), torch.eye(3).expand(2, 24, 3, 3), torch.zeros(2, 3)
    for name, values in {
        "shape": (shape[:, :5], rotations, translation),
        "rotations": (shape, rotations[:, :5], translation),
        "translation": (shape, rotations, translation[:1]),
    }.items():
        with pytest.raises(ValueError, match=rf"^{name}: shape .*; expected"):
            model.pose(*values)
    with pytest.raises(ValueError, match=r"^rotations: torch.float64"):
        model.pose(shape, rotations.double(), translation)
    with pytest.raises(ValueError, match="offsets: shape"):
        model.pose(shape, rotations, translation, offsets=torch.zeros(2, 5, 3))
    with pytest.raises(ValueError, match="names: smpl has no landmark 'left_eye'"):
        model.landmarks(model.rest(shape), ["neck", "left_eye"])


def test_a_moved_body_is_one_posed_elsewhere(device):
    model, by = anny(device), torch.tensor([[0.3, -1.0, 2.0], [0.0, 0.5, 0.0]], device=device)
    shape, turns = torch.zeros(2, model.num_shapes, device=device), random_turns(2, model.num_joints, 0.3).float()
    here = model.pose(shape, turns.to(device), torch.zeros_like(by))
    there = model.pose(shape, turns.to(device), by)
    for name, tensor in vars(here.moved(by)).items():
        torch.testing.assert_close(tensor, getattr(there, name), atol=2e-5, rtol=0)
    assert torch.equal(here.transforms[..., :3, 3], here.joints)  # which stays where it was


def test_a_stretch_moves_what_hangs_on_a_part_and_is_not_inherited(device):
    model = anny(device)
    shape = torch.zeros(1, model.num_shapes, device=device)
    stretches = torch.eye(3, device=device).repeat(1, 20, 1, 1)
    stretches[0, PART_NAMES.index("left_upper_leg")] *= 1.5
    plain, stretched = model.rest(shape).joints[0], model.rest(shape, stretches=stretches).joints[0]
    parts = ("left_upper_leg", "left_lower_leg", "left_foot")
    hip, knee, ankle = (model.part_joints[PART_NAMES.index(part)] for part in parts)
    for start, end, factor in ((hip, knee, 1.5), (knee, ankle, 1.0)):
        bone = (stretched[end] - stretched[start]).norm()
        assert float(bone) == pytest.approx(factor * float((plain[end] - plain[start]).norm()), rel=1e-4)
    torch.testing.assert_close(stretched[hip], plain[hip])
