"""PartDR's rule is one rule: the mesh's gradient comes to the exact renderer's, in length and in direction.

Both say how the loss changes as points of the surface move, so they are compared in the ellipsoids' own numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
import torch
from helpers.pictures import (
    CAMERAS,
    body_parameters,
    draw_on_screen,
    loss_on_screen,
    mesh_picture,
    push_on_screen,
)
from scipy.spatial.transform import Rotation

from warp_partdr import label_set
from warp_partdr.body.icosphere import icosphere
from warp_partdr.body.posing import Posed, pose
from warp_partdr.cameras import Perspective, WeakPerspective
from warp_partdr.reference import ellipsoids as ellipsoid_reference
from warp_partdr.reference import mesh as reference
from warp_partdr.reference.losses import label_gradient
from warp_partdr.render.ellipsoids import draw_ellipsoids, ellipsoid_label_loss
from warp_partdr.render.part_mesh import PartMesh, ellipbody_mesh

NAMES = ("centres", "axes", "semi_axes")


def assert_meets(have: np.ndarray, want: np.ndarray, within: float, least_cosine: float) -> None:
    """A gradient comes to another one in length and direction."""
    lengths = np.linalg.norm(have), np.linalg.norm(want)
    assert lengths[0] / lengths[1] == pytest.approx(1.0, abs=within)
    assert (have * want).sum() / (lengths[0] * lengths[1]) > least_cosine


# --- The definitions, in float64 ---------------------------------------------------------------------------------

SIZE = (40, 44)


def two_ellipsoids(perspective: bool, shift: float = 0.0) -> ellipsoid_reference.EllipsoidScene:
    """One before the other; ``shift`` [m] moves the one behind to the right."""
    centres = np.array([[0.0, 0.1, 2.6], [0.1 + shift, -0.15, 3.0]])
    axes = Rotation.from_rotvec([[0.3, 0.5, 0.2], [-0.4, 0.1, 0.9]]).as_matrix()
    semi_axes = np.array([[0.24, 0.4, 0.3], [0.45, 0.2, 0.3]])
    focal = 74.0 if perspective else 26.0
    camera = np.array([focal, focal, 22.3, 19.8])
    return ellipsoid_reference.EllipsoidScene(centres, axes, semi_axes, camera, np.array([1, 2]), perspective)


@dataclass(frozen=True)
class Meshes:
    """Icospheres in place of a scene's ellipsoids.

    Attributes:
        points: Of the surface, ellipsoid by ellipsoid, shape (V, 3) [m].
        mesh: The same as the camera sees them.
    """

    scene: ellipsoid_reference.EllipsoidScene
    points: np.ndarray
    mesh: reference.MeshScene

    @classmethod
    def of(cls, scene: ellipsoid_reference.EllipsoidScene, level: int) -> Meshes:
        sphere, faces = icosphere(level)
        points = scene.centres[:, None] + np.einsum("pij,pj,vj->pvi", scene.axes, scene.semi_axes, sphere)
        points = points.reshape(-1, 3)
        across = points[:, :2] / (points[:, 2:] if scene.perspective else 1.0)
        vertices = np.concatenate([across * scene.camera[:2] + scene.camera[2:], points[:, 2:]], 1)
        faces = np.concatenate([faces + k * len(sphere) for k in range(len(scene.labels))])
        labels = np.repeat(scene.labels, len(faces) // len(scene.labels))
        return cls(scene, points, reference.MeshScene(vertices, faces, labels, scene.perspective))

    def picture(self) -> reference.MeshPicture:
        """One body, on the CPU."""
        mesh = PartMesh.from_faces(self.mesh.faces, self.mesh.labels)
        vertices = torch.from_numpy(self.mesh.vertices)[None].float()
        return mesh_picture(draw_on_screen(vertices, mesh, SIZE, perspective=self.scene.perspective))

    def forces(self, grad: np.ndarray) -> ellipsoid_reference.EllipsoidForces:
        """A gradient of the vertices as one of the ellipsoids."""
        forces = ellipsoid_reference.EllipsoidForces(self.scene)
        for k, point, force in zip(np.repeat([0, 1], len(grad) // 2), self.points, grad, strict=True):
            forces.push_image(k, point, force[:2])
            forces.push(k, point, np.array([0.0, 0.0, force[2]]))
        return forces


def check_meets(have: ellipsoid_reference.EllipsoidForces, want: ellipsoid_reference.EllipsoidForces) -> None:
    for name in NAMES:
        assert_meets(getattr(have, name), getattr(want, name), 0.03, 0.997)


@pytest.mark.parametrize("shift", [0.03, 0.6], ids=["near", "far"])
@pytest.mark.parametrize("perspective", CAMERAS)
def test_the_definitions_meet_in_x_and_y(perspective, shift):
    """Icospheres come to the ellipsoids they stand for; two pixels of the finer ones' picture differ from theirs."""
    scene = two_ellipsoids(perspective)
    labels, parts, _ = ellipsoid_reference.ray_cast(scene, SIZE)
    target = ellipsoid_reference.ray_cast(two_ellipsoids(perspective, shift), SIZE)[0]
    g = label_gradient(labels, target, 2)
    want = ellipsoid_reference.partdr_gradient(scene, parts, g, depth_weight=0.0)
    errors = []
    for level in (1, 3):
        meshes = Meshes.of(scene, level)
        have = meshes.forces(reference.gradient(meshes.mesh, meshes.picture(), g, depth_weight=0.0))
        errors.append([np.linalg.norm(getattr(have, name) - getattr(want, name)) for name in NAMES])
    check_meets(have, want)
    assert (np.array(errors[1]) < np.array(errors[0])).all()


@pytest.mark.parametrize("perspective", CAMERAS)
def test_the_definitions_meet_in_z(perspective):
    """Pixels where part 2 should be seen and is hidden."""
    scene = two_ellipsoids(perspective)
    labels, parts, _ = ellipsoid_reference.ray_cast(scene, SIZE)
    g = np.zeros((2, *SIZE))
    g[1, 16:23, 20:29] = -2.0
    want = ellipsoid_reference.EllipsoidForces(scene)
    ellipsoid_reference.add_depth_forces(want, labels, parts, g, 1.0)
    meshes = Meshes.of(scene, 3)
    picture = meshes.picture()
    picture = picture._replace(labels=np.where(g[1] != 0, picture.labels, 0))  # the slow reference looks nowhere else
    grad = np.zeros_like(meshes.points)
    grad[:, 2] = reference.depth_gradient(meshes.mesh, picture, g, 1.0)
    check_meets(meshes.forces(grad), want)


# --- The renderers -----------------------------------------------------------------------------------------------

# How far E3's length may be from 1, and its least cosine. Sizes and turns hang on few pixels near the target, and so
# does z: where the two pictures differ, so do they.
LIMITS = {"x, y": (0.02, 0.998), "z": (0.04, 0.995), "axes": (0.05, 0.98), "semi_axes": (0.05, 0.98)}


@cache
def bodies(kind: str, perspective: bool, device: str) -> Posed:
    """The mean body: from the front, where many faces are seen edge-on, or turned and in a pose of its own."""
    turn, turns = np.diag([1.0, -1.0, -1.0]), np.zeros((20, 3))
    if kind == "posed":
        turn = Rotation.from_rotvec([0.2, 0.7, 0.1]).as_matrix() @ turn
        turns = np.random.default_rng(3).normal(0, 0.4, (20, 3))
    own = {"global_orient": turn, "rotations": Rotation.from_rotvec(turns).as_matrix()}
    own["translation"] = np.array([0.0, 0.0, 3.0 if perspective else 0.0])
    own = {name: torch.tensor(value[None], dtype=torch.float32, device=device) for name, value in own.items()}
    return pose(**body_parameters(0, device) | own)


def camera_of(size: int, perspective: bool, device: str) -> WeakPerspective | Perspective:
    middle = torch.full((1, 2), size / 2.0, device=device)
    if perspective:
        return Perspective(torch.full((1, 2), size * 1.4, device=device), middle)
    return WeakPerspective(torch.full((1,), size / 2.0, device=device), middle)


def gradients(posed: Posed, loss_of: Callable[[Posed], torch.Tensor]) -> dict[str, np.ndarray]:
    """Gradients of the ellipsoids' numbers; centres' x and y apart from z."""
    leaves = {name: getattr(posed, name).detach().clone().requires_grad_() for name in NAMES}
    loss_of(Posed(posed.joints, posed.rotations, **leaves)).sum().backward()
    found = {name: leaf.grad[0].cpu().numpy().astype(float) for name, leaf in leaves.items()}
    centres = found.pop("centres")
    return {"x, y": centres[:, :2], "z": centres[:, 2], **found}


@pytest.mark.parametrize("labels", ["parts", "lsp6"])
@pytest.mark.parametrize("shift", [0.02, 0.2], ids=["near", "far"])
@pytest.mark.parametrize("perspective", CAMERAS)
@pytest.mark.parametrize("kind", ["frontal", "posed"])
def test_meshes_come_to_the_exact_gradient(device, kind, perspective, shift, labels):
    """A body whose target is the same body elsewhere; finer meshes' pictures come to the ellipsoids', too."""
    posed, camera, size = bodies(kind, perspective, device), camera_of(256, perspective, device), (256, 256)
    groups = None if labels == "parts" else label_set(labels).part_groups
    part_labels = None if groups is None else groups[1:]
    move = shift * torch.tensor([0.8, 0.6, 0.0], device=device)
    there = Posed(posed.joints, posed.rotations, posed.centres + move, posed.axes, posed.semi_axes)
    target = draw_ellipsoids(there, camera, size, part_labels=part_labels).labels

    def exact_loss(body: Posed) -> torch.Tensor:
        return ellipsoid_label_loss(body, camera, target, part_labels=part_labels, gradient="partdr")[0]

    def mesh_loss(body: Posed, level: int) -> torch.Tensor:
        mesh = ellipbody_mesh(level, device=device)
        mesh = mesh if groups is None else mesh.relabel(groups)
        return loss_on_screen(camera.project(body.vertices(level)), mesh, target, perspective=perspective)[0]

    want = gradients(posed, exact_loss)
    if kind == "frontal":
        del want["z"]  # few pixels are hidden there
    errors = []
    for level in (1, 2, 3):
        have = gradients(posed, lambda body, level=level: mesh_loss(body, level))
        errors.append([np.linalg.norm(have[name] - want[name]) for name in want])
    for name in want:
        assert_meets(have[name], want[name], *LIMITS[name])
    first, middle, last = np.array(errors)
    assert first[0] > middle[0] > last[0]  # x, y
    assert (first > last).all()


def test_a_box_seen_head_on_is_pulled_as_one_square(device):
    """Its sides have no area: of the edges before and behind them, each counts half."""
    square = torch.tensor([[6.2, 5.3], [14.7, 5.3], [14.7, 13.8], [6.2, 13.8]])
    front, back = (torch.cat([square, torch.full((4, 1), depth)], 1) for depth in (1.0, 2.0))
    faces = [[0, 1, 2], [0, 2, 3], [4, 6, 5], [4, 7, 6]]
    for k in range(4):
        after = (k + 1) % 4
        faces += [[k, 4 + k, after], [after, 4 + k, 4 + after]]
    target = torch.zeros(1, 20, 24, dtype=torch.uint8, device=device)
    target[:, 7:16, 9:20] = 1
    pulls = []
    for vertices, some_faces in ((front, faces[:2]), (torch.cat([front, back]), faces)):
        mesh = PartMesh.from_faces(np.array(some_faces), np.ones(len(some_faces)), device=device)
        leaf = vertices[None].to(device).requires_grad_()
        push_on_screen(leaf, mesh, target)
        pulls.append(leaf.grad[0].sum(0).cpu())
    assert pulls[0][:2].abs().min() > 10
    torch.testing.assert_close(pulls[1], pulls[0])
