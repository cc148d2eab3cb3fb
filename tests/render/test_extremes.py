"""The extremes of docs/measured/stability.md: each gives a right, finite answer or a clear error, in both renderers.

"Right" is what the float64 references say, wherever no outline, crease or tie in depth is nearer than ``PLACE`` and
``LEAD``. What test_ellipsoids.py and test_mesh.py hold at ordinary sizes is not repeated here.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import torch
from helpers.pictures import (
    CAMERAS,
    GRADIENTS,
    PLACE,
    Intrinsics,
    Leaves,
    all_finite,
    body_camera,
    body_parameters,
    check_ellipsoid_picture,
    checked_target,
    draw_on_screen,
    faces,
    float32,
    gradient_errors,
    loss_on_screen,
    mesh_picture,
    mesh_scene,
    one_scene,
    push_on_screen,
    random_scene,
    relative_error,
    scene_of,
    smooth_maps,
    upright,
)
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from warp_partdr.body.posing import pose
from warp_partdr.reference import coverage
from warp_partdr.reference import ellipsoids as ellipsoid_reference
from warp_partdr.reference import mesh as mesh_reference
from warp_partdr.render.ellipsoids import ellipsoid_label_loss
from warp_partdr.render.mesh import mesh_label_loss
from warp_partdr.render.part_mesh import PartMesh, ellipbody_mesh

# --- Bodies at the camera -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("depth", "shows"), [(-3.0, False), (-0.5, False), (0.0, None), (0.2, True), (0.6, True), (1e4, False)]
)
def test_bodies_behind_across_and_around_the_camera_have_finite_gradients(device, depth, shows):
    """Ellipsoids in front of it are drawn, those that reach it are not, and no gradient is lost to infinity."""
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


# --- Equal depths, empty and full targets, labels outside the set ---------------------------------------------------


@pytest.mark.parametrize("perspective", CAMERAS)
def test_parts_at_one_depth_are_pushed_apart_equally(device, perspective):
    """The paper's log(1 / dz + 1) with dz = 0: bounded, and equal and opposite."""
    size, z = (16, 16), 2.0
    leaf, mesh = faces([[[1, 1, z], [14, 2, z], [5, 13, z]]] * 2, [1, 2], device)
    _, image = push_on_screen(leaf, mesh, torch.full((1, *size), 2, dtype=torch.uint8, device=device))
    pixels = (image.labels == 1).sum().item()
    bound = 2 * pixels * math.log(1 / mesh_reference.MIN_DELTA_Z + 1)
    front, back = leaf.grad[0, :3, 2], leaf.grad[0, 3:, 2]
    assert pixels > 0
    assert (back > 0).all()
    assert back.sum() <= 3 * bound
    torch.testing.assert_close(front, -back)

    twins = upright([(0, 0, z)] * 2, np.full((2, 3), 0.5), device)
    _, image = Leaves(twins, body_camera(size, perspective, device=device)).push_by_loss(
        np.full(size, 2), gradient="partdr"
    )
    push = (image.labels == 1).sum().item() * 2 * math.log(1 / mesh_reference.MIN_DELTA_Z + 1)
    assert twins.centres.grad[0, 1, 2].item() == pytest.approx(push, rel=1e-3 if not perspective else 1.0)
    assert torch.isfinite(twins.centres.grad).all()


@pytest.mark.parametrize("label", [0, 1])
def test_empty_targets_shrink_a_part_and_full_ones_grow_it(device, label):
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


def test_a_label_that_no_part_has_is_missed_at_each_of_its_pixels(device):
    """Ellipsoids can't show it: each such pixel is missed, and what shows there is wrong."""
    size = (16, 16)
    scene = one_scene((0, 0, 3), (0.5, 0.4, 0.3), False)
    target = torch.full((1, *size), 200, dtype=torch.uint8, device=device)
    for gradient in GRADIENTS:
        leaves = Leaves.of(scene, device=device)
        loss, image = leaves.push_by_loss(target, gradient=gradient)
        assert loss.item() == 16 * 16 + (image.labels > 0).sum()
        assert all_finite(leaves)


# --- Sizes ----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_picture_of_8192_pixels_a_side_is_drawn_right(device):
    """Places are drawn at random, without the neighbourhoods of all borders; gradients stay finite."""
    size = (8192, 8192)
    parameters = body_parameters(1, device)
    camera = body_camera(size, False, device=device)
    posed = pose(**{name: value.requires_grad_() for name, value in parameters.items()})
    target = torch.zeros(1, *size, dtype=torch.uint8, device=device)
    target[:, 3000:4000, 3000:4000] = 5
    loss, image = ellipsoid_label_loss(posed, camera, target, gradient="edges")
    gradients = torch.autograd.grad(loss.sum(), list(parameters.values()), retain_graph=True)
    assert all(torch.isfinite(gradient).all() for gradient in gradients)
    rows, columns = np.random.default_rng(0).integers(0, 8192, (2, 40_000))
    places = (0, *(torch.from_numpy(each).to(device) for each in (rows, columns)))
    scene = scene_of(posed, camera)
    parts = []
    for off in (-0.05, 0.0, 0.05):
        depths = ellipsoid_reference.fronts(scene, columns + 0.5 + off, rows + 0.5 - off)
        parts.append(np.where(np.isfinite(depths.min(0)), depths.argmin(0) + 1, 0))
    sure = (parts[0] == parts[1]) & (parts[1] == parts[2])
    have = image.parts[places].cpu().numpy()
    assert (parts[1][sure] > 0).sum() > 1000
    np.testing.assert_array_equal(have[sure], parts[1][sure])
    del image
    vertices = camera.project(posed.vertices(0))
    loss, picture = loss_on_screen(vertices, ellipbody_mesh(0, device=device), target)
    (gradient,) = torch.autograd.grad(loss.sum(), vertices)
    assert torch.isfinite(gradient).all()
    assert (picture.labels[places].cpu().numpy() == parts[1]).mean() > 0.97  # twenty faces an ellipsoid


# --- Ellipsoids: needles, dust, walls, a million pixels off ----------------------------------------------------------


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
    return ellipsoid_reference.EllipsoidScene(*numbers, np.arange(1, count + 1), perspective, near)


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
    """Those that reach the camera are left out, without a gradient."""
    scene = extreme_scene(name, perspective)
    _, image, *leaves = ellipsoid_results(scene, checked_target(SIZE, 2, device), gradient, device)
    check_ellipsoid_picture(image, scene, SIZE)
    assert all(map(all_finite, leaves))
    for of_parts in (list(each.gradients().values())[:3] for each in leaves):
        assert all((values[~ellipsoid_reference.drawable(scene)] == 0).all() for values in of_parts)


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
    forces = ellipsoid_reference.partdr_gradient(scene, image.parts[0].cpu().numpy(), maps)
    for parameter, values in have["partdr"].gradients().items():
        assert relative_error(values, getattr(forces, parameter)) < 2e-3, parameter
    want = coverage.coverage_gradient(scene, coverage.dense_costs(maps), 64)
    assert max(gradient_errors(scene, have["coverage"], want).values()) < 0.03


@pytest.mark.parametrize("perspective", CAMERAS)
def test_bodies_that_reach_the_near_plane_are_not_drawn(device, perspective):
    bodies = upright([(0.0, 0.0, 1.0)], [[0.3] * 3], device)
    intrinsics = body_camera(SIZE, perspective, device=device).intrinsics
    before, behind = (Leaves(bodies, Intrinsics(intrinsics, perspective, near)).draw(SIZE) for near in (0.69, 0.71))
    assert (before.labels == 1).any()
    assert (behind.labels == 0).all()


def test_unchecked_nonsense_is_not_drawn(device):
    """If numbers are not checked, an ellipsoid with impossible ones leaves the others alone."""
    bodies = Leaves.of(random_scene(0, SIZE, False, count=4), device=device)
    with torch.no_grad():
        bodies.ellipsoids.centres[0, 0, 2] = np.nan
        bodies.ellipsoids.semi_axes[0, 1, 0] = 0.0
        bodies.ellipsoids.axes[0, 2] = np.nan
    assert set(bodies.draw(SIZE, validate=False).labels.unique().tolist()) == {0, 4}


# --- Faces: points, needles, a million pixels wide -------------------------------------------------------------------


@st.composite
def grids_of_faces(draw):
    """Faces on a quarter-pixel grid, each at one depth: all float32 products are exact, so pictures must be equal.

    Corners fall on pixel centres and on one another, so there are points, needles, twins and shared edges.
    """
    count = draw(st.integers(1, 5))
    place = st.tuples(st.integers(-8, 56), st.integers(-8, 48))
    corners = draw(st.lists(place, min_size=3 * count, max_size=3 * count))
    depths = draw(st.lists(st.sampled_from([-1.0, 0.0, 1.0, 1.0, 2.0]), min_size=count, max_size=count))
    index = draw(st.lists(st.integers(0, 3 * count - 1), min_size=3 * count, max_size=3 * count))
    vertices = np.concatenate([np.array(corners) / 4, np.repeat(depths, 3)[:, None]], 1)
    # Some faces share corners, and so lie askew; the others have three of their own.
    shared = draw(st.integers(0, count))
    index[3 * shared :] = range(3 * shared, 3 * count)
    labels = draw(st.lists(st.integers(1, 3), min_size=count, max_size=count))
    return vertices.astype(np.float32), np.reshape(index, (-1, 3)), np.array(labels)


MESH_SIZE = (11, 13)


def rounding_decides(vertices, index):
    """True if an edge meets a scan line so near a pixel's centre that float32 may put it on the other side."""
    for face in index:
        for a, b in ((vertices[face[k]], vertices[face[(k + 1) % 3]]) for k in range(3)):
            for along, across in ((0, 1), (1, 0)):
                low, high = sorted((a[across], b[across]))
                lines = np.arange(np.ceil(low - 0.5), np.ceil(high - 0.5)) + 0.5
                share = (lines - a[across]) / (b[across] - a[across]) if low < high else lines[:0]
                place = (1 - share) * a[along] + share * b[along] - 0.5
                near = np.abs(place - np.round(place)) < 1e-4
                if (near & (share != share.astype(np.float32))).any():
                    return True
    return False


@few
@given(scene=grids_of_faces(), perspective=st.booleans())
def test_any_faces_are_drawn_right_and_pushed_right(device, scene, perspective):
    vertices, index, labels = scene
    mesh = PartMesh.from_faces(index, labels, device=device)
    g = np.random.default_rng(0).normal(size=(3, *MESH_SIZE)).astype(np.float32).astype(float)
    leaf = torch.from_numpy(vertices).to(device)[None].requires_grad_()
    image = draw_on_screen(leaf, mesh, MESH_SIZE, perspective=perspective, num_maps=3)
    (image.maps[0] * torch.tensor(g, dtype=torch.float32, device=device)).sum().backward()
    body, picture = mesh_scene(leaf[0], mesh, perspective), mesh_picture(image)
    want = mesh_reference.rasterize(body, MESH_SIZE)
    np.testing.assert_allclose(picture.depth, want.depth, rtol=1e-5, atol=1e-5)
    ties = picture.face_index != want.face_index  # of faces askew that meet: rounding decides
    np.testing.assert_array_equal(picture.labels[~ties], want.labels[~ties])
    assume(not rounding_decides(body.vertices, index))
    forces = mesh_reference.gradient(body, picture, g)
    have = leaf.grad[0].cpu().numpy()
    scale = max(np.abs(forces).max(), 1.0)
    np.testing.assert_allclose(have / scale, forces / scale, atol=2e-4)


@few
@given(
    seed=st.integers(0, 2**32 - 1),
    size=st.floats(-2, 6),
    thin=st.floats(-6, 0),
    depth=st.floats(-2, 4),
    perspective=st.booleans(),
)
def test_wild_faces_stay_finite_and_cover_what_they_should(device, seed, size, thin, depth, perspective):
    """Needles a millionth as wide as long, a hundredth of a pixel or a million of them."""
    rng = np.random.default_rng(seed)
    count, (height, width) = 4, MESH_SIZE
    way = rng.normal(size=(count, 2))
    across = np.stack([-way[:, 1], way[:, 0]], 1) * 10**thin
    middle = rng.uniform(0, 1, (count, 2)) * (width, height)
    places = middle[:, None] + 10**size * np.stack([way, -way + across, -way - across], 1)
    z = 10**depth * rng.uniform(1, 1.5, (count, 3, 1))
    leaf, mesh = faces(np.concatenate([places, z], 2), np.arange(1, count + 1), device)
    loss, image = push_on_screen(leaf, mesh, checked_target(MESH_SIZE, count, device), perspective=perspective)
    assert torch.isfinite(leaf.grad).all()
    assert torch.isfinite(loss).all()
    assert (torch.isfinite(image.depth) == (image.labels > 0)).all()
    # Moved by what float32 can't tell apart, the reference's picture must hold the kernel's.
    body = replace(mesh_scene(leaf[0], mesh, perspective), near=-np.inf)
    off = PLACE + 1e-6 * np.abs(body.vertices[..., :2]).max()
    moved = [replace(body, vertices=body.vertices + np.array(way)) for way in product(*[(-off, 0, off)] * 2, [0])]
    seen = [mesh_reference.rasterize(each, MESH_SIZE).labels for each in moved]
    sure = (np.array(seen) == seen[4]).all(0)
    sure &= np.diff(depths_of_faces(body), axis=0)[0] > 1e-4 * 10**depth
    np.testing.assert_array_equal(image.labels[0].cpu().numpy()[sure], seen[4][sure])


def depths_of_faces(body):
    """Each pixel has the depths of its two nearest faces, inf where there are fewer, (2, H, W)."""
    depths = [mesh_reference.face_index_map(replace(body, faces=face[None]), MESH_SIZE)[1] for face in body.faces]
    nearest = np.sort(depths, 0)[:2]
    return np.where(np.isfinite(nearest), nearest, (np.full((2, 1, 1), 1e30) * [[[1]], [[2]]]))


EXTREME_FACES = {  # corners (x, y, z), and how many pixels of 12 x 12 show something
    "a point": ([[5.5, 5.5, 1]] * 3, 0),
    "a line": ([[1.5, 1.5, 1], [5.5, 5.5, 1], [9.5, 9.5, 2]], 0),
    "a needle": ([[0.5, 0.5, 1], [11.5, 11.5, 1], [11.5, 11.499, 1]], None),
    "a million pixels wide": ([[-1e6, -1e6, 1], [1e6, -1e6, 1], [0, 1e6, 1.5]], 144),
    "a million pixels off": ([[1e6, 1e6, 1], [1e6 + 9, 1e6, 1], [1e6, 1e6 + 9, 1]], 0),
    "at depth 0": ([[1, 1, 0], [11, 1, 0], [1, 11, 0]], None),
    "10 km away": ([[1, 1, 1e4], [11, 1, 1e4], [1, 11, 1.0001e4]], None),
}


@pytest.mark.parametrize("perspective", CAMERAS)
@pytest.mark.parametrize("name", EXTREME_FACES)
def test_extreme_faces_are_drawn_as_the_reference_draws_them(device, name, perspective):
    corners, shows = EXTREME_FACES[name]
    leaf, mesh = faces(corners, [1], device)
    target = checked_target((12, 12), 1, device)
    loss, image = push_on_screen(leaf, mesh, target, perspective=perspective)
    want = mesh_reference.rasterize(mesh_scene(leaf[0], mesh, perspective), (12, 12))
    np.testing.assert_array_equal(image.labels[0].cpu().numpy(), want.labels)
    np.testing.assert_allclose(image.depth[0].cpu().numpy(), want.depth, rtol=1e-5)
    assert shows is None or (image.labels > 0).sum() == shows
    assert torch.isfinite(leaf.grad).all()
    assert loss.item() == (image.labels != target).sum()
