"""The "edges" gradient: against its definition in float64, and against the true derivative that it samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scenes.pictures import (
    CAMERAS,
    GROUPS,
    Leaves,
    body_scene,
    gradient_errors,
    noisy_target,
    random_scene,
    smooth_maps,
    turn_gradient,
    upright,
)

from warp_partdr.cameras import WeakPerspective
from warp_partdr.reference import coverage
from warp_partdr.reference import ellipsoids as reference
from warp_partdr.reference.edges import edges_gradient


def errors(scene, leaves, image, costs):
    """Of each gradient, as a share of what was added up for it."""
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
        found += errors(scene, leaves, image, coverage.dense_costs(maps))
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
    assert max(errors(scene, leaves, image, coverage.target_costs(target, 20))) < 2e-3


@pytest.mark.parametrize("perspective", CAMERAS)
def test_gradient_approaches_that_of_area(device, perspective):
    """A finer picture of the same scene with the same costs: its lines sample borders more densely."""
    mean = []
    for scale in (1, 4):
        found = []
        for seed in range(3):
            scene = random_scene(seed, (40, 48), perspective, labels=np.array([1, 2, 3, 4, 5, 2]))
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
