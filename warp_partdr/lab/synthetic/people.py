"""Anny people of known truth: their phenotypes, how they stand before a camera, what is drawn and what is hidden."""

from __future__ import annotations

import numpy as np
import torch

from ...body.posing import Posed
from ...body.rotations import rotation_between, rotation_from_axis_angle
from ...body.template import BONE_STARTS, JOINT_NAMES, LOCKED_PARTS, SHAPE_INDICES, template
from ...cameras import Camera
from ...interop.device_cache import device_cache
from ...models.anny import PHENOTYPE_ANCHORS, anny
from ...models.model import Detailed, DetailedModel, detailed_mesh
from ...models.pose import pose_from_ellipbody
from ...render.mesh import draw_mesh
from ...render.part_mesh import PartMesh

# Uniform between: Anny's ages 1/3, 2/3 and 1 are a child, young and old. With these heights, children are about 1.1 m
# to 1.5 m tall, adults 1.4 m to 1.9 m.
PHENOTYPES: dict[str, tuple[float, float]] = {
    "gender": (0.0, 1.0),
    "age": (1 / 3, 1.0),
    "muscle": (0.2, 0.8),
    "weight": (0.2, 0.8),
    "height": (0.2, 0.5),
    "proportions": (0.0, 1.0),
}
PHENOTYPE_RANGES: np.ndarray = np.array([PHENOTYPES[name] for name in PHENOTYPE_ANCHORS])  # (6, 2)

_FACE_COVER = 0.04  # [m]: how much nearer than a point of the face a surface must be to hide it


def pose_anny(model: DetailedModel, shape: torch.Tensor, posed: Posed) -> Detailed:
    """Anny of shape values (B, S) in the poses of EllipBodies, in their frame [m]."""
    return model.pose(shape, *pose_from_ellipbody(model, posed, shape))


def upright(ups: torch.Tensor, yaw: torch.Tensor) -> torch.Tensor:
    """Rotations of the pelvis in a world with y up, shape (B, 3, 3).

    Of upward unit vectors in its frame, ``ups`` (B, 3), and the heading about the vertical, ``yaw`` (B,) [rad]; 0 looks
    along z.
    """
    turned = rotation_between(ups, ups.new_tensor([0.0, 1.0, 0.0]).expand_as(ups))
    # The pelvis' own heading goes, so that the yaw alone says where the person looks.
    heading = torch.atan2(turned[:, 0, 2], turned[:, 2, 2])
    zero = torch.zeros_like(yaw)
    return rotation_from_axis_angle(torch.stack([zero, yaw - heading, zero], dim=1)) @ turned


def seen_by_camera(orientation: torch.Tensor, pitch: torch.Tensor, roll: torch.Tensor | None = None) -> torch.Tensor:
    """Orientations (B, 3, 3) of a world with y up, in the frame of a camera that a yaw of 0 faces.

    It looks down by ``pitch`` (B,) and is turned about its axis by ``roll`` (B,) [rad].
    """
    zero = torch.zeros_like(pitch)
    camera = rotation_from_axis_angle(torch.stack([pitch, zero, zero], dim=1))
    if roll is not None:
        camera = rotation_from_axis_angle(torch.stack([zero, zero, roll], dim=1)) @ camera
    return camera @ (orientation.new_tensor([1.0, -1.0, -1.0])[:, None] * orientation)


def rotations_along(directions: torch.Tensor, orientation: torch.Tensor, world: torch.Tensor) -> torch.Tensor:
    """Local rotations of EllipBody's parts along other bones, which lean a little otherwise, shape (B, 20, 3, 3).

    Args:
        directions: Directions of the bones, unit vectors, shape (B, 20, 3).
        orientation: Global orientation, shape (B, 3, 3).
        world: Rotations of the parts, which are turned until they point along the bones, shape (B, 20, 3, 3).
    """
    rest, above = _rest_bones(world.device, world.dtype)
    turned = rotation_between((world @ rest[..., None])[..., 0], directions) @ world
    turned[:, list(LOCKED_PARTS)] = orientation[:, None]
    return torch.cat([orientation[:, None], turned], dim=1)[:, above].mT @ turned


@device_cache(8)
def _rest_bones(device: torch.device, dtype: torch.dtype) -> tuple[torch.Tensor, torch.Tensor]:
    """Directions of the bones at rest, shape (20, 3), and the joints where they begin, shape (20,)."""
    return torch.from_numpy(template().rest_directions).to(device, dtype), torch.tensor(BONE_STARTS, device=device)


def anny_mesh(device: torch.device | str = "cpu") -> PartMesh:
    """Anny's mesh with labels 1 to 20."""
    return detailed_mesh(anny(device))


def draw_anny(vertices: torch.Tensor, camera: Camera, image_size: tuple[int, int]) -> tuple[torch.Tensor, torch.Tensor]:
    """Part labels and depth [m] of Anny bodies (B, V, 3) in the camera frame, shape (B, H, W) each."""
    picture = draw_mesh(vertices, anny_mesh(vertices.device), camera, image_size)
    return picture.labels, picture.depth


def cover_of(landmarks: tuple[str, ...]) -> np.ndarray:
    """Distance by which a surface must be nearer than a landmark of a mean adult to hide it [m], shape (L,).

    Joints lie inside the body: what hides one must be nearer by more than the thickness of the bone that ends there.
    """
    first = [template().mean_thicknesses[indices[1]] for indices in SHAPE_INDICES]
    thickness = dict(zip(JOINT_NAMES[1:], first, strict=True))
    thickness["mid_hip"] = thickness["left_hip"]
    return np.array([thickness.get(name, _FACE_COVER) for name in landmarks])


def pixel_indices(points: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
    """Indices into flat pictures (H, W) of the pixels that points (B, L, 2) [px] lie in or are nearest to, (B, L)."""
    height, width = size
    columns, rows = (points[..., i].long().clamp(0, side - 1) for i, side in enumerate((width, height)))
    return rows * width + columns


def behind_something(
    distances: torch.Tensor,  # (B, L) [m], of the landmarks from the camera
    pixels: torch.Tensor,  # (B, L), of ``pixel_indices``, in which they are seen
    depth: torch.Tensor,  # (B, H, W) [m], of what is drawn, inf = background
    cover: torch.Tensor,  # (B, L) or (L,), of ``cover_of``, of people of this size
) -> torch.Tensor:
    """Landmarks that lie behind something other than their own surroundings, shape (B, L), bool."""
    return depth.flatten(1).gather(1, pixels) < distances - cover
