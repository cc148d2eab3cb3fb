"""Extreme ellipsoids are drawn right and have finite, right gradients: needles, dust, walls, a million pixels off."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes.pictures import (
    CAMERAS,
    GRADIENTS,
    Intrinsics,
    Leaves,
    all_finite,
    body_camera,
    check_ellipsoid_picture,
    checked_target,
    float32,
    gradient_errors,
    one_scene,
    random_scene,
    relative_error,
    smooth_maps,
    upright,
)
from scipy.spatial.transform import Rotation

from warp_partdr.reference import coverage
from warp_partdr.reference import ellipsoids as reference

SIZE = (24, 32)
few = settings(max_examples=25, derandomize=True, deadline=None)


def exponents(low, high):
    return st.floats(low, high, allow_nan=False).map(lambda exponent: 10.0**exponent)


@st.composite
def ellipsoid_scenes(draw):
    """Needles, discs, dust and walls, a hand's breadth or 10 km away, seen as less than a pixel or as thousands."""
    perspective = draw(st.booleans())
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    count = draw(st.integers(1, 4))
    large = draw(exponents(-3, 3))  # [m]
    thin = np.array(draw(st.lists(exponents(-6, 0), min_size=count, max_size=count)))
    semi_axes = large * np.where(rng.random((count, 3)) < 0.4, thin[:, None], rng.uniform(0.3, 1, (count, 3)))
    radius = draw(exponents(-0.5, 3.5))  # [px]
    distance = max(draw(exponents(-1, 4)), 2 * large) if perspective else 0.0  # [m]
    scale = radius / large * (distance if perspective else 1.0)
    spread = min(large, 10 * large / radius)  # so that some of it is in the picture
    centres = rng.normal(size=(count, 3)) * (spread, spread, 0.5 * large) + (0, 0, distance)
    axes = Rotation.random(count, rng=rng).as_matrix()
    camera = (scale, scale * rng.uniform(0.8, 1.25), SIZE[1] / 2 + 1.3, SIZE[0] / 2 - 0.7)
    numbers = map(float32, (centres, axes, semi_axes, camera))
    near = 0.01 if perspective else -np.inf
    return reference.EllipsoidScene(*numbers, np.arange(1, count + 1), perspective, near)


def ellipsoid_results(scene, target, gradient, device, size=SIZE):
    """Loss, picture and leaves with the gradient of the label loss, and of maps in a second set of leaves."""
    through_labels, through_maps = (Leaves.of(scene, device=device) for _ in range(2))
    options = {"part_labels": scene.labels.tolist(), "gradient": gradient}
    loss, image = through_labels.push_by_loss(target, **options)
    maps = through_maps.draw(size, num_maps=max(scene.labels), **options).maps
    wanted = target[:, None] == torch.arange(1, maps.shape[1] + 1, device=device)[:, None, None]
    (maps - wanted.float()).square().sum().backward()
    return loss, image, through_labels, through_maps


@few
@given(scene=ellipsoid_scenes())
def test_any_ellipsoids_are_drawn_right_and_have_finite_gradients(device, scene):
    target = checked_target(SIZE, len(scene.labels), device)
    for gradient in GRADIENTS:
        loss, image, *leaves = ellipsoid_results(scene, target, gradient, device)
        check_ellipsoid_picture(image, scene, SIZE)
        wrong = image.labels != target
        assert loss.item() == ((image.labels > 0) & wrong).sum() + ((target > 0) & wrong).sum()
        assert all(map(all_finite, leaves)), gradient


EDGE_ON = (0.0, np.pi / 2, 0.0)
EXTREME_SCENES = {
    "needle": ((0, 0, 3), (1e-6, 0.5, 0.5), {"turn": (0.3, 0.5, 0.2)}),
    "disc": ((0, 0, 3), (0.5, 0.5, 1e-6), {"turn": (0.4, 0.3, 0.0)}),
    "thin disc": ((0, 0, 3), (0.5, 0.5, 1e-4), {"turn": (0.4, 0.3, 0.0)}),
    "edge-on disc": ((0, 0, 3), (0.5, 0.5, 1e-6), {"turn": EDGE_ON}),
    "point": ((0, 0, 3), (1e-6, 1e-6, 1e-6), {}),
    "rod": ((0, 0, 3), (1e3, 0.1, 0.1), {"turn": (0.0, 0.0, 0.5)}),
    "wall": ((0, 0, 3), (1e3, 1e3, 0.1), {}),
    "across the camera": ((0, 0, 0.2), (0.5, 0.5, 0.5), {}),
    "around the camera": ((0, 0, 0), (5.0, 5.0, 5.0), {}),
    "behind the camera": ((0, 0, -3), (0.5, 0.5, 0.5), {}),
    "across the camera, its centre behind": ((0, 0.05, -0.2), (0.3, 0.3, 0.3), {}),
    "touching the camera": ((0, 0.05, 0.3), (0.3, 0.3, 0.3), {}),
    "touching the near plane": ((0, 0.05, 0.305), (0.3, 0.3, 0.3), {}),
    "10 km away": ((0, 0, 1e4), (0.5, 0.3, 0.2), {"focal": 1.5e5}),
    "0.1 m away": ((0, 0, 0.1), (0.03, 0.02, 0.01), {"focal": 30.0}),
    "a million pixels off": ((0, 0, 3), (0.5, 0.5, 0.5), {"middle": (1e6, 11.8)}),
    "a million pixels off both ways": ((0.1, 0, 3), (0.5, 0.3, 0.2), {"middle": (1e6, 1e6)}),
    "a million pixels large and off": ((0.1, 0, 3), (0.5, 0.3, 0.2), {"focal": 1e6, "middle": (1e6, 1e6)}),
    "a million pixels about a corner": ((0.1, 0, 3), (0.5, 0.3, 0.2), {"focal": 1e6, "middle": (0.0, 0.0)}),
    "a million pixels large": ((0, 0, 3), (0.5, 0.5, 0.5), {"focal": 6e6}),
    "a wire 10 km away, 2000 px thick": ((0, 0, 1e4), (0.5, 0.01, 0.01), {"focal": 1e9}),
    "askew, 4 px thick and 8000 long": (
        (0, 0, 3),
        (0.5, 2.5e-4, 2.5e-4),
        {"focal": 24000.0, "turn": (0.0, 0.0, 0.9), "middle": (16.3 - 1989.1, 11.8 - 2506.6)},
    ),
    "its outline, a million pixels off": ((-0.5, 0, 3), (0.5, 0.5, 0.5), {"focal": 2e6}),
    "100 km aside": ((1e5, -1e5, 3), (0.5, 0.5, 0.5), {}),
    "100 km aside and as large": ((1e5, 0, 3), (1e5, 0.5, 0.5), {}),
}


def extreme_scene(name, perspective):
    centre, semi_axes, options = EXTREME_SCENES[name]
    if not perspective and "focal" in options:
        options = {**options, "focal": options["focal"] / abs(centre[2])}
    return one_scene(centre, semi_axes, perspective, **options)


@pytest.mark.parametrize("gradient", GRADIENTS)
@pytest.mark.parametrize("perspective", CAMERAS)
@pytest.mark.parametrize("name", EXTREME_SCENES)
def test_extreme_ellipsoids_are_drawn_right(device, name, perspective, gradient):
    """And those that reach the camera are left out, without a gradient."""
    scene = extreme_scene(name, perspective)
    _, image, *leaves = ellipsoid_results(scene, checked_target(SIZE, 2, device), gradient, device)
    check_ellipsoid_picture(image, scene, SIZE)
    assert all(map(all_finite, leaves))
    for of_parts in (list(each.gradients().values())[:3] for each in leaves):
        assert all((values[~reference.drawable(scene)] == 0).all() for values in of_parts)


@pytest.mark.parametrize("perspective", CAMERAS)
@pytest.mark.parametrize("name", ["thin disc", "rod", "10 km away", "0.1 m away"])
def test_gradients_of_extreme_ellipsoids_are_the_references(device, name, perspective):
    scene = extreme_scene(name, perspective)
    maps = smooth_maps(0, 2, SIZE)
    have = {}
    for gradient in ("partdr", "coverage"):
        leaves = have[gradient] = Leaves.of(scene, device=device)
        fine = {"samples_per_pixel": 32.0} if gradient == "coverage" else {}
        image = leaves.push_by_maps(maps, gradient=gradient, **fine)
    forces = reference.partdr_gradient(scene, image.parts[0].cpu().numpy(), maps)
    for parameter, values in have["partdr"].gradients().items():
        assert relative_error(values, getattr(forces, parameter)) < 2e-3, parameter
    want = coverage.coverage_gradient(scene, coverage.dense_costs(maps), 64)
    assert max(gradient_errors(scene, have["coverage"], want).values()) < 0.03


@pytest.mark.parametrize("perspective", CAMERAS)
def test_near_plane(device, perspective):
    bodies = upright([(0.0, 0.0, 1.0)], [[0.3] * 3], device)
    intrinsics = body_camera(SIZE, perspective, device=device).intrinsics
    before, behind = (Leaves(bodies, Intrinsics(intrinsics, perspective, near)).draw(SIZE) for near in (0.69, 0.71))
    assert (before.labels == 1).any()
    assert (behind.labels == 0).all()


def test_unchecked_nonsense_is_not_drawn(device):
    """Without validation, an ellipsoid that is none leaves the others alone."""
    bodies = Leaves.of(random_scene(0, SIZE, False, count=4), device=device)
    with torch.no_grad():
        bodies.ellipsoids.centres[0, 0, 2] = np.nan
        bodies.ellipsoids.semi_axes[0, 1, 0] = 0.0
        bodies.ellipsoids.axes[0, 2] = np.nan
    assert set(bodies.draw(SIZE, validate=False).labels.unique().tolist()) == {0, 4}
