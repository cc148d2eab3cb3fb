"""The "coverage" gradient against the derivative of covered area in float64, and "edges", which samples it.

The derivative is held to differences of area, and "edges" to its definition as well.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers.pictures import (
    CAMERAS,
    GROUPS,
    Intrinsics,
    Leaves,
    body_camera,
    body_parameters,
    body_scene,
    float32,
    gradient_errors,
    noisy_target,
    random_scene,
    relative_error,
    scene_of,
    smooth_maps,
    turn_gradient,
    upright,
)

from warp_partdr.body.posing import pose
from warp_partdr.cameras import WeakPerspective
from warp_partdr.reference import coverage
from warp_partdr.reference import ellipsoids as reference
from warp_partdr.reference.edges import edges_gradient
from warp_partdr.render.ellipsoids import ellipsoid_label_loss


def apart(scene):
    """Each one is behind the other, so that no two meet in space: outlines bound everything."""
    way = np.arange(len(scene.centres))[:, None] * (0.0, 0.0, 0.7)
    if not scene.perspective:
        return replace(scene, centres=float32(scene.centres + way))
    centres = scene.centres + way
    return replace(
        scene, centres=float32(centres * centres[:, 2:] / scene.centres[:, 2:] * (1, 1, 0) + (0, 0, 1) * centres)
    )


def axes_gradient(axes, grad_turns):
    """A gradient of axes whose ``turn_gradient`` this is: half of skew(grad_turns) times the axes."""
    return 0.5 * np.cross(grad_turns[:, None], axes.transpose(0, 2, 1)).transpose(0, 2, 1)


FINE = {"samples_per_pixel": 32.0}


def check_coverage(scene, maps, device, lines, within, camera_within=None, **options):
    """Relative error of each parameter's gradient through the maps.

    What moves the whole picture leaves little: the forces on opposite sides of each ellipsoid nearly cancel. So the
    camera may be off by more.
    """
    leaves = Leaves.of(scene, device=device)
    leaves.push_by_maps(maps, part_labels=scene.labels, **options)
    errors = gradient_errors(scene, leaves, coverage.coverage_gradient(scene, coverage.dense_costs(maps), lines))
    assert errors.pop("camera") < (camera_within or within)
    assert max(errors.values()) < within


TWO_ALIKE = np.array([1, 2, 3, 4, 5, 2])


@pytest.mark.parametrize("perspective", CAMERAS)
@pytest.mark.parametrize("seed", [0, 1])
def test_gradient_of_outlines_is_that_of_area(device, seed, perspective):
    size = (96, 112)
    scene = apart(random_scene(seed, size, perspective, labels=TWO_ALIKE))
    for options in (FINE, {}):
        check_coverage(scene, smooth_maps(seed, 5, size), device, 16, 0.004, 0.01, **options)


@pytest.mark.parametrize("perspective", CAMERAS)
def test_gradient_of_a_bodys_outlines_is_that_of_area(device, perspective):
    size = (112, 96)
    scene = apart(body_scene(0, size, perspective, device))
    check_coverage(scene, smooth_maps(0, 20, size), device, 48, 0.005, 0.03, **FINE)


@pytest.mark.parametrize("perspective", CAMERAS)
@pytest.mark.parametrize("seed", [0, 1])
def test_gradient_of_creases_is_that_of_area(device, seed, perspective):
    size = (96, 112)
    scene = random_scene(seed, size, perspective, labels=TWO_ALIKE)
    check_coverage(scene, smooth_maps(seed, 5, size), device, 64, 0.005, **FINE)


@pytest.mark.parametrize("perspective", CAMERAS)
def test_gradient_of_bodies_cut_by_the_border_is_that_of_area(device, perspective):
    """Outlines and creases run off the picture on all sides; what lies outside costs nothing."""
    size = (48, 56)
    scene = random_scene(2, size, perspective)
    scene = replace(scene, camera=scene.camera * (4, 4, 1, 1))
    labels = reference.ray_cast(scene, size)[0]
    assert all(len(set(edge) - {0}) > 1 for edge in (labels[0], labels[-1], labels[:, 0], labels[:, -1]))
    check_coverage(scene, smooth_maps(3, 6, size), device, 64, 0.005, **FINE)


@pytest.mark.parametrize("perspective", CAMERAS)
@pytest.mark.parametrize("seed", [0, 1, 16, 19])  # 1, 16, 19: creases along an outline, slivers, spikes
def test_gradient_of_a_body_is_that_of_area(device, seed, perspective):
    """The label loss of random bodies, down to the numbers that pose them."""
    size = (112, 96)
    leaves = {name: value.requires_grad_() for name, value in body_parameters(seed, device).items()}
    posed = pose(**leaves)
    camera = Intrinsics(body_camera(size, perspective, device=device).intrinsics.requires_grad_(), perspective)
    scene = scene_of(posed, camera)
    target = noisy_target(reference.ray_cast(scene, size)[0], 20, seed)
    wanted = coverage.coverage_gradient(scene, coverage.target_costs(target, 20), 64)
    ellipsoids = {"centres": posed.centres, "axes": posed.axes, "semi_axes": posed.semi_axes}
    forces = (wanted["centres"], axes_gradient(scene.axes, wanted["turns"]), wanted["semi_axes"])
    forces = [torch.tensor(force, dtype=torch.float32, device=device)[None] for force in forces]
    through_pose = torch.autograd.grad(list(ellipsoids.values()), list(leaves.values()), forces, retain_graph=True)
    want = dict(zip(ellipsoids, forces, strict=True)) | dict(zip(leaves, through_pose, strict=True))
    want["camera"] = torch.tensor(wanted["camera"])[None]
    tensors = ellipsoids | leaves | {"camera": camera.intrinsics}

    def errors(**options):
        target_image = torch.from_numpy(target).to(device)[None]
        loss, _ = ellipsoid_label_loss(posed, camera, target_image, **options)
        have = torch.autograd.grad(loss.sum(), list(tensors.values()), retain_graph=True)
        found = {}
        for (name, tensor), gradient in zip(tensors.items(), have, strict=True):
            values, both = tensor.detach()[0].cpu().numpy(), (gradient[0], want[name][0])
            both = [one.cpu().numpy().astype(float) for one in both]
            if values.shape[-2:] == (3, 3):  # of a rotation, what turns it
                both = [turn_gradient(values.reshape(-1, 3, 3), one.reshape(-1, 3, 3)) for one in both]
            found[name] = relative_error(*both)
        return found

    assert max(errors(**FINE).values()) < 0.01
    assert max(errors(samples_per_pixel=4.0).values()) < 0.025
    assert max(errors().values()) < 0.1


@pytest.mark.parametrize("perspective", CAMERAS)
def test_coverage_gradient_of_the_label_loss_is_that_of_area(device, perspective):
    """Costs that jump from pixel to pixel along a border: looser than with smooth maps."""
    size = (96, 112)
    scene = apart(random_scene(2, size, perspective, labels=GROUPS))
    target = reference.ray_cast(replace(scene, centres=scene.centres + np.array([0.03, -0.04, 0])), size)[0]
    target[20:30, 40:60] = 255
    leaves = Leaves.of(scene, device=device)
    leaves.push_by_loss(target, part_labels=GROUPS, **FINE)
    want = coverage.coverage_gradient(scene, coverage.target_costs(target, 4), 32)
    errors = gradient_errors(scene, leaves, want)
    assert errors.pop("camera") < 0.05
    assert max(errors.values()) < 0.01


@pytest.mark.parametrize("perspective", CAMERAS)
def test_the_reference_is_the_derivative_of_area(perspective):
    """The reference's sum over borders against differences of the area itself, along random directions."""
    size = (48, 56)
    scene = random_scene(1, size, perspective, labels=TWO_ALIKE)
    costs = coverage.dense_costs(np.ones((5, *size)) * np.linspace(-1, 1, 5)[:, None, None])  # no kinks at pixels
    gradients = coverage.coverage_gradient(scene, costs, 64)
    rng = np.random.default_rng(0)
    for name in coverage.NAMES:
        for _ in range(2):
            way = rng.normal(size=gradients[name].shape) * (0.01 if name != "camera" else 0.3)
            both = []
            for sign in (0.5, -0.5):
                there = scene
                for index in np.ndindex(way.shape):
                    there = coverage.moved(there, name, index, sign * way[index])
                both.append(coverage.area_cost(there, costs, 64))
            assert both[0] - both[1] == pytest.approx((way * gradients[name]).sum(), rel=0.03, abs=0.05)


# --- Edges -----------------------------------------------------------------------------------------------------------


def shares_of_error(scene, leaves, image, costs):
    """The error of each gradient is a share of the sum of its terms."""
    want, sizes = edges_gradient(scene, image.parts[0].cpu().numpy(), costs)
    have = leaves.gradients()
    have["turns"] = turn_gradient(scene.axes, have.pop("axes"))
    return [np.linalg.norm(have[name] - want[name]) / np.linalg.norm(sizes[name]) for name in want]


@pytest.mark.parametrize("perspective", CAMERAS)
@pytest.mark.parametrize("size", [(21, 34), (32, 24)])  # in bytes, and four pixels a word
def test_gradient_of_maps_is_its_definition(device, size, perspective):
    found = []
    for seed in range(3):
        scene = random_scene(seed, size, perspective, labels=GROUPS)
        maps = smooth_maps(seed, 4, size)
        leaves = Leaves.of(scene, device=device)
        image = leaves.push_by_maps(maps, part_labels=GROUPS, gradient="edges")
        found += shares_of_error(scene, leaves, image, coverage.dense_costs(maps))
    # Where a front is steep next to its outline, float32 knows its slope to a few percent.
    assert np.median(found) < 1e-3
    assert max(found) < 3e-2


@pytest.mark.parametrize("perspective", CAMERAS)
def test_gradient_of_the_label_loss_is_its_definition(device, perspective):
    size = (48, 40)
    scene = body_scene(3, size, perspective, device)
    target = noisy_target(reference.ray_cast(scene, size)[0], 20, 0)
    leaves = Leaves.of(scene, device=device)
    _, image = leaves.push_by_loss(target, gradient="edges")
    assert max(shares_of_error(scene, leaves, image, coverage.target_costs(target, 20))) < 2e-3


@pytest.mark.parametrize("perspective", CAMERAS)
def test_gradient_approaches_that_of_area(device, perspective):
    """A finer picture of the same scene with the same costs: its lines sample borders more densely."""
    mean = []
    for scale in (1, 4):
        found = []
        for seed in range(3):
            scene = random_scene(seed, (40, 48), perspective, labels=TWO_ALIKE)
            scene = replace(scene, camera=scene.camera * scale)
            maps = smooth_maps(seed, 5, (40, 48)).repeat(scale, 1).repeat(scale, 2)
            leaves = Leaves.of(scene, device=device)
            leaves.push_by_maps(maps, part_labels=scene.labels, gradient="edges")
            want = coverage.coverage_gradient(scene, coverage.dense_costs(maps), 16)
            relative = gradient_errors(scene, leaves, want)
            found.append([relative[name] for name in ("centres", "turns", "semi_axes")])
        mean.append(np.mean(found, 0))
    assert (mean[0] < 0.2).all()
    assert (mean[1] < 0.5 * mean[0]).all()


def test_a_part_between_pixel_centres_has_no_gradient(device):
    """It shows nowhere; what walks outlines still sees it."""
    camera = WeakPerspective(torch.ones(1, device=device), torch.full((1, 2), 4.0, device=device))
    target = np.tile([0, 0, 0, 0, 1, 1, 1, 1], (8, 1))  # the right half wants it
    found = {}
    for gradient in ("edges", "coverage"):
        thin = Leaves(upright([(0, 0, 0)], [(0.3, 3.0, 0.3)], device), camera)
        _, image = thin.push_by_loss(target, gradient=gradient)
        assert not image.labels.any()
        found[gradient] = thin.ellipsoids.centres.grad[0, 0, 0].item()
    assert found["edges"] == 0
    assert found["coverage"] < 0
