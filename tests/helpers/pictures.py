"""Scenes to draw: ellipsoids and faces, exact and random, and what pictures of them are compared with."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from warp_partdr.body.ellipbody import EllipBody
from warp_partdr.body.posing import pose
from warp_partdr.cameras import Perspective, ScreenCamera, WeakPerspective
from warp_partdr.reference import ellipsoids as reference
from warp_partdr.reference.mesh import MeshPicture, MeshScene
from warp_partdr.render.ellipsoids import Ellipsoids, draw_ellipsoids, ellipsoid_label_loss
from warp_partdr.render.mesh import PartImage, draw_mesh, mesh_label_loss
from warp_partdr.render.part_mesh import PartMesh, ellipbody_mesh


def draw_on_screen(
    vertices: torch.Tensor,
    mesh: PartMesh,
    size: tuple[int, int],
    *,
    perspective: bool = False,
    near: float | None = None,
    **options: Any,
) -> PartImage:
    """``draw_mesh`` of vertices on the screen."""
    return draw_mesh(vertices, mesh, ScreenCamera(perspective, near), size, **options)


def loss_on_screen(
    vertices: torch.Tensor,
    mesh: PartMesh,
    target: torch.Tensor,
    *,
    perspective: bool = False,
    near: float | None = None,
    **options: Any,
) -> tuple[torch.Tensor, PartImage]:
    """``mesh_label_loss`` of vertices on the screen."""
    return mesh_label_loss(vertices, mesh, ScreenCamera(perspective, near), target, **options)


def push_on_screen(
    leaf: torch.Tensor, mesh: PartMesh, target: torch.Tensor, **options: Any
) -> tuple[torch.Tensor, PartImage]:
    """``loss_on_screen``, when the leaf's gradient is collected."""
    loss, image = loss_on_screen(leaf, mesh, target, **options)
    loss.sum().backward()
    return loss.detach(), image


CAMERAS = [False, True]  # perspective?
GRADIENTS = ["edges", "coverage", "partdr"]
GROUPS = np.array([1, 2, 3, 4, 2, 255])  # a label of two ellipsoids, and one that hides and means nothing


def float32(values):
    """The kernels' inputs, in double."""
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

    def draw(self, size, **options):
        return draw_ellipsoids(self.ellipsoids, self.camera, size, **options)

    def push_by_loss(self, target, **options):
        """Loss and picture, when the gradient is collected; ``target`` of one picture or of many."""
        target = torch.as_tensor(target, dtype=torch.uint8, device=self.camera.intrinsics.device)
        target = target.view(-1, *target.shape[-2:])
        loss, image = ellipsoid_label_loss(self.ellipsoids, self.camera, target, **options)
        loss.sum().backward()
        return loss.detach(), image

    def push_by_maps(self, weights, **options):
        """Picture, when the gradient of maps times weights (K, H, W) or (B, K, H, W) is collected."""
        weights = torch.as_tensor(weights, dtype=torch.float32, device=self.camera.intrinsics.device)
        image = self.draw(tuple(weights.shape[-2:]), num_maps=weights.shape[-3], **options)
        (image.maps * weights).sum().backward()
        return image

    def tensors(self):
        e = self.ellipsoids
        return {"centres": e.centres, "axes": e.axes, "semi_axes": e.semi_axes, "camera": self.camera.intrinsics}

    def gradients(self, b=0):
        return {name: tensor.grad[b].cpu().numpy().astype(float) for name, tensor in self.tensors().items()}


def turn_gradient(axes, grad_axes):
    """Gradient of small rotations from the left, (P, 3)."""
    generators = np.cross(np.eye(3)[:, None], np.eye(3)[None]).transpose(0, 2, 1)  # skew(e_i)
    return np.einsum("pij,aik,pkj->pa", grad_axes, generators, axes)


def projected_bodies(seed, size, device, perspective=False, subdivisions=0, batch=1, frontal=False):
    """The vertices of posed bodies on the screen, as a leaf, and their mesh; ``frontal`` are at rest."""
    parameters = body_parameters(seed, device, batch)
    if frontal:
        parameters["global_orient"] = torch.diag(torch.tensor([1.0, -1, -1], device=device)).expand(batch, 3, 3)
        parameters["rotations"] = torch.eye(3, device=device).expand(batch, 20, 3, 3)
    vertices = pose(**parameters).vertices(subdivisions)
    points = body_camera(size, perspective, batch, device).project(vertices)
    return points.requires_grad_(), ellipbody_mesh(subdivisions, device=device)


def mesh_scene(vertices, mesh, perspective=False):
    """One body's vertices on the screen and its mesh as the reference takes them."""
    corners = vertices.detach().cpu().double().numpy()
    near = 0.01 if perspective else -np.inf
    topology = mesh.faces.cpu().numpy(), mesh.face_labels.cpu().numpy().astype(int)
    return MeshScene(corners, *topology, perspective, near, mesh.cull_backfaces)


def mesh_picture(image, b=0):
    """One body's picture as the reference takes it."""
    return MeshPicture(*(each[b].cpu().numpy() for each in (image.labels, image.depth, image.face_index)))


def smooth_maps(seed, count, size):
    """A smooth random weight of each label at each pixel."""
    rng = np.random.default_rng(seed)
    x, y = reference.pixel_centres(size)
    waves = [np.cos(rng.normal() * x / 20 + rng.normal() * y / 20 + rng.uniform(0, 6)) for _ in range(count)]
    return float32(np.stack(waves) + rng.normal(size=(count, 1, 1)))


def noisy_target(labels, num_labels, seed):
    """The picture moved, with other labels and ignored pixels strewn in."""
    rng = np.random.default_rng(seed)
    target = np.roll(labels, (2, -3), (-2, -1))
    strewn = rng.random(target.shape)
    target = np.where(strewn < 0.1, rng.integers(0, num_labels + 1, target.shape), target)
    return np.where(strewn > 0.95, 255, target).astype(np.uint8)


def noisy_picture(labels, num_labels, seed):
    """A batch of pictures on a device gets the same noise."""
    return torch.from_numpy(noisy_target(labels.cpu().numpy(), num_labels, seed)).to(labels.device)


def relative_error(have, want):
    return float(np.linalg.norm(have - want) / np.linalg.norm(want))


def gradient_errors(scene, leaves, want):
    have = leaves.gradients()
    have["turns"] = turn_gradient(scene.axes, have.pop("axes"))
    return {name: relative_error(have[name], want[name]) for name in want}


PLACE = 0.01  # [px] that an outline may be off, and of coordinates beyond the picture PLACE_SHARE more
PLACE_SHARE = 3e-7
LEAD = 3e-6  # of the depth: surfaces nearer to one another than that may change places


def sure_pixels(scene, size):
    """Pixels where the reference's picture stays the same, moved by ``PLACE`` any way and depths by ``LEAD``."""
    with np.errstate(all="ignore"):
        parts = reference.ray_cast(scene, size)[1]
        means = reference.boxes(scene)[reference.drawable(scene)]
        off = PLACE + PLACE_SHARE * np.abs(means[np.isfinite(means)]).max(initial=0.0)
        depths = np.sort(reference.fronts(scene, *reference.pixel_centres(size)), 0)
        sure = np.ones(size, dtype=bool)
        if len(depths) > 1:
            sure &= ~(depths[1] - depths[0] <= LEAD * np.abs(depths[0]).clip(min=scene.semi_axes.max()))
        for x in (-off, 0, off):
            for y in (-off, 0, off):
                moved = replace(scene, camera=scene.camera + np.array([0, 0, x, y]))
                sure &= reference.ray_cast(moved, size)[1] == parts
    return sure


def check_ellipsoid_picture(image, scene, size):
    with np.errstate(all="ignore"):
        _, parts, depth = reference.ray_cast(scene, size)
    sure = sure_pixels(scene, size)
    np.testing.assert_array_equal(image.parts[0].cpu().numpy()[sure], parts[sure])
    shown = sure & (parts > 0)
    have = image.depth[0].cpu().numpy()
    assert np.isinf(have[sure & (parts == 0)]).all()
    # A front is steep next to its outline: there a hundredth of a pixel is much depth.
    steep = np.zeros(size)
    for way in ((0, 0, PLACE, 0), (0, 0, 0, PLACE)):
        with np.errstate(all="ignore"):
            there = reference.ray_cast(replace(scene, camera=scene.camera + way), size)[2]
            steep = np.fmax(steep, np.abs(there - depth))
    allowed = LEAD * (np.abs(depth) + scene.semi_axes.max()) + 2 * steep
    assert (np.abs(have[shown] - depth[shown]) <= allowed[shown]).all()


def all_finite(leaves):
    return all(bool(torch.isfinite(tensor.grad).all()) for tensor in leaves.tensors().values())


def checked_target(size, count, device):
    """Every label in some tiles of 5 x 7 pixels."""
    rows, columns = np.mgrid[: size[0], : size[1]]
    return torch.from_numpy(((rows // 5 + 2 * (columns // 7)) % (count + 1)).astype(np.uint8)).to(device)[None]


def one_scene(centre, semi_axes, perspective, *, turn=(0.0, 0.0, 0.0), focal=20.0, middle=(16.3, 11.8)):
    """An ellipsoid and, behind its middle, a ball of half a metre."""
    centres = np.array([centre, np.add(centre, (0.3, 0.2, 1.0))])
    axes = np.stack([Rotation.from_rotvec(turn).as_matrix(), np.eye(3)])
    numbers = centres, axes, np.array([semi_axes, (0.5, 0.5, 0.5)]), (focal, focal, *middle)
    near = 0.01 if perspective else -np.inf
    return reference.EllipsoidScene(*map(float32, numbers), np.array([1, 2]), perspective, near)


def faces(corners, labels, device="cpu"):
    """Triangles on the screen that share no vertices, as a leaf (1, 3 F, 3), and their mesh."""
    vertices = torch.tensor(np.reshape(corners, (1, -1, 3)), dtype=torch.float32, device=device, requires_grad=True)
    return vertices, PartMesh.from_faces(np.arange(vertices.shape[1]).reshape(-1, 3), np.array(labels), device=device)


def triangle(device="cpu"):
    return faces([[1, 1, 1], [6, 1, 1], [3, 6, 1]], [1], device)


def upright(centres, semi_axes, device="cpu"):
    """Ellipsoids of one body whose axes are the camera's, as leaves."""
    numbers = np.array(centres), np.stack([np.eye(3)] * len(centres)), np.array(semi_axes)
    return Ellipsoids(*(torch.tensor(v, dtype=torch.float32, device=device)[None].requires_grad_() for v in numbers))


def ball(batch=1, device="cpu"):
    leaves = Ellipsoids(
        torch.tensor([[[0.0, 0.0, 3.0]]], device=device).expand(batch, -1, -1),
        torch.eye(3, device=device).expand(batch, 1, 3, 3),
        torch.full((batch, 1, 3), 0.5, device=device),
    )
    camera = WeakPerspective(torch.full((batch,), 8.0, device=device), torch.full((batch, 2), 4.0, device=device))
    return leaves, camera
