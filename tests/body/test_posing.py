"""Forward kinematics: the formula book's walk of the tree, finite differences in float64, and the Warp class."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh
import warp as wp
from helpers.bodies import random_parameters

from warp_partdr.body.ellipbody import EllipBody, ellipbody_faces
from warp_partdr.body.icosphere import icosphere
from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.plain_posing import pose_bones_by_torch
from warp_partdr.body.posing import Posed, pose
from warp_partdr.body.rotations import rotation_from_6d, rotation_from_axis_angle
from warp_partdr.body.template import PARENTS, SHAPE_INDICES, template
from warp_partdr.reference.ellipbody import BodyTree, deform_sphere, ellipsoids_of, place_joints

TREE = BodyTree(PARENTS, template().rest_directions, template().rest_axes, SHAPE_INDICES)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_posing_agrees_with_the_reference_walk_along_the_joints(device, dtype):
    parameters = random_parameters(0, 3, device, dtype)
    posed = pose(*parameters)
    tolerance = 1e-5 if dtype == torch.float32 else 1e-12
    sphere = icosphere(1)[0]
    for b in range(3):
        *placed, lengths, thicknesses = [p[b].cpu().double().numpy() for p in parameters]
        joints, turns = place_joints(TREE, *placed, lengths)
        ellipsoids = ellipsoids_of(TREE, joints, turns, lengths, thicknesses)
        want = (
            joints,
            turns,
            np.stack([each.centre for each in ellipsoids]),
            np.stack([each.axes for each in ellipsoids]),
            np.stack([each[2:] for each in ellipsoids]) / 2,
            np.concatenate([deform_sphere(each, sphere) for each in ellipsoids]),
        )
        have = (posed.joints, posed.rotations, posed.centres, posed.axes, posed.semi_axes, posed.vertices(1))
        for h, w in zip(have, want, strict=True):
            np.testing.assert_allclose(h[b].cpu().numpy(), w, atol=tolerance)


@pytest.mark.parametrize("subdivisions", [0, 1])
def test_adjoints_agree_with_finite_differences(device, subdivisions):
    parameters = [p.requires_grad_() for p in random_parameters(1, 2, device)]

    def everything(*parameters):
        posed = pose(*parameters)
        bones = (posed.joints, posed.rotations, posed.centres, posed.axes, posed.semi_axes)
        return (*bones, posed.vertices(subdivisions))

    assert torch.autograd.gradcheck(everything, parameters, fast_mode=subdivisions == 1)


@pytest.mark.parametrize("form", ["axis-angle", "6D"])
def test_rotations_in_other_forms_pose_as_their_matrices_do(device, form):
    """Their gradients are those that torch finds through the matrices, and they can be differentiated twice."""
    generator = torch.Generator().manual_seed(3)
    width = {"axis-angle": 3, "6D": 6}[form]
    make = {"axis-angle": rotation_from_axis_angle, "6D": rotation_from_6d}[form]
    whole, turns = (torch.randn(2, *s, width, generator=generator) for s in ((), (20,)))
    turns[0, 3] = 0.0  # no turn, or no direction
    others = random_parameters(0, 2, "cpu", torch.float32)
    factors = [torch.randn(2, *s, generator=generator) for s in ((21, 3), (20, 3, 3), (20, 3), (20, 3, 3), (20, 3))]

    def total(whole, turns, translation, lengths, thicknesses):
        posed = pose(whole, translation, turns, lengths, thicknesses)
        fields = posed.joints, posed.rotations, posed.centres, posed.axes, posed.semi_axes
        return sum((one * factor.to(one)).sum() for one, factor in zip(fields, factors, strict=True))

    for dtype in (torch.float32, torch.float64):
        leaves = [t.to(device, dtype).requires_grad_() for t in (whole, turns, others[1], *others[3:])]
        for _ in range(3):  # launched, captured, replayed
            have = total(*leaves)
            want = total(make(leaves[0]), make(leaves[1]), *leaves[2:])
            torch.testing.assert_close(have, want)
            gradients = [torch.autograd.grad(each, leaves) for each in (have, want)]
            for one, other in zip(*gradients, strict=True):
                torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-4)
    first = torch.autograd.grad(total(*leaves), leaves[1], create_graph=True)[0]
    assert torch.autograd.grad(first.square().sum(), leaves[1])[0].abs().max() > 0


def test_results_that_are_not_used_have_zero_adjoints(device):
    """This must also hold in a graph whose buffers another call has filled."""
    parameters = [p.requires_grad_() for p in random_parameters(4, 2, device, torch.float32)]
    for asked in ("joints", "axes", "joints", "axes", "joints"):
        posed = pose(*parameters)
        gradient = torch.autograd.grad(getattr(posed, asked).square().sum(), parameters, allow_unused=True)
        exact = [p.detach().double().requires_grad_() for p in parameters]
        by_torch = Posed(*pose_bones_by_torch(*exact))
        want = torch.autograd.grad(getattr(by_torch, asked).square().sum(), exact, allow_unused=True)
        for one, other in zip(gradient, want, strict=True):
            expected = torch.zeros_like(one) if other is None else other
            torch.testing.assert_close(one.double(), expected.double(), rtol=1e-4, atol=1e-4)


def test_faces_point_outward_and_count_as_the_paper_says():
    for subdivisions, count in enumerate((20, 80, 320, 1280)):
        vertices, faces = icosphere(subdivisions)
        assert len(faces) == count
        expected = trimesh.creation.icosphere(subdivisions=subdivisions)
        assert np.array_equal(faces, expected.faces)
        np.testing.assert_allclose(vertices, expected.vertices, rtol=0, atol=1e-15)
        a, b, c = vertices[faces].transpose(1, 0, 2)
        assert (np.einsum("fi,fi->f", np.cross(b - a, c - a), a) > 0).all()
        all_faces, labels = ellipbody_faces(subdivisions)
        assert all_faces.max() + 1 == 20 * len(vertices)
        assert np.array_equal(np.bincount(labels)[1:], np.full(20, count))
    with pytest.raises(ValueError, match="subdivisions: 4"):
        icosphere(4)


def test_class_holds_warp_arrays_and_shares_them_with_torch(device):
    body = EllipBody.mean(2, device=device)
    assert isinstance(body.rotations, wp.array)
    views = body.torch()
    assert views["rotations"].data_ptr() == body.rotations.ptr
    assert views["rotations"].shape == (2, 20, 3, 3)
    views["translation"][1] = torch.tensor([1.0, 2.0, 3.0])
    posed = body.pose(subdivisions=1).torch()
    np.testing.assert_allclose(posed["joints"][1, 0].cpu(), [1, 2, 3])
    same = pose(*views.values())
    torch.testing.assert_close(same.joints, posed["joints"])
    torch.testing.assert_close(same.vertices(1), posed["vertices"].flatten(1, 2))


def test_measure_names_every_length_and_thickness():
    measured = EllipBody.mean(device="cpu").measure()
    constants = template()
    assert measured["left forearm length"] == pytest.approx(constants.mean_lengths[10])
    assert measured["right hand width"] == pytest.approx(constants.mean_thicknesses[13])
    lengths = [name for name in measured if name.endswith("length")]
    assert len(lengths) == 20
    values = np.array(list(measured.values()))
    for value in [*constants.mean_lengths, *constants.mean_thicknesses]:
        assert np.isclose(values, value, atol=1e-6).any()


def test_an_empty_batch_is_posed(device):
    body = EllipBody.mean(0, device=device)
    assert body.pose().torch()["joints"].shape == (0, 21, 3)
    parameters = [p.requires_grad_() for p in random_parameters(0, 1, device)]
    empty = [p[:0] for p in parameters]
    pose(*empty).joints.sum().backward()


def test_bad_calls_name_the_argument():
    good = random_parameters(0, 2)
    for index, name in [(1, "translation"), (2, "rotations"), (3, "lengths"), (4, "thicknesses")]:
        bad = list(good)
        bad[index] = good[index][:, :2]
        with pytest.raises(ValueError, match=f"{name}: shape"):
            pose(*bad)
        bad[index] = good[index].float()
        with pytest.raises(ValueError, match=f"{name}: torch.float32"):
            pose(*bad)
    arrays = EllipBody.mean(1, device="cpu").numpy()
    with pytest.raises(ValueError, match="lengths: holds NaN"):
        EllipBody.from_numpy(**{**arrays, "lengths": arrays["lengths"] * np.nan})


@pytest.mark.parametrize("level", [4, -1, 1e30, 1.0, True])
def test_a_level_of_the_mesh_that_there_is_not_is_refused(level: object) -> None:
    with pytest.raises(ValueError, match=r"subdivisions: .*; expected an integer from 0 to 3"):
        BodyParameters.mean(1).posed().vertices(level)  # type: ignore[arg-type]
