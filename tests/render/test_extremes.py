"""The extremes of docs/stability.md: each gives a right, finite answer or a clear error, in both renderers.

"Right" is what the float64 references say, wherever no outline, crease or tie in depth is nearer than ``PLACE`` and
``LEAD``. What test_ellipsoids.py and test_render.py hold at ordinary sizes is not repeated here.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scenes import draw_on_screen, loss_on_screen
from scipy.spatial.transform import Rotation
from test_ellipsoids import (
    CAMERAS,
    GRADIENTS,
    Intrinsics,
    Leaves,
    body_camera,
    body_parameters,
    float32,
    gradient_errors,
    relative_error,
    scene_of,
    smooth_maps,
)

from warp_partdr.body.posing import pose
from warp_partdr.body.rotations import rotation_from_axis_angle
from warp_partdr.cameras import Crop, Perspective, WeakPerspective
from warp_partdr.reference import coverage
from warp_partdr.reference import ellipsoids as ellipsoid_reference
from warp_partdr.reference import mesh as reference
from warp_partdr.render.ellipsoids import Ellipsoids, draw_ellipsoids, ellipsoid_label_loss
from warp_partdr.render.mesh import draw_mesh, mesh_label_loss
from warp_partdr.render.part_mesh import PartMesh, ellipbody_mesh

PLACE = 0.01  # [px] that an outline may be off, and of coordinates beyond the picture PLACE_SHARE more
PLACE_SHARE = 3e-7
LEAD = 3e-6  # of the depth: surfaces nearer to one another than that may change places
SIZE = (24, 32)

few = settings(max_examples=25, derandomize=True, deadline=None)


# --- Exact ellipsoids: drawn extremes -------------------------------------------------------------------------------


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


def sure_pixels(scene, size):
    """Where the reference's picture stays the same when it is moved by ``PLACE`` any way, and depths by ``LEAD``."""
    with np.errstate(all="ignore"):
        parts = ellipsoid_reference.ray_cast(scene, size)[1]
        means = ellipsoid_reference.boxes(scene)[ellipsoid_reference.drawable(scene)]
        off = PLACE + PLACE_SHARE * np.abs(means[np.isfinite(means)]).max(initial=0.0)
        depths = np.sort(ellipsoid_reference.fronts(scene, *ellipsoid_reference.pixel_centres(size)), 0)
        sure = np.ones(size, dtype=bool)
        if len(depths) > 1:
            sure &= ~(depths[1] - depths[0] <= LEAD * np.abs(depths[0]).clip(min=scene.semi_axes.max()))
        for x in (-off, 0, off):
            for y in (-off, 0, off):
                moved = replace(scene, camera=scene.camera + np.array([0, 0, x, y]))
                sure &= ellipsoid_reference.ray_cast(moved, size)[1] == parts
    return sure


def check_ellipsoid_picture(image, scene, size):
    with np.errstate(all="ignore"):
        _, parts, depth = ellipsoid_reference.ray_cast(scene, size)
    sure = sure_pixels(scene, size)
    np.testing.assert_array_equal(image.parts[0].cpu().numpy()[sure], parts[sure])
    shown = sure & (parts > 0)
    have = image.depth[0].cpu().numpy()
    assert np.isinf(have[sure & (parts == 0)]).all()
    # A front is steep next to its outline: there a hundredth of a pixel is much depth.
    steep = np.zeros(size)
    for way in ((0, 0, PLACE, 0), (0, 0, 0, PLACE)):
        with np.errstate(all="ignore"):
            there = ellipsoid_reference.ray_cast(replace(scene, camera=scene.camera + way), size)[2]
            steep = np.fmax(steep, np.abs(there - depth))
    allowed = LEAD * (np.abs(depth) + scene.semi_axes.max()) + 2 * steep
    assert (np.abs(have[shown] - depth[shown]) <= allowed[shown]).all()


def ellipsoid_results(scene, target, gradient, device, size=SIZE):
    """Loss, picture and leaves with the gradient of the label loss, and of maps in a second set of leaves."""
    through_labels, through_maps = (Leaves.of(scene, device=device) for _ in range(2))
    part_labels = scene.labels.tolist()
    loss, image = ellipsoid_label_loss(
        through_labels.ellipsoids, through_labels.camera, target, part_labels=part_labels, gradient=gradient
    )
    loss.sum().backward()
    maps = draw_ellipsoids(
        through_maps.ellipsoids,
        through_maps.camera,
        size,
        part_labels=part_labels,
        num_maps=max(part_labels),
        gradient=gradient,
    ).maps
    wanted = target[:, None] == torch.arange(1, maps.shape[1] + 1, device=device)[:, None, None]
    (maps - wanted.float()).square().sum().backward()
    return loss.detach(), image, through_labels, through_maps


def all_finite(leaves):
    return all(bool(torch.isfinite(tensor.grad).all()) for tensor in leaves.tensors().values())


def checked_target(size, count, device):
    """Every label in some tiles of 5 x 7 pixels."""
    rows, columns = np.mgrid[: size[0], : size[1]]
    return torch.from_numpy(((rows // 5 + 2 * (columns // 7)) % (count + 1)).astype(np.uint8)).to(device)[None]


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


def one_scene(centre, semi_axes, perspective, *, turn=(0.0, 0.0, 0.0), focal=20.0, middle=(16.3, 11.8)):
    """An ellipsoid and, behind its middle, a ball of half a metre."""
    centres = np.array([centre, np.add(centre, (0.3, 0.2, 1.0))])
    axes = np.stack([Rotation.from_rotvec(turn).as_matrix(), np.eye(3)])
    numbers = centres, axes, np.array([semi_axes, (0.5, 0.5, 0.5)]), (focal, focal, *middle)
    near = 0.01 if perspective else -np.inf
    return ellipsoid_reference.EllipsoidScene(*map(float32, numbers), np.array([1, 2]), perspective, near)


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
    "10 km away": ((0, 0, 1e4), (0.5, 0.3, 0.2), {"focal": 1.5e5}),
    "0.1 m away": ((0, 0, 0.1), (0.03, 0.02, 0.01), {"focal": 30.0}),
    "a million pixels off": ((0, 0, 3), (0.5, 0.5, 0.5), {"middle": (1e6, 11.8)}),
    "a million pixels large": ((0, 0, 3), (0.5, 0.5, 0.5), {"focal": 6e6}),
    "a wire 10 km away, 2000 px thick": ((0, 0, 1e4), (0.5, 0.01, 0.01), {"focal": 1e9}),
    "askew, 4 px thick and 8000 long": (
        (0, 0, 3),
        (0.5, 2.5e-4, 2.5e-4),
        {"focal": 24000.0, "turn": (0.0, 0.0, 0.9), "middle": (16.3 - 1989.1, 11.8 - 2506.6)},
    ),
    "its outline, a million pixels off": ((-0.5, 0, 3), (0.5, 0.5, 0.5), {"focal": 2e6}),
}


@pytest.mark.parametrize("gradient", GRADIENTS)
@pytest.mark.parametrize("perspective", CAMERAS)
@pytest.mark.parametrize("name", EXTREME_SCENES)
def test_extreme_ellipsoids_are_drawn_right(device, name, perspective, gradient):
    centre, semi_axes, options = EXTREME_SCENES[name]
    if not perspective and "focal" in options:
        options = {**options, "focal": options["focal"] / abs(centre[2])}
    scene = one_scene(centre, semi_axes, perspective, **options)
    _, image, *leaves = ellipsoid_results(scene, checked_target(SIZE, 2, device), gradient, device)
    check_ellipsoid_picture(image, scene, SIZE)
    assert all(map(all_finite, leaves))


@pytest.mark.parametrize("perspective", CAMERAS)
@pytest.mark.parametrize("name", ["thin disc", "rod", "10 km away", "0.1 m away"])
def test_gradients_of_extreme_ellipsoids_are_the_references(device, name, perspective):
    centre, semi_axes, options = EXTREME_SCENES[name]
    if not perspective and "focal" in options:
        options = {**options, "focal": options["focal"] / abs(centre[2])}
    scene = one_scene(centre, semi_axes, perspective, **options)
    maps = smooth_maps(0, 2, SIZE)
    have = {}
    for gradient in ("partdr", "coverage"):
        leaves = have[gradient] = Leaves.of(scene, device=device)
        fine = {"samples_per_pixel": 32.0} if gradient == "coverage" else {}
        image = draw_ellipsoids(leaves.ellipsoids, leaves.camera, SIZE, num_maps=2, gradient=gradient, **fine)
        (image.maps[0] * torch.tensor(maps, dtype=torch.float32, device=device)).sum().backward()
    forces = ellipsoid_reference.partdr_gradient(scene, image.parts[0].cpu().numpy(), maps)
    for parameter, values in have["partdr"].gradients().items():
        assert relative_error(values, getattr(forces, parameter)) < 2e-3, parameter
    want = coverage.coverage_gradient(scene, coverage.dense_costs(maps), 64)
    assert max(gradient_errors(scene, have["coverage"], want).values()) < 0.03


# --- Meshes: drawn extremes -----------------------------------------------------------------------------------------


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
    faces = np.arange(3 * count)
    faces[: 3 * shared] = index[: 3 * shared]
    labels = draw(st.lists(st.integers(1, 3), min_size=count, max_size=count))
    return vertices.astype(np.float32), faces.reshape(-1, 3), np.array(labels)


MESH_SIZE = (11, 13)


def rounding_decides(vertices, faces):
    """Whether an edge meets a scan line so near a pixel's centre that float32 may put it on the other side."""
    for face in faces:
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
    vertices, faces, labels = scene
    near = 0.01 if perspective else -np.inf
    mesh = PartMesh.from_faces(faces, labels, device=device)
    g = np.random.default_rng(0).normal(size=(3, *MESH_SIZE)).astype(np.float32).astype(float)
    leaf = torch.from_numpy(vertices).to(device)[None].requires_grad_()
    image = draw_on_screen(leaf, mesh, MESH_SIZE, perspective=perspective, num_maps=3)
    (image.maps[0] * torch.tensor(g, dtype=torch.float32, device=device)).sum().backward()
    shown, index, depth = (x[0].cpu().numpy() for x in (image.labels, image.face_index, image.depth))
    want = reference.rasterize(vertices.astype(float), faces, labels, MESH_SIZE, perspective=perspective, near=near)
    np.testing.assert_allclose(depth, want[2 - 1], rtol=1e-5, atol=1e-5)
    ties = index != want[2]  # of faces askew that meet: rounding decides
    assert np.isclose(depth[ties], want[1][ties], rtol=1e-5, atol=1e-5).all()
    np.testing.assert_array_equal(shown[~ties], want[0][~ties])
    assume(not rounding_decides(vertices.astype(float), faces))
    forces = reference.gradient(
        vertices.astype(float),
        faces,
        labels,
        shown,
        index,
        g,
        perspective=perspective,
        near=near,
        depth=depth,
    )
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
    vertices = np.concatenate([places, z], 2).reshape(1, -1, 3).astype(np.float32)
    faces, labels = np.arange(3 * count).reshape(-1, 3), np.arange(1, count + 1)
    mesh = PartMesh.from_faces(faces, labels, device=device)
    leaf = torch.from_numpy(vertices).to(device).requires_grad_()
    loss, image = loss_on_screen(leaf, mesh, checked_target(MESH_SIZE, count, device), perspective=perspective)
    loss.sum().backward()
    assert torch.isfinite(leaf.grad).all()
    assert torch.isfinite(loss).all()
    assert (torch.isfinite(image.depth) == (image.labels > 0)).all()
    # Moved by what float32 can't tell apart, the reference's picture must hold the kernel's.
    off = PLACE + 1e-6 * np.abs(vertices[..., :2]).max()
    seen = []
    for x in (-off, 0, off):
        for y in (-off, 0, off):
            moved = vertices[0].astype(float) + np.array([x, y, 0])
            seen.append(reference.rasterize(moved, faces, labels, MESH_SIZE, perspective=perspective)[0])
    sure = (np.array(seen) == seen[4]).all(0)
    sure &= np.diff(depths_of_faces(vertices[0].astype(float), faces, perspective), axis=0)[0] > 1e-4 * 10**depth
    np.testing.assert_array_equal(image.labels[0].cpu().numpy()[sure], seen[4][sure])


def depths_of_faces(vertices, faces, perspective):
    """Of each pixel's two nearest faces, inf where there are fewer, (2, H, W)."""
    depths = [reference.rasterize(vertices, face[None], [1], MESH_SIZE, perspective=perspective)[1] for face in faces]
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
def test_extreme_faces(device, name, perspective):
    corners, shows = EXTREME_FACES[name]
    leaf = torch.tensor([corners], dtype=torch.float32, device=device, requires_grad=True)
    mesh = PartMesh.from_faces(np.arange(3)[None], np.array([1]), device=device)
    target = checked_target((12, 12), 1, device)
    loss, image = loss_on_screen(leaf, mesh, target, perspective=perspective)
    loss.sum().backward()
    near = 0.01 if perspective else -np.inf
    want = reference.rasterize(
        leaf[0].detach().cpu().double().numpy(), np.arange(3)[None], [1], (12, 12), perspective=perspective, near=near
    )
    np.testing.assert_array_equal(image.labels[0].cpu().numpy(), want[0])
    np.testing.assert_allclose(image.depth[0].cpu().numpy(), want[1], rtol=1e-5)
    assert shows is None or (image.labels > 0).sum() == shows
    assert torch.isfinite(leaf.grad).all()
    assert loss.item() == (image.labels != target).sum()


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
    target = checked_target(size, 20, device)
    for gradient in GRADIENTS:
        posed = pose(**leaves)
        loss, image = ellipsoid_label_loss(posed, camera, target, gradient=gradient)
        check_ellipsoid_picture(image, scene_of(posed, camera), size)
        for gradients in torch.autograd.grad(loss.sum(), list(leaves.values())):
            assert torch.isfinite(gradients).all()
    mesh = ellipbody_mesh(1, device=device)
    vertices = pose(**leaves).vertices(1)
    loss, picture = mesh_label_loss(vertices, mesh, camera, target)
    shown = picture.face_index[0].unique()
    drawn = mesh.faces[shown[shown >= 0].long()].long()
    assert (vertices[0, :, 2][drawn] > 0.01).all()
    for gradients in torch.autograd.grad(loss.sum(), list(leaves.values())):
        assert torch.isfinite(gradients).all()
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
    triangle = [[1.0, 1.0, z], [14.0, 2.0, z], [5.0, 13.0, z]]
    leaf = torch.tensor([triangle + triangle], device=device, requires_grad=True)
    mesh = PartMesh.from_faces(np.arange(6).reshape(2, 3), np.array([1, 2]), device=device)
    loss, image = loss_on_screen(leaf, mesh, torch.full((1, *size), 2, dtype=torch.uint8, device=device))
    loss.sum().backward()
    pixels = (image.labels == 1).sum().item()
    bound = 2 * pixels * math.log(1 / reference.MIN_DELTA_Z + 1)
    front, back = leaf.grad[0, :3, 2], leaf.grad[0, 3:, 2]
    assert pixels > 0
    assert (back > 0).all()
    assert back.sum() <= 3 * bound
    torch.testing.assert_close(front, -back)

    centre = torch.tensor([[[0.0, 0.0, z]] * 2], device=device, requires_grad=True)
    twins = Ellipsoids(centre, torch.eye(3, device=device).expand(1, 2, 3, 3), torch.full_like(centre, 0.5).detach())
    camera = body_camera(size, perspective, device=device)
    loss, image = ellipsoid_label_loss(
        twins, camera, torch.full((1, *size), 2, dtype=torch.uint8, device=device), gradient="partdr"
    )
    loss.sum().backward()
    push = (image.labels == 1).sum().item() * 2 * math.log(1 / reference.MIN_DELTA_Z + 1)
    assert centre.grad[0, 1, 2].item() == pytest.approx(push, rel=1e-3 if not perspective else 1.0)
    assert torch.isfinite(centre.grad).all()


@pytest.mark.parametrize("label", [0, 1])
def test_empty_and_full_targets(device, label):
    """All background shrinks a part; one part everywhere grows it."""
    size = (16, 16)
    target = torch.full((1, *size), label, dtype=torch.uint8, device=device)
    sign = -1.0 if label else 1.0
    for gradient in GRADIENTS:
        semi_axes = torch.full((1, 1, 3), 0.3, device=device, requires_grad=True)
        ball = Ellipsoids(torch.zeros(1, 1, 3, device=device), torch.eye(3, device=device)[None, None], semi_axes)
        loss, image = ellipsoid_label_loss(ball, body_camera(size, False, device=device), target, gradient=gradient)
        loss.sum().backward()
        assert loss.item() == (image.labels != label).sum()
        assert (sign * semi_axes.grad[0, 0, :2] > 0).all(), gradient
    corners = torch.tensor([[[4.2, 4.3, 1.0], [11.7, 4.6, 1.0], [8.1, 12.4, 1.0]]], device=device)
    middle = corners.mean(1, keepdim=True)
    growth = torch.ones(1, device=device, requires_grad=True)
    mesh = PartMesh.from_faces(np.arange(3)[None], np.array([1]), device=device)
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
        loss, image = ellipsoid_label_loss(leaves.ellipsoids, leaves.camera, target, gradient=gradient)
        loss.sum().backward()
        assert loss.item() == 16 * 16 + (image.labels > 0).sum()
        assert all_finite(leaves)
    mesh = PartMesh.from_faces(np.arange(3)[None], np.array([1]), device=device)
    with pytest.raises(ValueError, match="target: label 200"):
        loss_on_screen(torch.ones(1, 3, 3, device=device), mesh, target)


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


def triangle(device="cpu"):
    vertices = torch.tensor([[[1.0, 1.0, 1.0], [6.0, 1.0, 1.0], [3.0, 6.0, 1.0]]], device=device)
    return vertices, PartMesh.from_faces(np.arange(3)[None], np.array([1]), device=device)


def ball(batch=1, device="cpu"):
    leaves = Ellipsoids(
        torch.tensor([[[0.0, 0.0, 3.0]]], device=device).expand(batch, -1, -1),
        torch.eye(3, device=device).expand(batch, 1, 3, 3),
        torch.full((batch, 1, 3), 0.5, device=device),
    )
    camera = WeakPerspective(torch.full((batch,), 8.0, device=device), torch.full((batch, 2), 4.0, device=device))
    return leaves, camera


@pytest.mark.parametrize("size", [(2**16, 2**16), (2**14, 2**14), (2**40, 1)])
def test_pictures_that_can_not_be_counted_are_refused(device, size):
    """Before anything is allocated."""
    with pytest.raises(ValueError, match="image_size: 1 pictures of"):
        draw_on_screen(*triangle(device), size)
    with pytest.raises(ValueError, match="image_size: 1 pictures of"):
        draw_ellipsoids(*ball(device=device), size)


def test_batches_that_can_not_be_counted_are_refused(device):
    """So many that what is not refused fails at once: no machine has the memory."""
    vertices, mesh = triangle(device)
    many, size = 2**20, (8192, 8192)
    target = torch.zeros(1, 1, 1, dtype=torch.uint8, device=device).expand(many, *size)
    calls = [
        lambda: draw_ellipsoids(*ball(many, device), size),
        lambda: ellipsoid_label_loss(*ball(many, device), target),
        lambda: draw_on_screen(vertices.expand(many, -1, -1), mesh, size),
        lambda: loss_on_screen(vertices.expand(many, -1, -1), mesh, target),
    ]
    for call in calls:
        with pytest.raises(ValueError, match=f"image_size: {many} pictures of"):
            call()


# --- Types ----------------------------------------------------------------------------------------------------------

HALVES = [torch.float16, torch.bfloat16, torch.float64]


@pytest.mark.parametrize("dtype", HALVES)
@pytest.mark.parametrize("gradient", GRADIENTS)
def test_other_types_give_what_float32_gives(device, gradient, dtype):
    scene = one_scene((0.1, 0, 3), (0.5, 0.4, 0.3), True)
    target = checked_target(SIZE, 2, device)
    found = []
    for kind in (dtype, torch.float32):
        tensors = [tensor.detach().to(dtype).to(kind) for tensor in Leaves.of(scene, device=device).tensors().values()]
        tensors = [tensor.requires_grad_() for tensor in tensors]
        loss, image = ellipsoid_label_loss(
            Ellipsoids(*tensors[:3]), Intrinsics(tensors[3], True), target, gradient=gradient
        )
        found.append((image.labels, *torch.autograd.grad(loss.sum(), tensors)))
    for have, want in zip(*found, strict=True):
        assert torch.equal(have, want.to(have.dtype))


@pytest.mark.parametrize("dtype", HALVES)
def test_other_types_of_vertices_give_what_float32_gives(device, dtype):
    vertices, mesh = triangle(device)
    target = checked_target((8, 8), 1, device)
    found = []
    for kind in (dtype, torch.float32):
        leaf = vertices.to(dtype).to(kind).requires_grad_()
        loss, image = loss_on_screen(leaf, mesh, target)
        found.append((image.labels, *torch.autograd.grad(loss.sum(), leaf)))
    for have, want in zip(*found, strict=True):
        torch.testing.assert_close(have, want.to(have.dtype))


# --- What is refused ------------------------------------------------------------------------------------------------

BAD_NUMBERS = [math.nan, math.inf, -math.inf, 1e300]


def spoiled(tensor, value):
    tensor = tensor.double().clone()
    tensor.view(-1)[-1] = value
    return tensor


@pytest.mark.parametrize("value", BAD_NUMBERS)
@pytest.mark.parametrize("name", ["centres", "axes", "semi_axes", "camera"])
def test_ellipsoids_that_are_no_numbers_are_named(device, name, value):
    ellipsoids, camera = ball(device=device)
    tensors = {name: getattr(ellipsoids, name).double() for name in ("centres", "axes", "semi_axes")}
    tensors["camera"] = camera.intrinsics.double()
    tensors[name] = spoiled(tensors[name], value)
    seen = Intrinsics(tensors.pop("camera"), False)
    target = torch.zeros(1, 8, 8, dtype=torch.uint8, device=device)
    for call in (draw_ellipsoids, ellipsoid_label_loss):
        with pytest.raises(ValueError, match=f"{name}: "):
            call(Ellipsoids(**tensors), seen, (8, 8) if call is draw_ellipsoids else target)


@pytest.mark.parametrize("value", BAD_NUMBERS)
def test_vertices_that_are_no_numbers_are_named(device, value):
    vertices, mesh = triangle(device)
    target = torch.zeros(1, 8, 8, dtype=torch.uint8, device=device)
    with pytest.raises(ValueError, match="vertices: "):
        draw_on_screen(spoiled(vertices, value), mesh, (8, 8))
    with pytest.raises(ValueError, match="vertices: "):
        loss_on_screen(spoiled(vertices, value), mesh, target)


@pytest.mark.parametrize("value", BAD_NUMBERS)
@pytest.mark.parametrize("name", ["global_orient", "translation", "rotations", "lengths", "thicknesses"])
def test_poses_that_are_no_numbers_are_named(device, name, value):
    parameters = {name: tensor.double() for name, tensor in body_parameters(0, device).items()}
    with pytest.raises(ValueError, match=f"{name}: "):
        pose(**{**parameters, name: spoiled(parameters[name], value)})


def test_a_near_plane_that_is_no_number_is_named():
    with pytest.raises(ValueError, match="near: nan"):
        WeakPerspective(torch.ones(1), torch.ones(1, 2), math.nan)
    with pytest.raises(ValueError, match="near: nan"):
        Perspective(torch.ones(1, 2), torch.ones(1, 2), math.nan)


def test_nothing_behind_a_perspective_camera_is_drawn(device):
    """Whatever the near plane."""
    bodies, _ = ball(device=device)
    behind = replace(bodies, centres=-bodies.centres)
    camera = Perspective(torch.full((1, 2), 8.0, device=device), torch.full((1, 2), 4.0, device=device), near=-10.0)
    assert (draw_ellipsoids(behind, camera, (8, 8)).labels == 0).all()
    vertices, mesh = triangle(device)
    for depth in (-1.0, 0.0, 1e-40):
        moved = torch.cat([vertices[..., :2], torch.full_like(vertices[..., 2:], depth)], -1)
        assert (draw_mesh(moved, mesh, camera, (8, 8)).labels == 0).all()


BAD_CAMERAS = {
    "scale: shape": lambda: WeakPerspective(torch.ones(1, 1), torch.ones(1, 2)),
    "scale: float": lambda: WeakPerspective(1.0, torch.ones(1, 2)),
    "translation: shape": lambda: WeakPerspective(torch.ones(2), torch.ones(1, 2)),
    "translation: torch.float64": lambda: WeakPerspective(torch.ones(1), torch.ones(1, 2).double()),
    "translation: on meta": lambda: WeakPerspective(torch.ones(1), torch.ones(1, 2, device="meta")),
    "focal: torch.int64": lambda: Perspective(torch.ones(1, 2).long(), torch.ones(1, 2)),
    "centre: shape": lambda: Perspective(torch.ones(1, 2), torch.ones(1, 3)),
    "left: nan": lambda: Crop(math.nan, 0.0, 1.0, (8, 8)),
    "zoom: 0.0": lambda: Crop(0.0, 0.0, 0.0, (8, 8)),
    "zoom: inf": lambda: Crop(0.0, 0.0, math.inf, (8, 8)),
    "image_size: int": lambda: draw_on_screen(*triangle(), 8),
    "image_size: NoneType": lambda: draw_ellipsoids(*ball(), None),
    "vertices: torch.sparse_coo": lambda: draw_on_screen(triangle()[0].to_sparse(), triangle()[1], (8, 8)),
    "vertices: list": lambda: loss_on_screen([[1.0]], triangle()[1], torch.zeros(1, 8, 8, dtype=torch.uint8)),
    "vertices: shape": lambda: loss_on_screen(torch.ones(()), triangle()[1], torch.zeros(1, 8, 8, dtype=torch.uint8)),
    "global_orient: list": lambda: pose([1.0], *list(body_parameters(0).values())[1:]),
    "num_maps: 1.5": lambda: draw_on_screen(*triangle(), (8, 8), num_maps=1.5),
    "num_maps: 'a'": lambda: draw_ellipsoids(*ball(), (8, 8), num_maps="a"),
}


@pytest.mark.parametrize("message", BAD_CAMERAS)
def test_other_bad_calls_name_the_argument(message):
    with pytest.raises((ValueError, TypeError), match=message):
        BAD_CAMERAS[message]()


@pytest.mark.parametrize("gradient", GRADIENTS)
def test_expanded_and_strided_tensors_give_what_contiguous_ones_give(device, gradient):
    """With gradients, which must not be written twice to memory that is shared."""
    scene = one_scene((0.1, 0, 3), (0.5, 0.4, 0.3), True)
    target = checked_target(SIZE, 2, device)
    found = []
    for strided in (False, True):
        leaves = Leaves.of(scene, device=device)
        tensors = [tensor.expand(3, *tensor.shape[1:]) for tensor in leaves.tensors().values()]
        if strided:
            tensors = [tensor.transpose(0, -1).contiguous().transpose(0, -1) for tensor in tensors]
            wanted = target.expand(3, -1, -1)
        else:
            tensors, wanted = [tensor.contiguous() for tensor in tensors], target.repeat(3, 1, 1)
        loss, image = ellipsoid_label_loss(
            Ellipsoids(*tensors[:3]), Intrinsics(tensors[3], True), wanted, gradient=gradient
        )
        loss.sum().backward()
        found.append([image.labels, loss.detach(), *(tensor.grad for tensor in leaves.tensors().values())])
    for have, want in zip(*found, strict=True):
        assert torch.equal(have, want)
