"""Matrices that are no rotations are refused where they come in; what rounding makes of rotations passes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from helpers.pictures import Leaves, body_parameters

from warp_partdr.body.ellipbody import EllipBody
from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.posing import Posed, pose
from warp_partdr.body.rotations import rotation_from_axis_angle
from warp_partdr.cameras import WeakPerspective
from warp_partdr.errors import InputError
from warp_partdr.interop.checks import ROTATION_TOLERANCE, rotation_error, rotation_fault
from warp_partdr.models.anny import anny
from warp_partdr.models.registration import register
from warp_partdr.render.ellipsoids import Ellipsoids, draw_ellipsoids, ellipsoid_label_loss
from warp_partdr.results.body_file import load_body

MIRROR = torch.diag(torch.tensor([1.0, 1.0, -1.0]))
NO_ROTATIONS = {
    "ones": torch.ones(3, 3),
    "zeros": torch.zeros(3, 3),
    "scaled": 1.02 * torch.eye(3),
    "sheared": torch.eye(3) + torch.tensor([[0.0, 0.02, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]),
    "transposed columns": torch.eye(3)[[0, 0, 2]],
}


def turns(*shape: int) -> torch.Tensor:
    return rotation_from_axis_angle(torch.randn(*shape, 3))


def test_rounded_rotations_pass() -> None:
    rotations = turns(20_000)
    for dtype in (torch.float64, torch.float32, torch.float16, torch.bfloat16):
        assert rotation_fault(rotations.to(dtype)) is None, dtype
    assert float(rotation_error(rotations.bfloat16()).max()) > ROTATION_TOLERANCE / 3  # what sets the tolerance
    product = torch.eye(3)
    for rotation in turns(10_000):
        product = rotation @ product
    assert rotation_fault(product) is None
    assert rotation_fault(rotations[:0]) is None


@pytest.mark.parametrize("name", NO_ROTATIONS)
def test_matrices_that_are_no_rotations_are_found_by_index(name: str) -> None:
    matrices = turns(4, 5)
    matrices[2, 3] = NO_ROTATIONS[name]
    for mirrored in (False, True):
        assert "matrix [2, 3] " in str(rotation_fault(matrices, mirrored=mirrored))
    assert "matrix " in str(rotation_fault(NO_ROTATIONS[name]))
    assert rotation_fault(MIRROR, mirrored=True) is None
    assert "mirrors" in str(rotation_fault(MIRROR))


@pytest.mark.parametrize("which", ["global_orient", "rotations"])
@pytest.mark.parametrize("name", [*NO_ROTATIONS, "mirrored"])
def test_posing_refuses_matrices_that_are_no_rotations(which: str, name: str, device: str) -> None:
    arguments = body_parameters(0, device, batch=2)
    pose(**arguments)
    arguments[which][1] = {**NO_ROTATIONS, "mirrored": MIRROR}[name].to(device)
    with pytest.raises(ValueError, match=rf"^{which}: matrix \[1(, 0)?\] .*; expected rotation matrices"):
        pose(**arguments)
    pose(**arguments, validate=False)
    numbers = {key: value.cpu().numpy() for key, value in arguments.items()}
    with pytest.raises(ValueError, match=rf"^{which}: matrix \[1(, 0)?\] "):
        EllipBody.from_numpy(**numbers, device=device)


def scene(device: str) -> tuple[Ellipsoids, WeakPerspective]:
    centres = torch.tensor([[[0.0, 0.0, 2.0], [0.3, 0.1, 2.2]]])
    ellipsoids = Ellipsoids(
        centres.to(device), turns(1, 2).to(device), torch.tensor([[[0.5, 0.3, 0.2]] * 2]).to(device)
    )
    return ellipsoids, WeakPerspective(torch.tensor([10.0]).to(device), torch.tensor([[12.0, 12.0]]).to(device))


@pytest.mark.parametrize("name", NO_ROTATIONS)
def test_drawing_refuses_axes_that_are_not_orthonormal(name: str, device: str) -> None:
    ellipsoids, camera = scene(device)
    ellipsoids.axes[0, 1] = NO_ROTATIONS[name].to(device)
    target = torch.zeros(1, 24, 24, dtype=torch.uint8, device=device)
    for call in (
        lambda **options: draw_ellipsoids(ellipsoids, camera, (24, 24), **options),
        lambda **options: ellipsoid_label_loss(ellipsoids, camera, target, **options),
    ):
        with pytest.raises(ValueError, match=r"^axes: matrix \[0, 1\] R\^T R is off I by .*; expected orthonormal"):
            call()
        call(validate=False)


@pytest.mark.parametrize("gradient", ["coverage", "edges", "partdr"])
def test_mirrored_axes_are_the_same_ellipsoid(gradient: Any, device: str) -> None:
    ellipsoids, camera = scene(device)
    mirrored = Ellipsoids(ellipsoids.centres, ellipsoids.axes @ MIRROR.to(device), ellipsoids.semi_axes)
    target = torch.ones(1, 24, 24, dtype=torch.uint8, device=device)
    found = []
    for each in (ellipsoids, mirrored):
        leaves = Ellipsoids(*(value.clone().requires_grad_() for value in vars(each).values()))
        loss, image = Leaves(leaves, camera).push_by_loss(target, gradient=gradient, samples_per_pixel=32)
        found.append([loss, image.labels, image.depth, *(leaf.grad for leaf in vars(leaves).values())])
    found[1][4] = found[1][4] @ MIRROR.to(device)
    for here, there in zip(*found, strict=True):
        torch.testing.assert_close(here, there, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("which", ["global_orient", "rotations"])
@pytest.mark.parametrize("name", [*NO_ROTATIONS, "mirrored"])
def test_body_files_with_matrices_that_are_no_rotations_are_refused(which: str, name: str, tmp_path: Path) -> None:
    path = tmp_path / "body.npz"
    arrays = {key: value[0].numpy() for key, value in body_parameters(0).items()}
    arrays |= {"format": "warp-partdr body 1", "camera_scale": 100.0, "camera_translation": np.zeros(2)}
    arrays |= {"image_size": np.array([64, 64]), "camera_perspective": np.array(0)}
    np.savez(path, **arrays)
    load_body(path)
    arrays[which].reshape(-1, 3, 3)[-1] = {**NO_ROTATIONS, "mirrored": MIRROR}[name].numpy()
    np.savez(path, **arrays)
    with pytest.raises(InputError, match=rf"body\.npz: {which}: matrix .*; expected rotation matrices"):
        load_body(path)


def test_registration_refuses_matrices_that_are_no_rotations() -> None:
    posed = BodyParameters.mean(1).posed()
    for name in ("rotations", "axes"):
        tensors = {key: value.clone() for key, value in vars(posed).items()}
        tensors[name][0, 4] = 1.0
        with pytest.raises(ValueError, match=rf"^{name}: matrix \[0, 4\]"):
            register(Posed(**tensors), anny())
