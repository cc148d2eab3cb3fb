"""The public objects go to other devices, into copies and into files."""

from __future__ import annotations

import copy
import pickle
from dataclasses import fields, is_dataclass
from functools import partial

import numpy as np
import pytest
import torch
import warp as wp

from warp_partdr.body.ellipbody import EllipBody
from warp_partdr.body.labels import label_set
from warp_partdr.body.parameters import BodyParameters
from warp_partdr.cameras import Crop, Perspective
from warp_partdr.inputs.evidence import Evidence
from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.inputs.observation import Observation
from warp_partdr.models.anny import anny
from warp_partdr.models.registration import Registered
from warp_partdr.render.ellipsoids import Ellipsoids, ellipsoid_label_loss
from warp_partdr.render.part_mesh import ellipbody_mesh
from warp_partdr.solve.ellipsoids.result import FitResult
from warp_partdr.solve.ellipsoids.stages import STAGES
from warp_partdr.solve.ellipsoids.stepper import Refined

CROP = Crop(1.0, 2.0, 0.5, (256, 256))


def objects(device):
    """One of each, by name; equal numbers on every device."""
    body = BodyParameters.mean(2, device=device)
    posed, camera = body.posed(), body.camera(64)
    model = anny(torch.device(device))
    shape = torch.zeros(2, model.num_shapes, device=device)
    turns = torch.eye(3, device=device).expand(2, model.num_joints, 3, 3)
    detailed = model.pose(shape, turns, torch.zeros(2, 3, device=device))
    seen = Observation(
        ("nose", "left_wrist"),
        torch.tensor([[0.1, -0.2], [0.3, 0.0]], device=device),
        torch.tensor([1.0, 0.5], device=device),
        torch.zeros(4, 4, dtype=torch.uint8, device=device),
        label_set("cdcl14"),
    )
    fit = FitResult(
        body,
        CROP,
        seen,
        STAGES["network"]["balanced"],
        {"proj": 1.0},
        [np.arange(3.0)],
        {"network": 0.1},
        1,
        [2.0],
        "network",
        Evidence(Keypoints2D("coco17", np.zeros((17, 2), np.float32), np.ones(17, np.float32)), None, CROP, None),
    )
    terms = {"icp": torch.arange(2.0, device=device)}
    ones = torch.ones(2, 27, device=device)
    stretches = torch.eye(3, device=device).expand(2, 20, 3, 3)
    return {
        "EllipBody": EllipBody.mean(2, device=device),
        "EllipBody, float64": EllipBody.mean(1, device=device, dtype=wp.float64),
        "PosedEllipBody": EllipBody.mean(1, device=device).pose(),
        "Posed": posed,
        "BodyParameters": body,
        "WeakPerspective": camera,
        "Perspective": Perspective(torch.ones(2, 2, device=device), torch.zeros(2, 2, device=device)),
        "PartMesh": ellipbody_mesh(0, device=device),
        "Ellipsoids": Ellipsoids(posed.centres, posed.axes, posed.semi_axes),
        "Observation": seen,
        "FitResult": fit,
        "Refined": Refined(body, ones[:, 0], terms, ones),
        "DetailedModel": model,
        "Detailed": detailed,
        "Registered": Registered(model, shape, turns, ones[:, :3], stretches, ones, ones, detailed, terms),
    }


NAMES = list(objects("cpu"))


def numbers(value):
    """All arrays in an object, by path, with where they are."""
    if isinstance(value, wp.array):
        return {"": (value.device.is_cuda, str(value.dtype), value.numpy())}
    if isinstance(value, torch.Tensor):
        return {"": (value.is_cuda, str(value.dtype), value.cpu().numpy())}
    if isinstance(value, np.ndarray):
        return {"": (None, str(value.dtype), value)}  # NumPy's stay where they are
    inner = value if isinstance(value, dict) else {}
    if is_dataclass(value):
        inner = {field.name: getattr(value, field.name) for field in fields(value)}
    return {f"{name}.{path}": found for name, each in inner.items() for path, found in numbers(each).items()}


def assert_same(have, want, cuda=None):
    assert type(have) is type(want)
    have, want = numbers(have), numbers(want)
    assert have.keys() == want.keys()
    assert have
    for path, (where, dtype, values) in have.items():
        if where is not None:
            assert where == (want[path][0] if cuda is None else cuda), path
        assert dtype == want[path][1], path
        np.testing.assert_array_equal(values, want[path][2], err_msg=path)


@pytest.mark.parametrize("name", NAMES)
def test_objects_move_to_a_device_and_back(device, name):
    given = objects("cpu")[name]
    there = given.to(device)
    assert_same(there, given, cuda=device == "cuda")
    assert_same(there.to("cpu"), given)
    assert_same(given.to(torch.device(device)), there)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    "copied",
    [copy.copy, copy.deepcopy, lambda value: pickle.loads(pickle.dumps(value))],
    ids=["copy", "deep", "pickle"],
)
def test_copies_are_equal(device, name, copied):
    given = objects(device)[name]
    assert_same(copied(given), given)


def test_a_deep_copy_of_a_body_shares_no_memory(device):
    body = EllipBody.mean(2, device=device)
    other, shallow = copy.deepcopy(body), copy.copy(body)
    body.torch()["lengths"][1] = 7.0
    assert other.lengths.numpy().max() < 1
    assert other.device == body.device
    assert shallow.lengths.numpy().max() == 7.0
    assert other.measure(0) == body.measure(0)
    np.testing.assert_array_equal(other.pose().torch()["joints"][0].cpu(), body.pose().torch()["joints"][0].cpu())


def test_what_is_there_already_is_shared(device):
    body = BodyParameters.mean(1, device=device)
    here = body.lengths.device
    assert body.to(here).lengths is body.lengths
    assert EllipBody.mean(1, device=device).to(here).device == wp.device_from_torch(here)


def test_gradients_flow_through_a_move(device):
    lengths = BodyParameters.mean(1).lengths.requires_grad_()
    moved = Ellipsoids(lengths, lengths, lengths).to(device)
    moved.centres.sum().backward()
    assert lengths.grad is not None


def test_pictures_that_are_drawn_later_can_be_copied(device):
    posed = BodyParameters.mean(1, device=device).posed()
    camera = BodyParameters.mean(1, device=device).camera(32)
    target = torch.zeros(1, 32, 32, dtype=torch.uint8, device=device)
    for copied in (copy.deepcopy, lambda value: pickle.loads(pickle.dumps(value))):
        _, picture = ellipsoid_label_loss(posed, camera, target)
        other = copied(picture)
        assert torch.equal(other.labels, picture.labels)
        assert torch.equal(copied(picture).depth, picture.depth)


def test_a_moved_mesh_keeps_its_number_of_labels(device):
    mesh = partial(ellipbody_mesh, 0)
    assert (mesh().to(device).num_labels, mesh().to(device).num_vertices) == (20, 240)
