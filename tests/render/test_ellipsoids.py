"""Exact ellipsoids against the float64 reference: pictures, PartDR's rule, and what holds for every gradient."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from helpers.pictures import (
    CAMERAS,
    GRADIENTS,
    GROUPS,
    Intrinsics,
    Leaves,
    body_camera,
    body_parameters,
    body_scene,
    draw_on_screen,
    noisy_target,
    random_scene,
    relative_error,
    upright,
)

from warp_partdr import label_set
from warp_partdr.body.posing import pose
from warp_partdr.kernels.labels import IGNORE
from warp_partdr.reference import ellipsoids as reference
from warp_partdr.reference.losses import label_gradient
from warp_partdr.render.ellipsoids import Ellipsoids, draw_ellipsoids, ellipsoid_label_loss
from warp_partdr.render.part_mesh import ellipbody_mesh

SMALL = [(21, 34), (30, 17)]
DISTINCT = np.array([3, 1, 255, 5, 2, 4])  # each of one ellipsoid, in another order than theirs
LSP6 = np.asarray(label_set("lsp6").part_groups[1:])
# --- Forward -----------------------------------------------------------------------------------------------------

# Where float32 may differ from double: |margin| is how far a ray passes inside or outside, as a share of the ellipsoid.


MARGIN, LEAD = 1e-5, 1e-5  # [1], [m]


def check_picture(image, scene, size, b=0):
    labels, parts, depth = reference.ray_cast(scene, size)
    margin, lead = reference.doubt(scene, size)
    sure = (margin > MARGIN) & (lead > LEAD)
    assert (~sure).sum() <= 1e-3 * sure.size + 2
    np.testing.assert_array_equal(image.parts[b].cpu().numpy()[sure], parts[sure])
    np.testing.assert_array_equal(image.labels[b].cpu().numpy()[sure], labels[sure])
    np.testing.assert_array_equal(np.isinf(image.depth[b].cpu().numpy())[sure], parts[sure] == 0)
    # A front's depth holds a root that is steep at the outline, where the margin goes to 0.
    shown = sure & (parts > 0)
    margins = [reference.meet(scene, k, *reference.pixel_centres(size))[0] for k in range(len(scene.centres))]
    own = np.take_along_axis(np.stack(margins), np.maximum(parts - 1, 0)[None], 0)[0][shown]
    error = np.abs(image.depth[b].cpu().numpy()[shown] - depth[shown])
    assert (error * np.sqrt(own)).max(initial=0.0) < 1e-6  # [m]


@pytest.mark.parametrize("perspective", CAMERAS)
@pytest.mark.parametrize("size", [*SMALL, (96, 112)])
def test_picture_is_the_reference(device, size, perspective):
    scenes = [random_scene(seed, size, perspective, labels=GROUPS) for seed in range(6)]
    image = Leaves.of(*scenes, device=device).draw(size, part_labels=GROUPS)
    assert (image.labels == 255).any()
    for b, scene in enumerate(scenes):
        check_picture(image, scene, size, b)


@pytest.mark.parametrize("perspective", CAMERAS)
@pytest.mark.parametrize("labels", [None, LSP6], ids=["parts", "groups"])
def test_picture_of_bodies_is_the_reference(device, labels, perspective):
    size = (160, 120)
    posed = pose(**body_parameters(3, device))
    image = draw_ellipsoids(posed, body_camera(size, perspective, device=device), size, part_labels=labels)
    check_picture(image, body_scene(3, size, perspective, device, labels), size)


@pytest.mark.parametrize("perspective", CAMERAS)
def test_meshes_approach_the_picture(device, perspective):
    size = (256, 256)
    posed, camera = pose(**body_parameters(1, device)), body_camera(size, perspective, device=device)
    exact = draw_ellipsoids(posed, camera, size).labels
    body = exact > 0
    agreement = []
    for level in range(4):
        points = camera.project(posed.vertices(level))
        mesh = ellipbody_mesh(level, device=device)
        labels = draw_on_screen(points, mesh, size, perspective=perspective).labels
        agreement.append((labels == exact)[body | (labels > 0)].float().mean().item())
    assert agreement == sorted(agreement)
    assert agreement[0] < 0.9
    assert agreement[3] > 0.995


def test_equal_depths_go_to_the_lower_index(device):
    twins = upright(np.zeros((3, 3)), np.full((3, 3), 0.5), device)
    image = draw_ellipsoids(twins, body_camera((20, 20), False, device=device), (20, 20), part_labels=[7, 5, 6])
    assert set(image.labels.unique().tolist()) == {0, 7}
    assert set(image.parts.unique().tolist()) == {0, 1}


# --- PartDR's rule -----------------------------------------------------------------------------------------------


def check_forces(leaves, want, b=0):
    have = leaves.gradients(b)
    for name in have:
        assert relative_error(have[name], getattr(want, name)) < 1e-4, name


@pytest.mark.parametrize("max_distance", [np.inf, 2.5])
@pytest.mark.parametrize("perspective", CAMERAS)
def test_partdr_gradient_of_maps_is_the_reference(device, perspective, max_distance):
    for seed, size in enumerate(SMALL):
        scenes = [random_scene(10 * seed + k, size, perspective, labels=GROUPS) for k in range(2)]
        leaves = Leaves.of(*scenes, device=device)
        options = {"max_distance": max_distance, "depth_weight": 0.7}
        g = torch.randn((2, 4, *size), generator=torch.Generator().manual_seed(seed))
        image = leaves.push_by_maps(g, part_labels=GROUPS, gradient="partdr", **options)
        for b, scene in enumerate(scenes):
            parts = image.parts[b].cpu().numpy()
            check_forces(leaves, reference.partdr_gradient(scene, parts, g[b].double().numpy(), **options), b)


@pytest.mark.parametrize("perspective", CAMERAS)
@pytest.mark.parametrize("labels", [None, LSP6], ids=["parts", "groups"])
def test_partdr_gradient_of_the_label_loss_is_the_reference_on_bodies(device, labels, perspective):
    size = (40, 32)
    scene = body_scene(3, size, perspective, device, labels)
    count = int(scene.labels.max())
    target = noisy_target(reference.ray_cast(scene, size)[0], count, 0)
    leaves = Leaves.of(scene, device=device)
    loss, image = leaves.push_by_loss(target, part_labels=labels, gradient="partdr")
    g = label_gradient(image.labels[0].cpu().numpy(), target, count)
    parts = image.parts[0].cpu().numpy()
    check_forces(leaves, reference.partdr_gradient(scene, parts, g))
    assert loss.item() == pytest.approx(np.abs(g).sum() / 2, rel=1e-5)


@pytest.mark.parametrize("max_distance", [np.inf, 2.5])
@pytest.mark.parametrize("labels", [GROUPS, DISTINCT], ids=["groups", "distinct"])
@pytest.mark.parametrize("perspective", CAMERAS)
def test_partdr_gradient_of_few_wrong_pixels_is_the_reference(device, perspective, labels, max_distance):
    """Lines and pixels outside of the wrong ones' extent are left out, but what hides without a label is not.

    Labels of one ellipsoid each are pushed pixel by pixel, without a walk.
    """
    size, count, pushed = (33, 44), int(labels[labels != IGNORE].max()), 0
    options = {"max_distance": max_distance, "depth_weight": 0.7}
    for seed in range(16):
        scene = random_scene(seed, size, perspective, labels=labels)
        drawn, generator = reference.ray_cast(scene, size)[0], np.random.default_rng(seed)
        target = np.where(drawn == IGNORE, 0, drawn).astype(np.uint8)
        row, column = generator.integers(0, 24, 2)
        target[row : row + 9, column : column + 12] = generator.integers(0, count + 1)
        target[row + 2, column : column + 3] = IGNORE
        leaves = Leaves.of(scene, device=device)
        _, image = leaves.push_by_loss(target, part_labels=labels, gradient="partdr", **options)
        g = label_gradient(image.labels[0].cpu().numpy(), target, count)
        want = reference.partdr_gradient(scene, image.parts[0].cpu().numpy(), g, **options)
        if want.centres.any():
            pushed += 1
            check_forces(leaves, want)
        else:
            assert not leaves.gradients(0)["centres"].any()
    assert pushed > 6


def test_of_hidden_twins_the_first_comes_forward(device):
    """Among equally deep ellipsoids of a hidden label, only the one with the lowest index gets the force along z."""
    size = (24, 24)
    bodies = upright([(0, 0, 0), (0, 0, 2), (0, 0, 2)], [[0.8] * 3, [0.4] * 3, [0.4] * 3], device)
    leaves = Leaves(bodies, body_camera(size, False, device=device))
    leaves.push_by_loss(np.full(size, 2), part_labels=[1, 2, 2], gradient="partdr")
    front, first, second = bodies.centres.grad[0, :, 2].tolist()
    assert first > 0  # descent brings it forward, to a smaller z
    assert front == pytest.approx(-first)
    assert second == 0


# --- What holds for every gradient -------------------------------------------------------------------------------


@pytest.mark.parametrize("gradient", GRADIENTS)
@pytest.mark.parametrize("perspective", CAMERAS)
def test_gradients_reach_every_parameter(device, gradient, perspective):
    size = (64, 48)
    leaves = {name: value.requires_grad_() for name, value in body_parameters(1, device).items()}
    camera = body_camera(size, perspective, device=device)
    names = ("focal", "centre") if perspective else ("scale", "translation")
    numbers = {name: getattr(camera, name) for name in names}
    for value in numbers.values():
        value.requires_grad_()
    target = draw_ellipsoids(pose(**body_parameters(2, device)), camera, size).labels
    loss, _ = ellipsoid_label_loss(pose(**leaves), camera, target, gradient=gradient)
    loss.sum().backward()
    for name, leaf in {**leaves, **numbers}.items():
        assert torch.isfinite(leaf.grad).all(), name
        assert (leaf.grad != 0).any(), name


@pytest.mark.parametrize("gradient", GRADIENTS)
def test_gradients_are_linear_in_the_incoming_gradient(device, gradient):
    size = (30, 40)
    leaves = Leaves.of(random_scene(0, size, True), random_scene(1, size, True), device=device)
    maps = leaves.draw(size, num_maps=6, gradient=gradient).maps
    tensors = list(leaves.tensors().values())
    g, h = torch.randn(2, *maps.shape, generator=torch.Generator().manual_seed(0)).to(device)
    of = [torch.autograd.grad(maps, tensors, seen, retain_graph=True) for seen in (g, h, 2 * g - 3 * h)]
    for first, second, both in zip(*of, strict=True):
        torch.testing.assert_close(both, 2 * first - 3 * second, rtol=1e-4, atol=1e-4 * both.abs().max().item())


@pytest.mark.parametrize("gradient", GRADIENTS)
def test_ignored_pixels_cost_nothing(device, gradient):
    size = (40, 40)
    leaves = Leaves.of(body_scene(4, size, False, device), device=device)
    loss, _ = leaves.push_by_loss(np.full(size, 255), gradient=gradient)
    assert loss.item() == 0
    assert all((tensor.grad == 0).all() for tensor in leaves.tensors().values())


@pytest.mark.parametrize("gradient", GRADIENTS)
@pytest.mark.parametrize(("batch", "count", "size"), [(0, 20, (20, 24)), (1, 1, (1, 1)), (1, 255, (32, 32))])
def test_the_smallest_and_largest_sizes_are_drawn(device, gradient, batch, count, size):
    scene = random_scene(0, size, False, count=count)
    tensors = Leaves.of(scene, device=device).tensors()
    *parts, camera = (tensor.detach()[:batch].requires_grad_() for tensor in tensors.values())
    leaves = Leaves(Ellipsoids(*parts), Intrinsics(camera, False))
    _, image = leaves.push_by_loss(np.ones((batch, *size)), gradient=gradient)
    assert image.labels.shape == (batch, *size)
    for name, tensor in leaves.tensors().items():
        assert tensor.grad.shape == tensor.shape, name
        assert torch.isfinite(tensor.grad).all()
    if batch:
        check_picture(image, scene, size)


def test_groups_are_unions(device):
    """Two ellipsoids of one label, one inside the other's picture: its outline bounds nothing and gets no gradient."""
    size = (32, 32)
    target = np.zeros(size)
    target[10:, 12:] = 1
    for gradient in GRADIENTS:
        bodies = upright([(0, 0, 0), (0, 0, -1)], [[0.6] * 3, [0.2] * 3], device)
        leaves = Leaves(bodies, body_camera(size, False, device=device))
        leaves.push_by_loss(target, part_labels=[1, 1], gradient=gradient)
        assert (bodies.centres.grad[0, 1] == 0).all()
        assert (bodies.centres.grad[0, 0, :2] != 0).all()
