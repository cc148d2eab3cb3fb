"""The extremes of docs/stability.md: each gives a right, finite answer or a clear error, in both renderers.

"Right" is what the float64 references say, wherever no outline, crease or tie in depth is nearer than ``PLACE`` and
``LEAD``. What test_ellipsoids.py and test_mesh.py hold at ordinary sizes is not repeated here.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scenes.pictures import (
    CAMERAS,
    GRADIENTS,
    Leaves,
    all_finite,
    body_camera,
    body_parameters,
    check_ellipsoid_picture,
    checked_target,
    faces,
    loss_on_screen,
    one_scene,
    push_on_screen,
    scene_of,
    triangle,
    upright,
)

from warp_partdr.body.posing import pose
from warp_partdr.body.rotations import rotation_from_axis_angle
from warp_partdr.reference import ellipsoids as ellipsoid_reference
from warp_partdr.reference import mesh as reference
from warp_partdr.render.ellipsoids import ellipsoid_label_loss
from warp_partdr.render.mesh import mesh_label_loss
from warp_partdr.render.part_mesh import ellipbody_mesh

# --- Bodies at the camera -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("depth", "shows"), [(-3.0, False), (-0.5, False), (0.0, None), (0.2, True), (0.6, True), (1e4, False)]
)
def test_bodies_behind_across_and_around_the_camera(device, depth, shows):
    """What lies in front of it is drawn, what reaches it is not, and no gradient is lost to infinity."""
    size = (40, 32)
    camera = body_camera(size, True, device=device)
    leaves = {name: value.requires_grad_() for name, value in body_parameters(2, device).items()}
    with torch.no_grad():
        leaves["translation"][:, 2] = depth
    target, posed = checked_target(size, 20, device), pose(**leaves)
    for gradient in GRADIENTS:
        loss, image = ellipsoid_label_loss(posed, camera, target, gradient=gradient)
        check_ellipsoid_picture(image, scene_of(posed, camera), size)
        gradients = torch.autograd.grad(loss.sum(), list(leaves.values()), retain_graph=True)
        assert all(torch.isfinite(each).all() for each in gradients)
    mesh, vertices = ellipbody_mesh(1, device=device), posed.vertices(1)
    loss, picture = mesh_label_loss(vertices, mesh, camera, target)
    shown = picture.face_index[0].unique()
    drawn = mesh.faces[shown[shown >= 0].long()].long()
    assert (vertices[0, :, 2][drawn] > 0.01).all()
    assert all(torch.isfinite(each).all() for each in torch.autograd.grad(loss.sum(), list(leaves.values())))
    if shows is not None:  # at the camera itself, parts of a mesh may be in front where no whole ellipsoid is
        assert [bool((each.labels > 0).any()) for each in (image, picture)] == [shows, shows]


@pytest.mark.parametrize("angle", [0.0, 1e-8, math.pi - 1e-6, math.pi, 2 * math.pi])
def test_bodies_turned_by_nothing_and_by_half_a_turn(device, angle):
    size = (40, 32)
    parameters = body_parameters(0, device)
    turns = torch.zeros(1, 20, 3, device=device)
    turns[..., 0] = angle
    turns.requires_grad_()
    parameters["rotations"] = rotation_from_axis_angle(turns)
    camera = body_camera(size, False, device=device)
    for gradient in GRADIENTS:
        loss, _ = ellipsoid_label_loss(pose(**parameters), camera, checked_target(size, 20, device), gradient=gradient)
        (have,) = torch.autograd.grad(loss.sum(), turns, retain_graph=True)
        assert torch.isfinite(have).all()
        assert (have != 0).any()


# --- Equal depths, empty and full targets, labels outside the set ---------------------------------------------------


@pytest.mark.parametrize("perspective", CAMERAS)
def test_no_depth_between_two_parts(device, perspective):
    """The paper's log(1 / dz + 1) with dz = 0: bounded, and equal and opposite."""
    size, z = (16, 16), 2.0
    leaf, mesh = faces([[[1, 1, z], [14, 2, z], [5, 13, z]]] * 2, [1, 2], device)
    _, image = push_on_screen(leaf, mesh, torch.full((1, *size), 2, dtype=torch.uint8, device=device))
    pixels = (image.labels == 1).sum().item()
    bound = 2 * pixels * math.log(1 / reference.MIN_DELTA_Z + 1)
    front, back = leaf.grad[0, :3, 2], leaf.grad[0, 3:, 2]
    assert pixels > 0
    assert (back > 0).all()
    assert back.sum() <= 3 * bound
    torch.testing.assert_close(front, -back)

    twins = upright([(0, 0, z)] * 2, np.full((2, 3), 0.5), device)
    _, image = Leaves(twins, body_camera(size, perspective, device=device)).push_by_loss(
        np.full(size, 2), gradient="partdr"
    )
    push = (image.labels == 1).sum().item() * 2 * math.log(1 / reference.MIN_DELTA_Z + 1)
    assert twins.centres.grad[0, 1, 2].item() == pytest.approx(push, rel=1e-3 if not perspective else 1.0)
    assert torch.isfinite(twins.centres.grad).all()


@pytest.mark.parametrize("label", [0, 1])
def test_empty_and_full_targets(device, label):
    """All background shrinks a part; one part everywhere grows it."""
    size = (16, 16)
    target = torch.full((1, *size), label, dtype=torch.uint8, device=device)
    sign = -1.0 if label else 1.0
    for gradient in GRADIENTS:
        sphere = upright([(0, 0, 0)], [[0.3] * 3], device)
        leaves = Leaves(sphere, body_camera(size, False, device=device))
        loss, image = leaves.push_by_loss(target, gradient=gradient)
        assert loss.item() == (image.labels != label).sum()
        assert (sign * sphere.semi_axes.grad[0, 0, :2] > 0).all(), gradient
    corners, mesh = faces([[4.2, 4.3, 1], [11.7, 4.6, 1], [8.1, 12.4, 1]], [1], device)
    middle = corners.mean(1, keepdim=True)
    growth = torch.ones(1, device=device, requires_grad=True)
    loss, image = loss_on_screen(middle + growth * (corners - middle), mesh, target)
    loss.sum().backward()
    assert loss.item() == (image.labels != label).sum()
    assert (sign * growth.grad > 0).all()


def test_a_label_that_no_part_has(device):
    """Ellipsoids can't show it: each such pixel is missed, and what shows there is wrong. Meshes refuse it."""
    size = (16, 16)
    scene = one_scene((0, 0, 3), (0.5, 0.4, 0.3), False)
    target = torch.full((1, *size), 200, dtype=torch.uint8, device=device)
    for gradient in GRADIENTS:
        leaves = Leaves.of(scene, device=device)
        loss, image = leaves.push_by_loss(target, gradient=gradient)
        assert loss.item() == 16 * 16 + (image.labels > 0).sum()
        assert all_finite(leaves)
    with pytest.raises(ValueError, match="target: label 200"):
        loss_on_screen(*triangle(device), target)


# --- Sizes ----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_picture_of_8192_pixels_a_side(device):
    """Both renderers at places drawn at random, all borders' neighbourhoods aside; gradients stay finite."""
    size = (8192, 8192)
    parameters = body_parameters(1, device)
    camera = body_camera(size, False, device=device)
    posed = pose(**{name: value.requires_grad_() for name, value in parameters.items()})
    target = torch.zeros(1, *size, dtype=torch.uint8, device=device)
    target[:, 3000:4000, 3000:4000] = 5
    loss, image = ellipsoid_label_loss(posed, camera, target, gradient="edges")
    gradients = torch.autograd.grad(loss.sum(), list(parameters.values()), retain_graph=True)
    assert all(torch.isfinite(gradient).all() for gradient in gradients)
    rng = np.random.default_rng(0)
    rows, columns = rng.integers(0, 8192, (2, 40_000))
    scene = scene_of(posed, camera)
    parts = []
    for off in (-0.05, 0.0, 0.05):
        depths = ellipsoid_reference.fronts(scene, columns + 0.5 + off, rows + 0.5 - off)
        parts.append(np.where(np.isfinite(depths.min(0)), depths.argmin(0) + 1, 0))
    sure = (parts[0] == parts[1]) & (parts[1] == parts[2])
    have = image.parts[0, torch.from_numpy(rows).to(device), torch.from_numpy(columns).to(device)].cpu().numpy()
    assert (parts[1][sure] > 0).sum() > 1000
    np.testing.assert_array_equal(have[sure], parts[1][sure])
    del image
    vertices = camera.project(posed.vertices(0))
    loss, picture = loss_on_screen(vertices, ellipbody_mesh(0, device=device), target)
    (gradient,) = torch.autograd.grad(loss.sum(), vertices)
    assert torch.isfinite(gradient).all()
    meshes = picture.labels[0, torch.from_numpy(rows).to(device), torch.from_numpy(columns).to(device)].cpu().numpy()
    assert (meshes == parts[1]).mean() > 0.97  # twenty faces an ellipsoid
