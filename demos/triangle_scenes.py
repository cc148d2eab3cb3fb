"""Two rigid triangles, three supervisions, and the optimisation of the paper's figure 3 (``two_triangles.py``)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from warp_partdr import PartMesh, ScreenCamera, draw_mesh, mesh_label_loss

IMAGE_SIZE = (64, 80)  # (H, W)
CAMERA = ScreenCamera(perspective=False)
NEAR_DEPTH, FAR_DEPTH = 2.0, 2.2  # [m] of the triangle in front and of the one behind, at the start and in the target

ITERATIONS = 200
LEARNING_RATE = 1.0  # [px] an iteration, at first
DEPTH_LEARNING_RATE = 0.02  # [m] an iteration: a tenth of the depth between the triangles
DECAY = 0.98  # of both learning rates, an iteration: steps end below a pixel

REACHED_IOU = 0.9  # of the worse part
REACHED_DISTANCE = 2.0  # [px] of the worse triangle


@dataclass(frozen=True)
class Supervision:
    """Supervision of the optimisation: its name, what the loss compares, and how."""

    name: str
    note: str
    parts: bool  # whether the target tells A from B, or both are one label
    depth_weight: float  # the paper's lambda (eq. 12); 0 takes the z gradient away


FULL = Supervision("Full silhouette", "The target is one label. Nothing tells A from B or which is in front.", False, 1)
PARTS_WITHOUT_DEPTH = Supervision("Parts, no depth gradient", "The target has two labels; z stays as it was.", True, 0)
PARTS = Supervision("Parts (PartDR)", "The target has two labels; hidden parts come forward (eq. 12).", True, 1)


@dataclass(frozen=True)
class Scenes:
    """S scenes of two triangles each; vertices (S, 6, 3) are (u [px], v [px], z [m]), A's three first."""

    mesh: PartMesh  # A has label 1 and B has label 2
    start: torch.Tensor
    goal: torch.Tensor
    target: torch.Tensor  # part labels of the goal, all that the optimisation sees, (S, H, W), uint8


@dataclass(frozen=True)
class Outcome:
    """Distances of S scenes from their goals, each of shape (S,)."""

    iou: torch.Tensor  # intersection over union of the visible part, the worse of A and B
    silhouette_iou: torch.Tensor  # the same of the union of both
    distance: torch.Tensor  # of a triangle from its place [px], the worse of A and B
    in_order: torch.Tensor  # whether A is behind B

    @property
    def in_place(self) -> torch.Tensor:
        """True where both triangles are in their places, in whatever order."""
        return self.distance < REACHED_DISTANCE

    @property
    def reached(self) -> torch.Tensor:
        """True where the parts look as the target does, in the right order."""
        return (self.iou > REACHED_IOU) & self.in_order


def triangles_mesh(device: torch.device | str) -> PartMesh:
    """A (label 1) and B (label 2)."""
    return PartMesh.from_faces(np.arange(6).reshape(2, 3), np.array([1, 2]), device=device)


def place(shapes: np.ndarray, centres: np.ndarray, depths: tuple[float, float]) -> np.ndarray:
    """Vertices (6, 3) from corners about the centre (2, 3, 2) [px], centres (2, 2) [px] and depths of A and B [m]."""
    depth = np.broadcast_to(np.array(depths)[:, None, None], (2, 3, 1))
    return np.concatenate([shapes + centres[:, None], depth], axis=2).reshape(6, 3).astype(np.float32)


def _scenes(pairs: list[np.ndarray], device: torch.device | str) -> Scenes:
    """Scenes of pairs of starts and goals, shape (2, 6, 3) each, with the labels that the goals show."""
    mesh = triangles_mesh(device)
    start, goal = torch.from_numpy(np.stack(pairs, axis=1)).to(device)
    return Scenes(mesh, start, goal, draw_mesh(goal, mesh, CAMERA, IMAGE_SIZE).labels)


def fixed_scene(device: torch.device | str = "cpu") -> Scenes:
    """The picture's scene: A starts in front of B, near B's place, and B near A's."""
    shapes = np.array([[(-15, 11), (14, 9), (1, -20)]] * 2, dtype=float)
    goal = place(shapes, np.array([(31, 30), (44, 36)]), (FAR_DEPTH, NEAR_DEPTH))
    start = place(shapes, np.array([(54, 28), (39, 42)]), (NEAR_DEPTH, FAR_DEPTH))
    return _scenes([np.stack([start, goal])], device)


def random_scenes(count: int, *, alike: bool, device: torch.device | str = "cpu") -> Scenes:
    """Scenes whose target shows 30 to 80 % of A and whose start shows 20 to 95 % of B.

    If they are ``alike``, both triangles have one shape and each starts near the other's place (within 6 px along
    either axis); otherwise shapes differ and each triangle starts anywhere.
    """
    rng = np.random.default_rng(0)
    height, width = IMAGE_SIZE
    pairs: list[np.ndarray] = []
    while len(pairs) < count:
        angles, radii = np.sort(rng.uniform(0, 2 * np.pi, (2, 3)), axis=1), rng.uniform(10, 18, (2, 3))
        shapes = radii[..., None] * np.stack([np.cos(angles), np.sin(angles)], axis=2)
        shapes -= shapes.mean(axis=1, keepdims=True)
        if alike:
            shapes[1] = shapes[0]
        centres, start_centres = rng.uniform(18, (width - 18, height - 18), (2, 2, 2))
        if alike:
            start_centres = centres[::-1] + rng.uniform(-6, 6, (2, 2))
        goal = place(shapes, centres, (FAR_DEPTH, NEAR_DEPTH))
        start = place(shapes, start_centres, (NEAR_DEPTH, FAR_DEPTH))
        if _is_fair(pair := np.stack([start, goal]), device):
            pairs.append(pair)
    return _scenes(pairs, device)


def _is_fair(pair: np.ndarray, device: torch.device | str) -> bool:
    """True if nothing is a sliver or out of the picture, and the triangles overlap as ``random_scenes`` says."""
    areas = np.abs(np.linalg.det(np.diff(pair.reshape(4, 3, 3)[..., :2], axis=1))) / 2
    if areas.min() < 150 or pair[..., :2].min() < 0 or (pair[..., :2] > IMAGE_SIZE[::-1]).any():
        return False
    vertices = torch.from_numpy(pair).to(device)
    labels = draw_mesh(vertices, triangles_mesh(device), CAMERA, IMAGE_SIZE).labels.cpu().numpy()
    shown_b, shown_a = (labels[0] == 2).sum() / areas[1], (labels[1] == 1).sum() / areas[2]
    return bool(0.2 < shown_b < 0.95 and 0.3 < shown_a < 0.8)


def optimize(scenes: Scenes, supervision: Supervision) -> torch.Tensor:
    """Move each triangle as a whole toward the target, S scenes side by side.

    Returns:
        Vertices before each iteration and after the last, shape (ITERATIONS + 1, S, 6, 3).
    """
    mesh, target = scenes.mesh, scenes.target
    if not supervision.parts:
        mesh, target = mesh.relabel({1: 1, 2: 1}), target.clamp(max=1)
    count, device = len(scenes.start), scenes.start.device
    shift = torch.zeros(count, 2, 1, 2, device=device, requires_grad=True)  # [px]
    advance = torch.zeros(count, 2, 1, 1, device=device, requires_grad=True)  # [m]
    # Adam divides each coordinate's gradient by its own size, so neither lambda nor the loss's scale has to be chosen.
    rates = {LEARNING_RATE: shift, DEPTH_LEARNING_RATE: advance}
    optimizer = torch.optim.Adam([{"params": [moved], "lr": rate} for rate, moved in rates.items()])
    schedule = torch.optim.lr_scheduler.ExponentialLR(optimizer, DECAY)

    def vertices() -> torch.Tensor:
        return (scenes.start.view(count, 2, 3, 3) + torch.cat([shift, advance], dim=3)).flatten(1, 2)

    course = [vertices().detach()]
    for iteration in range(ITERATIONS):
        first = iteration == 0  # the target stays, so it is checked once
        weight = supervision.depth_weight
        loss, _ = mesh_label_loss(vertices(), mesh, CAMERA, target, depth_weight=weight, validate=first)
        optimizer.zero_grad()
        loss.sum().backward()
        optimizer.step()
        schedule.step()
        course.append(vertices().detach())
    return torch.stack(course)


def judge(scenes: Scenes, vertices: torch.Tensor) -> Outcome:
    """Compare vertices of shape (S, 6, 3) with the goal."""
    labels = draw_mesh(vertices, scenes.mesh, CAMERA, IMAGE_SIZE).labels

    def iou(have: torch.Tensor, want: torch.Tensor) -> torch.Tensor:
        return (have & want).sum((1, 2)) / (have | want).sum((1, 2))

    moved = (vertices - scenes.goal)[:, ::3, :2]  # one corner tells of the whole triangle: it is rigid
    return Outcome(
        iou=torch.minimum(*(iou(labels == part, scenes.target == part) for part in (1, 2))),
        silhouette_iou=iou(labels > 0, scenes.target > 0),
        distance=moved.norm(dim=2).amax(1),
        in_order=vertices[:, 0, 2] > vertices[:, 3, 2],
    )
