"""Exact ellipsoids against the float64 reference: pictures, the gradient of covered area, PartDR's rule, extremes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from scenes import draw_on_screen, loss_on_screen
from scipy.spatial.transform import Rotation

from warp_partdr import label_set
from warp_partdr.body.ellipbody import EllipBody
from warp_partdr.body.posing import pose
from warp_partdr.cameras import Perspective, WeakPerspective
from warp_partdr.reference import coverage
from warp_partdr.reference import ellipsoids as reference
from warp_partdr.reference.losses import label_gradient
from warp_partdr.render.ellipsoids import Ellipsoids, draw_ellipsoids, ellipsoid_label_loss
from warp_partdr.render.part_mesh import ellipbody_mesh

CAMERAS = [False, True]  # perspective?
SMALL = [(21, 34), (30, 17)]
GROUPS = np.array([1, 2, 3, 4, 2, 255])  # a label of two ellipsoids, and one that hides and means nothing
LSP6 = np.asarray(label_set("lsp6").part_groups[1:])


# --- Scenes ------------------------------------------------------------------------------------------------------


def float32(values):
    """What the kernels see, in double."""
    return np.asarray(values, dtype=np.float32).astype(float)


def random_scene(seed, size, perspective, count=6, labels=None):
    """Ellipsoids that overlap, meet in space and hide each other; principal point and focal lengths askew."""
    rng = np.random.default_rng(seed)
    height, width = size
    centres = rng.uniform(-0.35, 0.35, (count, 3)) * (1, 1, 0.6) + (0, 0, 2.0 * perspective)
    axes = Rotation.from_rotvec(rng.normal(size=(count, 3))).as_matrix()
    focal = (1.5 * height, 1.4 * height) if perspective else (0.8 * height, 0.85 * height)
    camera = (*focal, width / 2 + 1.3, height / 2 - 0.7)
    labels = np.arange(1, count + 1) if labels is None else labels
    numbers = (centres, axes, rng.uniform(0.05, 0.3, (count, 3)), camera)
    return reference.EllipsoidScene(*map(float32, numbers), labels, perspective, 0.01 if perspective else -np.inf)


def apart(scene):
    """The same one behind the other, so that no two meet in space: outlines bound everything."""
    way = np.arange(len(scene.centres))[:, None] * (0.0, 0.0, 0.7)
    if not scene.perspective:
        return replace(scene, centres=float32(scene.centres + way))
    centres = scene.centres + way
    return replace(
        scene, centres=float32(centres * centres[:, 2:] / scene.centres[:, 2:] * (1, 1, 0) + (0, 0, 1) * centres)
    )


def body_parameters(seed, device="cpu", batch=1):
    """A mean adult in random poses, 3 m away."""
    rng = np.random.default_rng(seed)
    shape = EllipBody.mean(batch, device=device).torch()
    rotations = Rotation.from_rotvec(rng.normal(0, 0.5, (batch * 20, 3))).as_matrix().reshape(batch, 20, 3, 3)
    turn = Rotation.from_rotvec(rng.normal(0, 1.0, (batch, 3))).as_matrix() @ np.diag([1.0, -1, -1])
    values = {
        "global_orient": torch.from_numpy(turn).float(),
        "translation": torch.tensor([[0.0, 0.0, 3.0]] * batch),
        "rotations": torch.from_numpy(rotations).float(),
        "lengths": shape["lengths"],
        "thicknesses": shape["thicknesses"],
    }
    return {name: value.to(device) for name, value in values.items()}


def body_camera(size, perspective, batch=1, device="cpu"):
    height, width = size
    middle = torch.tensor([[width / 2.0, height / 2.2]] * batch, device=device)
    if perspective:
        return Perspective(torch.full((batch, 2), height * 1.4, device=device), middle)
    return WeakPerspective(torch.full((batch,), height / 2.0, device=device), middle)


def body_scene(seed, size, perspective, device, labels=None):
    """Posed on the device under test: a machine that tests CUDA may be unable to compile for the CPU."""
    return scene_of(pose(**body_parameters(seed, device)), body_camera(size, perspective), labels)


def scene_of(posed, camera, labels=None):
    """A body and its camera as the reference takes them."""
    numbers = (posed.centres[0], posed.axes[0], posed.semi_axes[0], camera.intrinsics[0])
    labels = np.arange(1, 21) if labels is None else labels
    numbers = [float32(tensor.detach().cpu()) for tensor in numbers]
    return reference.EllipsoidScene(*numbers, labels, camera.perspective, 0.01 if camera.perspective else -np.inf)


@dataclass(frozen=True)
class Intrinsics:
    """A camera whose four numbers are one leaf."""

    intrinsics: torch.Tensor
    perspective: bool
    near: float | None = None

    @property
    def near_plane(self) -> float:
        return self.near if self.near is not None else 0.01 if self.perspective else -math.inf


@dataclass(frozen=True)
class Leaves:
    """A scene on a device, ready to collect gradients."""

    ellipsoids: Ellipsoids
    camera: Intrinsics

    @classmethod
    def of(cls, *scenes, device="cpu"):
        def leaf(name):
            values = np.stack([getattr(scene, name) for scene in scenes])
            return torch.tensor(values, dtype=torch.float32, device=device, requires_grad=True)

        shape = Ellipsoids(leaf("centres"), leaf("axes"), leaf("semi_axes"))
        return cls(shape, Intrinsics(leaf("camera"), scenes[0].perspective))

    def tensors(self):
        e = self.ellipsoids
        return {"centres": e.centres, "axes": e.axes, "semi_axes": e.semi_axes, "camera": self.camera.intrinsics}

    def gradients(self, b=0):
        return {name: tensor.grad[b].cpu().numpy().astype(float) for name, tensor in self.tensors().items()}


def turn_gradient(axes, grad_axes):
    """Gradient of small rotations from the left, (P, 3)."""
    generators = np.cross(np.eye(3)[:, None], np.eye(3)[None]).transpose(0, 2, 1)  # skew(e_i)
    return np.einsum("pij,aik,pkj->pa", grad_axes, generators, axes)


def axes_gradient(axes, grad_turns):
    """A gradient of axes whose ``turn_gradient`` this is: half of skew(grad_turns) times the axes."""
    return 0.5 * np.cross(grad_turns[:, None], axes.transpose(0, 2, 1)).transpose(0, 2, 1)


def smooth_maps(seed, count, size):
    """A smooth random weight of each label at each pixel."""
    rng = np.random.default_rng(seed)
    x, y = reference.pixel_centres(size)
    waves = [np.cos(rng.normal() * x / 20 + rng.normal() * y / 20 + rng.uniform(0, 6)) for _ in range(count)]
    return float32(np.stack(waves) + rng.normal(size=(count, 1, 1)))


def noisy_target(labels, num_labels, seed):
    """The picture moved, with other labels and ignored pixels strewn in."""
    rng = np.random.default_rng(seed)
    target = np.roll(labels, (2, -3), (0, 1))
    strewn = rng.random(target.shape)
    target = np.where(strewn < 0.1, rng.integers(0, num_labels + 1, target.shape), target)
    return np.where(strewn > 0.95, 255, target).astype(np.uint8)


def relative_error(have, want):
    return float(np.linalg.norm(have - want) / np.linalg.norm(want))


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
    leaves = Leaves.of(*scenes, device=device)
    image = draw_ellipsoids(leaves.ellipsoids, leaves.camera, size, part_labels=GROUPS)
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
    centres = torch.zeros(1, 3, 3, device=device)
    twins = Ellipsoids(centres, torch.eye(3, device=device).expand(1, 3, 3, 3), torch.full_like(centres, 0.5))
    image = draw_ellipsoids(twins, body_camera((20, 20), False, device=device), (20, 20), part_labels=[7, 5, 6])
    assert set(image.labels.unique().tolist()) == {0, 7}
    assert set(image.parts.unique().tolist()) == {0, 1}


# --- The gradient of covered area --------------------------------------------------------------------------------

FINE = {"samples_per_pixel": 32.0}


def coverage_errors(scene, maps, device, lines=16, **options):
    """Relative error of each parameter's gradient through the maps."""
    leaves = Leaves.of(scene, device=device)
    size = maps.shape[1:]
    drawn = draw_ellipsoids(
        leaves.ellipsoids, leaves.camera, size, part_labels=scene.labels, num_maps=len(maps), **options
    )
    (drawn.maps[0] * torch.tensor(maps, dtype=torch.float32, device=device)).sum().backward()
    return gradient_errors(scene, leaves, coverage.coverage_gradient(scene, coverage.dense_costs(maps), lines))


def gradient_errors(scene, leaves, want):
    have = leaves.gradients()
    have["turns"] = turn_gradient(scene.axes, have.pop("axes"))
    return {name: relative_error(have[name], want[name]) for name in want}


@pytest.mark.parametrize("perspective", CAMERAS)
@pytest.mark.parametrize("seed", [0, 1])
def test_gradient_of_outlines_is_that_of_area(device, seed, perspective):
    size = (96, 112)
    scene = apart(random_scene(seed, size, perspective, labels=np.array([1, 2, 3, 4, 5, 2])))
    maps = smooth_maps(seed, 5, size)
    # What moves the whole picture leaves little: the forces on opposite sides of each ellipsoid nearly cancel.
    for options in (FINE, {}):
        errors = coverage_errors(scene, maps, device, **options)
        assert errors.pop("camera") < 0.01
        assert max(errors.values()) < 0.004


@pytest.mark.parametrize("perspective", CAMERAS)
def test_gradient_of_a_bodys_outlines_is_that_of_area(device, perspective):
    size = (112, 96)
    scene = body_scene(0, size, perspective, device)
    errors = coverage_errors(apart(scene), smooth_maps(0, 20, size), device, 48, **FINE)
    assert errors.pop("camera") < 0.03
    assert max(errors.values()) < 0.005


@pytest.mark.parametrize("perspective", CAMERAS)
@pytest.mark.parametrize("seed", [0, 1])
def test_gradient_of_creases_is_that_of_area(device, seed, perspective):
    size = (96, 112)
    scene = random_scene(seed, size, perspective, labels=np.array([1, 2, 3, 4, 5, 2]))
    errors = coverage_errors(scene, smooth_maps(seed, 5, size), device, 64, **FINE)
    assert max(errors.values()) < 0.005


@pytest.mark.parametrize("perspective", CAMERAS)
def test_gradient_of_what_the_pictures_border_cuts(device, perspective):
    """Outlines and creases run off the picture on all sides; what lies outside costs nothing."""
    size = (48, 56)
    scene = random_scene(2, size, perspective)
    scene = replace(scene, camera=scene.camera * (4, 4, 1, 1))
    labels = reference.ray_cast(scene, size)[0]
    assert all(len(set(edge) - {0}) > 1 for edge in (labels[0], labels[-1], labels[:, 0], labels[:, -1]))
    errors = coverage_errors(scene, smooth_maps(3, 6, size), device, 64, **FINE)
    assert max(errors.values()) < 0.005


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
    target_image = torch.from_numpy(target.astype(np.uint8)).to(device)[None]
    loss, _ = ellipsoid_label_loss(leaves.ellipsoids, leaves.camera, target_image, part_labels=GROUPS, **FINE)
    loss.sum().backward()
    want = coverage.coverage_gradient(scene, coverage.target_costs(target, 4), 32)
    errors = gradient_errors(scene, leaves, want)
    assert errors.pop("camera") < 0.05
    assert max(errors.values()) < 0.01


@pytest.mark.parametrize("perspective", CAMERAS)
def test_the_reference_is_the_derivative_of_area(perspective):
    """The reference's sum over borders against differences of the area itself, along random directions."""
    size = (48, 56)
    scene = random_scene(1, size, perspective, labels=np.array([1, 2, 3, 4, 5, 2]))
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
        image = draw_ellipsoids(
            leaves.ellipsoids,
            leaves.camera,
            size,
            part_labels=GROUPS,
            num_maps=4,
            gradient="partdr",
            **options,
        )
        g = torch.randn(image.maps.shape, generator=torch.Generator().manual_seed(seed)).to(device)
        (image.maps * g).sum().backward()
        for b, scene in enumerate(scenes):
            want = reference.partdr_gradient(
                scene,
                image.parts[b].cpu().numpy(),
                g[b].cpu().numpy().astype(float),
                **options,
            )
            check_forces(leaves, want, b)


@pytest.mark.parametrize("perspective", CAMERAS)
@pytest.mark.parametrize("labels", [None, LSP6], ids=["parts", "groups"])
def test_partdr_gradient_of_the_label_loss_is_the_reference_on_bodies(device, labels, perspective):
    size = (40, 32)
    scene = body_scene(3, size, perspective, device, labels)
    count = int(scene.labels.max())
    target = noisy_target(reference.ray_cast(scene, size)[0], count, 0)
    leaves = Leaves.of(scene, device=device)
    loss, image = ellipsoid_label_loss(
        leaves.ellipsoids,
        leaves.camera,
        torch.from_numpy(target).to(device)[None],
        part_labels=labels,
        gradient="partdr",
    )
    loss.sum().backward()
    g = label_gradient(image.labels[0].cpu().numpy(), target, count)
    parts = image.parts[0].cpu().numpy()
    check_forces(leaves, reference.partdr_gradient(scene, parts, g))
    assert loss.item() == pytest.approx(np.abs(g).sum() / 2, rel=1e-5)


def test_of_hidden_twins_the_first_comes_forward(device):
    """Of equally deep ellipsoids of a hidden label, the lower index gets the force along z, and it alone."""
    size = (24, 24)
    centres = torch.tensor([[[0.0, 0.0, 0.0], [0.0, 0.0, 2.0], [0.0, 0.0, 2.0]]], device=device, requires_grad=True)
    semi_axes = torch.tensor([[[0.8] * 3, [0.4] * 3, [0.4] * 3]], device=device)
    bodies = Ellipsoids(centres, torch.eye(3, device=device).expand(1, 3, 3, 3), semi_axes)
    target = torch.full((1, *size), 2, dtype=torch.uint8, device=device)
    camera = body_camera(size, False, device=device)
    loss, _ = ellipsoid_label_loss(bodies, camera, target, part_labels=[1, 2, 2], gradient="partdr")
    loss.sum().backward()
    front, first, second = centres.grad[0, :, 2].tolist()
    assert first > 0  # descent brings it forward, to a smaller z
    assert front == pytest.approx(-first)
    assert second == 0


# --- What holds for both estimates -------------------------------------------------------------------------------

GRADIENTS = ["edges", "coverage", "partdr"]


def body_loss(leaves, camera, target, gradient, **options):
    return ellipsoid_label_loss(pose(**leaves), camera, target, gradient=gradient, **options)


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
    loss, _ = body_loss(leaves, camera, target, gradient)
    loss.sum().backward()
    for name, leaf in {**leaves, **numbers}.items():
        assert torch.isfinite(leaf.grad).all(), name
        assert (leaf.grad != 0).any(), name


@pytest.mark.parametrize("gradient", GRADIENTS)
def test_linear_in_the_incoming_gradient(device, gradient):
    size = (30, 40)
    leaves = Leaves.of(random_scene(0, size, True), random_scene(1, size, True), device=device)
    maps = draw_ellipsoids(leaves.ellipsoids, leaves.camera, size, num_maps=6, gradient=gradient).maps
    tensors = list(leaves.tensors().values())
    g, h = torch.randn(2, *maps.shape, generator=torch.Generator().manual_seed(0)).to(device)
    of = [torch.autograd.grad(maps, tensors, seen, retain_graph=True) for seen in (g, h, 2 * g - 3 * h)]
    for first, second, both in zip(*of, strict=True):
        torch.testing.assert_close(both, 2 * first - 3 * second, rtol=1e-4, atol=1e-4 * both.abs().max().item())


def test_label_loss_is_the_maps_loss(device):
    """The fused path and the general one agree: value, and PartDR's gradient through squared differences of maps."""
    size = (48, 40)
    leaves = Leaves.of(*(body_scene(seed, size, False, device) for seed in range(3)), device=device)
    shown = draw_ellipsoids(leaves.ellipsoids, leaves.camera, size).labels.cpu().numpy()
    target = torch.from_numpy(np.stack([noisy_target(picture, 20, 1) for picture in shown])).to(device)
    target[target == 255] = 0
    tensors = list(leaves.tensors().values())
    loss, _ = ellipsoid_label_loss(leaves.ellipsoids, leaves.camera, target, gradient="partdr")
    fused = torch.autograd.grad(loss.sum(), tensors)
    maps = draw_ellipsoids(leaves.ellipsoids, leaves.camera, size, num_maps=20, gradient="partdr").maps
    wanted = (target[:, None] == torch.arange(1, 21, device=device)[:, None, None]).float()
    general_loss = (maps - wanted).square().sum((1, 2, 3))
    torch.testing.assert_close(loss, general_loss)
    for have, want in zip(fused, torch.autograd.grad(general_loss.sum(), tensors), strict=True):
        torch.testing.assert_close(have, want, rtol=1e-4, atol=1e-4 * want.abs().max().item())


def test_target_equal_to_picture_has_exactly_no_partdr_gradient(device):
    size = (40, 40)
    leaves = Leaves.of(body_scene(4, size, False, device), device=device)
    picture = draw_ellipsoids(leaves.ellipsoids, leaves.camera, size).labels
    loss, _ = ellipsoid_label_loss(leaves.ellipsoids, leaves.camera, picture, gradient="partdr")
    loss.sum().backward()
    assert loss.item() == 0
    assert all((tensor.grad == 0).all() for tensor in leaves.tensors().values())


@pytest.mark.parametrize("gradient", GRADIENTS)
def test_ignored_pixels_cost_nothing(device, gradient):
    size = (40, 40)
    leaves = Leaves.of(body_scene(4, size, False, device), device=device)
    target = torch.full((1, *size), 255, dtype=torch.uint8, device=device)
    loss, _ = ellipsoid_label_loss(leaves.ellipsoids, leaves.camera, target, gradient=gradient)
    loss.sum().backward()
    assert loss.item() == 0
    assert all((tensor.grad == 0).all() for tensor in leaves.tensors().values())


@pytest.mark.parametrize("gradient", GRADIENTS)
def test_batch_equals_its_members(device, gradient):
    """One target for all, a factor for each body's loss, and every body alone: the same."""
    size = (40, 56)
    scenes = [body_scene(seed, size, True, device) for seed in range(3)]
    target = torch.from_numpy(noisy_target(reference.ray_cast(scenes[0], size)[0], 20, 2)).to(device)[None]
    leaves = Leaves.of(*scenes, device=device)
    loss, image = ellipsoid_label_loss(leaves.ellipsoids, leaves.camera, target, gradient=gradient)
    factors = torch.tensor([2.0, 0.0, -0.5], device=device)
    loss.backward(factors)
    for b, scene in enumerate(scenes):
        one = Leaves.of(scene, device=device)
        loss_one, image_one = ellipsoid_label_loss(one.ellipsoids, one.camera, target, gradient=gradient)
        loss_one.sum().backward()
        assert torch.equal(image.labels[b], image_one.labels[0])
        assert torch.equal(image.depth[b], image_one.depth[0])
        assert loss[b] == loss_one[0]
        for whole, alone in zip(leaves.tensors().values(), one.tensors().values(), strict=True):
            torch.testing.assert_close(whole.grad[b], factors[b] * alone.grad[0])


@pytest.mark.parametrize("gradient", GRADIENTS)
def test_every_run_is_the_same_to_the_bit(device, gradient):
    size = (96, 80)
    scenes = [body_scene(seed, size, False, device) for seed in range(4)]
    target = torch.from_numpy(noisy_target(reference.ray_cast(scenes[0], size)[0], 20, 2)).to(device)[None]
    runs = []
    for _ in range(3):
        leaves = Leaves.of(*scenes, device=device)
        loss, image = ellipsoid_label_loss(leaves.ellipsoids, leaves.camera, target, gradient=gradient)
        loss.sum().backward()
        gradients = [tensor.grad for tensor in leaves.tensors().values()]
        runs.append([loss.detach(), image.labels, image.parts, image.depth, *gradients])
    for run in runs[1:]:
        assert all(torch.equal(have, want) for have, want in zip(run, runs[0], strict=True))


@pytest.mark.parametrize("gradient", GRADIENTS)
@pytest.mark.parametrize(("batch", "count", "size"), [(0, 20, (20, 24)), (1, 1, (1, 1)), (1, 255, (32, 32))])
def test_sizes_at_the_limits(device, gradient, batch, count, size):
    scenes = [random_scene(b, size, False, count=count) for b in range(max(batch, 1))]
    leaves = Leaves.of(*scenes, device=device)
    tensors = {name: tensor.detach()[:batch].requires_grad_() for name, tensor in leaves.tensors().items()}
    bodies = Ellipsoids(tensors["centres"], tensors["axes"], tensors["semi_axes"])
    camera = Intrinsics(tensors["camera"], False)
    target = torch.ones(batch, *size, dtype=torch.uint8, device=device)
    loss, image = ellipsoid_label_loss(bodies, camera, target, gradient=gradient)
    loss.sum().backward()
    assert image.labels.shape == (batch, *size)
    for name, tensor in tensors.items():
        assert tensor.grad.shape == tensor.shape, name
        assert torch.isfinite(tensor.grad).all()
    for b in range(batch):
        check_picture(image, scenes[b], size, b)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float16, torch.bfloat16])
def test_other_precisions_are_cast(device, dtype):
    leaves = Leaves.of(random_scene(0, (20, 20), True), device=device)
    tensors = {name: tensor.detach().to(dtype).requires_grad_() for name, tensor in leaves.tensors().items()}
    bodies = Ellipsoids(tensors["centres"], tensors["axes"], tensors["semi_axes"])
    target = torch.zeros(1, 20, 20, dtype=torch.uint8, device=device)
    loss, _ = ellipsoid_label_loss(bodies, Intrinsics(tensors["camera"], True), target)
    loss.sum().backward()
    for tensor in tensors.values():
        assert tensor.grad.dtype == dtype
        assert torch.isfinite(tensor.grad).all()


def test_strides_do_not_matter(device):
    size = (24, 20)
    plain = Leaves.of(random_scene(0, size, True), device=device)
    e = plain.ellipsoids
    strided = Ellipsoids(
        e.centres.transpose(1, 2).contiguous().transpose(1, 2),
        e.axes.transpose(2, 3).contiguous().transpose(2, 3),
        e.semi_axes.expand(2, -1, -1)[:1],
    )
    assert not strided.centres.is_contiguous()
    assert not strided.axes.is_contiguous()
    have, want = (draw_ellipsoids(bodies, plain.camera, size) for bodies in (strided, e))
    assert torch.equal(have.labels, want.labels)
    assert torch.equal(have.depth, want.depth)


@pytest.mark.parametrize("gradient", GRADIENTS)
def test_moving_an_ellipsoid_toward_its_target_lowers_the_loss(device, gradient):
    size = (32, 32)
    camera = body_camera(size, False, device=device)
    axes = torch.eye(3, device=device).expand(1, 1, 3, 3)
    semi_axes = torch.tensor([[[0.3, 0.2, 0.2]]], device=device)
    target = draw_ellipsoids(Ellipsoids(torch.zeros(1, 1, 3, device=device), axes, semi_axes), camera, size).labels
    for shift in [(0.2, 0), (-0.2, 0), (0, 0.2), (0, -0.2)]:
        move = torch.tensor([[[*shift, 0.0]]], device=device, requires_grad=True)
        optimizer = torch.optim.Adam([move], lr=0.02)
        schedule = torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.96)
        for _ in range(100):
            loss, _ = ellipsoid_label_loss(Ellipsoids(move, axes, semi_axes), camera, target, gradient=gradient)
            optimizer.zero_grad()
            loss.sum().backward()
            optimizer.step()
            schedule.step()
        assert move.abs().max() * 16 < 0.6, f"from {shift}: {loss.item()} pixels wrong at {move.tolist()}"


def test_groups_are_unions(device):
    """Two ellipsoids of one label, one inside the other's picture: its outline bounds nothing and gets no gradient."""
    size = (32, 32)
    centres = torch.tensor([[[0.0, 0.0, 0.0], [0.0, 0.0, -1.0]]], device=device, requires_grad=True)
    semi_axes = torch.tensor([[[0.6, 0.6, 0.6], [0.2, 0.2, 0.2]]], device=device)
    bodies = Ellipsoids(centres, torch.eye(3, device=device).expand(1, 2, 3, 3), semi_axes)
    target = torch.zeros(1, *size, dtype=torch.uint8, device=device)
    target[:, 10:, 12:] = 1
    for gradient in GRADIENTS:
        centres.grad = None
        loss, _ = ellipsoid_label_loss(
            bodies, body_camera(size, False, device=device), target, part_labels=[1, 1], gradient=gradient
        )
        loss.sum().backward()
        assert (centres.grad[0, 1] == 0).all()
        assert (centres.grad[0, 0, :2] != 0).all()


# --- Extremes ----------------------------------------------------------------------------------------------------


def one_ellipsoid(centre, semi_axes, device, axes=None):
    numbers = (np.array([centre]), np.eye(3)[None] if axes is None else axes[None], np.array([semi_axes]))
    centres, axes, semi_axes = (torch.tensor(v, dtype=torch.float32, device=device)[None] for v in numbers)
    return Ellipsoids(centres.requires_grad_(), axes.requires_grad_(), semi_axes.requires_grad_())


def edge_on():
    """The third axis lies in the picture's plane."""
    return Rotation.from_rotvec([0.0, np.pi / 2, 0.0]).as_matrix()


EXTREMES = {  # name: (centre, semi-axes, axes, intrinsics of weak and perspective), what shows
    "needle": ((0, 0, 3), (1e-6, 0.5, 0.5), None, "few"),
    "disc": ((0, 0, 3), (0.5, 0.5, 1e-6), None, "some"),
    "edge-on disc": ((0, 0, 3), (0.5, 0.5, 1e-6), edge_on(), "few"),
    "point": ((0, 0, 3), (1e-6, 1e-6, 1e-6), None, "few"),
    "rod": ((0, 0, 3), (1e3, 0.1, 0.1), None, "some"),
    "wall": ((0, 0, 3), (1e3, 1e3, 0.1), None, "all"),
    "far away": ((1e5, -1e5, 3), (0.5, 0.5, 0.5), None, "none"),
    "far away and large": ((1e5, 0, 3), (1e5, 0.5, 0.5), None, "any"),
}


@pytest.mark.parametrize("gradient", GRADIENTS)
@pytest.mark.parametrize("perspective", CAMERAS)
@pytest.mark.parametrize("name", EXTREMES)
def test_extremes_stay_finite(device, name, perspective, gradient):
    size = (24, 32)
    centre, semi_axes, axes, shows = EXTREMES[name]
    bodies = one_ellipsoid(centre, semi_axes, device, axes)
    camera = body_camera(size, perspective, device=device)
    target = torch.ones(1, *size, dtype=torch.uint8, device=device)
    target[:, :, :10] = 0
    loss, image = ellipsoid_label_loss(bodies, camera, target, gradient=gradient)
    loss.sum().backward()
    share = (image.labels == 1).float().mean().item()
    low, high = {"none": (0, 0), "few": (0, 0.1), "some": (0.05, 0.95), "all": (1, 1), "any": (0, 1)}[shows]
    assert low <= share <= high
    assert torch.isfinite(image.depth[image.labels > 0]).all()
    for tensor in (bodies.centres, bodies.axes, bodies.semi_axes):
        assert torch.isfinite(tensor.grad).all()


@pytest.mark.parametrize("gradient", GRADIENTS)
def test_coordinates_of_a_million_pixels(device, gradient):
    """The same picture, seen far off the origin of a large one: nothing shows, nothing hangs, nothing is NaN."""
    size = (24, 32)
    target = torch.ones(1, *size, dtype=torch.uint8, device=device)
    for focal, middle in ((20.0, 1e6), (1e6, 0.0), (1e6, 1e6)):
        bodies = one_ellipsoid((0.1, 0.0, 3.0), (0.5, 0.3, 0.2), device)
        numbers = torch.tensor([[focal, focal, middle, middle]], device=device)
        loss, image = ellipsoid_label_loss(bodies, Intrinsics(numbers, True), target, gradient=gradient)
        loss.sum().backward()
        assert (image.labels == 1).all() == (middle == 0.0)
        assert torch.isfinite(bodies.centres.grad).all()


@pytest.mark.parametrize("gradient", GRADIENTS)
@pytest.mark.parametrize("depth", [-3.0, -0.2, 0.0, 0.2, 0.3, 0.305])
def test_ellipsoids_at_the_camera_are_left_out(device, depth, gradient):
    size = (20, 20)
    bodies = one_ellipsoid((0.0, 0.05, depth), (0.3, 0.3, 0.3), device)
    target = torch.ones(1, *size, dtype=torch.uint8, device=device)
    loss, image = ellipsoid_label_loss(bodies, body_camera(size, True, device=device), target, gradient=gradient)
    loss.sum().backward()
    assert (image.labels == 0).all()
    assert torch.isinf(image.depth).all()
    for tensor in (bodies.centres, bodies.axes, bodies.semi_axes):
        assert (tensor.grad == 0).all()


@pytest.mark.parametrize("perspective", CAMERAS)
def test_near_plane(device, perspective):
    size = (20, 20)
    bodies = one_ellipsoid((0.0, 0.0, 1.0), (0.3, 0.3, 0.3), device)
    intrinsics = body_camera(size, perspective, device=device).intrinsics
    assert (draw_ellipsoids(bodies, Intrinsics(intrinsics, perspective, 0.69), size).labels == 1).any()
    assert (draw_ellipsoids(bodies, Intrinsics(intrinsics, perspective, 0.71), size).labels == 0).all()


def test_unchecked_nonsense_is_not_drawn(device):
    """Without validation, an ellipsoid that is none leaves the others alone."""
    size = (20, 20)
    nan = float("nan")
    scene = random_scene(0, size, False, count=4)
    bodies = Leaves.of(scene, device=device)
    with torch.no_grad():
        bodies.ellipsoids.centres[0, 0, 2] = nan
        bodies.ellipsoids.semi_axes[0, 1, 0] = 0.0
        bodies.ellipsoids.axes[0, 2] = nan
    image = draw_ellipsoids(bodies.ellipsoids, bodies.camera, size, validate=False)
    assert set(image.labels.unique().tolist()) == {0, 4}


# --- Errors ------------------------------------------------------------------------------------------------------


def changed(bodies, **fields):
    return replace(bodies, **{name: change(getattr(bodies, name)) for name, change in fields.items()})


def set_first(value):
    def change(tensor):
        tensor = tensor.clone()
        tensor.view(-1)[0] = value
        return tensor

    return change


TARGET = torch.zeros(1, 8, 8, dtype=torch.uint8)
NAN = float("nan")
BAD_CALLS = {
    "centres: shape": lambda e, c: draw_ellipsoids(changed(e, centres=lambda t: t[0]), c, (8, 8)),
    "centres: torch.int32": lambda e, c: draw_ellipsoids(changed(e, centres=lambda t: t.int()), c, (8, 8)),
    "centres: 256 ellipsoids": lambda e, c: draw_ellipsoids(
        Ellipsoids(e.centres[:, [0] * 256], e.axes[:, [0] * 256], e.semi_axes[:, [0] * 256]), c, (8, 8)
    ),
    "centres: holds NaN": lambda e, c: draw_ellipsoids(changed(e, centres=set_first(NAN)), c, (8, 8)),
    "centres: 0 ellipsoids": lambda e, c: draw_ellipsoids(
        Ellipsoids(e.centres[:, :0], e.axes[:, :0], e.semi_axes[:, :0]), c, (8, 8)
    ),
    "axes: shape": lambda e, c: draw_ellipsoids(changed(e, axes=lambda t: t[:, :1]), c, (8, 8)),
    "axes: torch.float64": lambda e, c: draw_ellipsoids(changed(e, axes=lambda t: t.double()), c, (8, 8)),
    "axes: on meta": lambda e, c: draw_ellipsoids(changed(e, axes=lambda t: t.to("meta")), c, (8, 8)),
    "axes: holds NaN": lambda e, c: draw_ellipsoids(changed(e, axes=set_first(math.inf)), c, (8, 8)),
    "semi_axes: shape": lambda e, c: draw_ellipsoids(changed(e, semi_axes=lambda t: t[..., :2]), c, (8, 8)),
    "semi_axes: on meta": lambda e, c: draw_ellipsoids(changed(e, semi_axes=lambda t: t.to("meta")), c, (8, 8)),
    "semi_axes: holds NaN": lambda e, c: draw_ellipsoids(changed(e, semi_axes=set_first(NAN)), c, (8, 8)),
    "semi_axes: 0.0": lambda e, c: draw_ellipsoids(changed(e, semi_axes=set_first(0.0)), c, (8, 8)),
    "semi_axes: -1.0": lambda e, c: draw_ellipsoids(changed(e, semi_axes=set_first(-1.0)), c, (8, 8)),
    "camera: 2 of them": lambda e, c: draw_ellipsoids(e, body_camera((8, 8), False, batch=2), (8, 8)),
    "camera: torch.int64": lambda e, c: draw_ellipsoids(e, replace(c, intrinsics=c.intrinsics.long()), (8, 8)),
    "camera: on meta": lambda e, c: draw_ellipsoids(e, replace(c, intrinsics=c.intrinsics.to("meta")), (8, 8)),
    "camera: holds NaN": lambda e, c: draw_ellipsoids(e, replace(c, intrinsics=c.intrinsics * NAN), (8, 8)),
    r"image_size: \(0, 8\)": lambda e, c: draw_ellipsoids(e, c, (0, 8)),
    r"image_size: \(8.0, 8\)": lambda e, c: draw_ellipsoids(e, c, (8.0, 8)),
    r"image_size: \(8, 8, 3\)": lambda e, c: draw_ellipsoids(e, c, (8, 8, 3)),
    r"image_size: 1 pictures of \(65536, 32768\)": lambda e, c: draw_ellipsoids(e, c, (65536, 32768)),
    r"image_size: 1 pictures of \(1048576, 1048576\)": lambda e, c: ellipsoid_label_loss(
        e, c, TARGET[:, :1, :1].expand(1, 2**20, 2**20)
    ),
    "num_maps: 255": lambda e, c: draw_ellipsoids(e, c, (8, 8), num_maps=255),
    "num_maps: -1": lambda e, c: draw_ellipsoids(e, c, (8, 8), num_maps=-1),
    "part_labels: 1 of them; expected 2": lambda e, c: draw_ellipsoids(e, c, (8, 8), part_labels=[1]),
    "part_labels: -1; expected an integer": lambda e, c: draw_ellipsoids(e, c, (8, 8), part_labels=[-1, 1]),
    "part_labels: 256; expected an integer": lambda e, c: draw_ellipsoids(e, c, (8, 8), part_labels=[1, 256]),
    "gradient: 'exact'": lambda e, c: draw_ellipsoids(e, c, (8, 8), gradient="exact"),
    "samples_per_pixel: 0": lambda e, c: draw_ellipsoids(e, c, (8, 8), samples_per_pixel=0),
    "samples_per_pixel: nan": lambda e, c: draw_ellipsoids(e, c, (8, 8), samples_per_pixel=NAN),
    "samples_per_pixel: 65": lambda e, c: draw_ellipsoids(e, c, (8, 8), samples_per_pixel=65),
    "max_distance: -1": lambda e, c: draw_ellipsoids(e, c, (8, 8), max_distance=-1),
    "max_distance: nan": lambda e, c: ellipsoid_label_loss(e, c, TARGET, max_distance=NAN),
    "depth_weight: -0.5": lambda e, c: draw_ellipsoids(e, c, (8, 8), depth_weight=-0.5),
    "depth_weight: nan": lambda e, c: ellipsoid_label_loss(e, c, TARGET, depth_weight=NAN),
    "depth_weight: inf": lambda e, c: ellipsoid_label_loss(e, c, TARGET, depth_weight=math.inf),
    "target: shape": lambda e, c: ellipsoid_label_loss(e, c, TARGET[0]),
    "target: batch 2": lambda e, c: ellipsoid_label_loss(e, c, TARGET.expand(2, 8, 8)),
    "target: torch.int64": lambda e, c: ellipsoid_label_loss(e, c, TARGET.long()),
    "target: on meta": lambda e, c: ellipsoid_label_loss(e, c, TARGET.to("meta")),
}


@pytest.mark.parametrize("message", BAD_CALLS)
def test_bad_calls_name_the_argument(message):
    leaves = Leaves.of(random_scene(0, (8, 8), False, count=2))
    bodies = Ellipsoids(*(tensor.detach() for tensor in list(leaves.tensors().values())[:3]))
    camera = Intrinsics(leaves.camera.intrinsics.detach(), False)
    with pytest.raises(ValueError, match=message):
        BAD_CALLS[message](bodies, camera)


@pytest.mark.parametrize(
    "option", [{"max_distance": -1.0}, {"max_distance": NAN}, {"depth_weight": -0.5}, {"depth_weight": NAN}]
)
def test_the_mesh_renderer_refuses_the_same_options(option):
    mesh = ellipbody_mesh(0)
    vertices = torch.zeros(1, mesh.num_vertices, 3)
    with pytest.raises(ValueError, match=f"{next(iter(option))}: "):
        draw_on_screen(vertices, mesh, (8, 8), **option)
    with pytest.raises(ValueError, match=f"{next(iter(option))}: "):
        loss_on_screen(vertices, mesh, TARGET, **option)
