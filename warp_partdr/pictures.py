"""Pictures of a fit, drawn with the project's own renderer: no window, no OpenGL."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch

from .body.rotations import rotation_from_axis_angle
from .body.skeletons import Skeleton
from .cameras import WeakPerspective
from .keypoints import Keypoints2D
from .mesh import ellipbody_mesh
from .palette import PART_COLOURS
from .posing import Posed
from .render import rasterize_parts

if TYPE_CHECKING:
    from PIL.Image import Image

_SUBDIVISIONS = 3
_LIGHT = np.array([-0.35, -0.6, -0.72])  # toward the light, camera frame
_AMBIENT = 0.45
_SAMPLES = 2  # a side, for smooth outlines


def shade_body(posed: Posed, camera: WeakPerspective, image_size: tuple[int, int]) -> np.ndarray:
    """The first body, coloured by part and lit, on nothing: RGBA, shape (H, W, 4), uint8."""
    height, width = image_size
    fine = WeakPerspective(camera.scale[:1] * _SAMPLES, camera.translation[:1] * _SAMPLES)
    mesh = ellipbody_mesh(_SUBDIVISIONS)
    points = posed.vertices(_SUBDIVISIONS)[:1].detach().cpu()
    fine = WeakPerspective(fine.scale.detach().cpu(), fine.translation.detach().cpu())
    image = rasterize_parts(fine.project(points), mesh, (height * _SAMPLES, width * _SAMPLES))
    corners = points[0].numpy()[mesh.faces.numpy()]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12
    light = _LIGHT / np.linalg.norm(_LIGHT)
    brightness = _AMBIENT + (1 - _AMBIENT) * np.clip(normals @ light, 0, 1)
    index, labels = image.face_index[0].numpy(), image.labels[0].numpy()
    rgba = np.zeros((*labels.shape, 4), dtype=np.float32)
    rgba[..., :3] = PART_COLOURS[labels] * brightness[index][..., None]
    rgba[..., 3] = 255.0 * (labels > 0)
    rgba[..., :3] *= rgba[..., 3:] > 0
    # Colours count by how much of them is there, or outlines would turn dark.
    blocks = rgba.reshape(height, _SAMPLES, width, _SAMPLES, 4)
    alpha = blocks[..., 3].sum((1, 3))
    colour = (blocks[..., :3] * blocks[..., 3:]).sum((1, 3)) / np.maximum(alpha, 1)[..., None]
    return np.concatenate([colour, alpha[..., None] / _SAMPLES**2], axis=-1).clip(0, 255).astype(np.uint8)


def blend(photo: np.ndarray, rgba: np.ndarray, opacity: float) -> np.ndarray:
    """``rgba`` over ``photo``, shape (H, W, 3), uint8."""
    alpha = rgba[..., 3:].astype(np.float32) / 255 * opacity
    return (photo * (1 - alpha) + rgba[..., :3] * alpha).astype(np.uint8)


def draw_keypoints(image: Image, keypoints: Keypoints2D) -> None:
    """Bones and dots of the confident keypoints, onto a picture."""
    from PIL import ImageDraw

    draw = ImageDraw.Draw(image)
    sure = keypoints.confident
    radius = max(image.size) / 250
    skeleton: Skeleton = keypoints.format
    for a, b in skeleton.edges:
        if sure[a] and sure[b]:
            draw.line([*map(float, keypoints.points[a]), *map(float, keypoints.points[b])], fill="black", width=3)
            draw.line([*map(float, keypoints.points[a]), *map(float, keypoints.points[b])], fill="white", width=1)
    for (x, y), there in zip(keypoints.points.tolist(), sure, strict=True):
        if there:
            draw.ellipse([x - radius, y - radius, x + radius, y + radius], fill="white", outline="black")


def turntable(posed: Posed, angles: tuple[tuple[float, float], ...], size: int = 320) -> list[np.ndarray]:
    """The first body from other sides on white, RGB (size, size, 3) each.

    Args:
        posed: Bodies in the camera frame.
        angles: (turn about the vertical, tilt about the horizontal) of the body [degrees]; (0, 0) is the photo's view.
        size: [px].
    """
    joints = posed.joints[:1].detach().cpu()
    middle = (joints.amax(1) + joints.amin(1)) / 2
    reach = float((joints - middle[:, None]).norm(dim=-1).max()) * 1.15 + 0.05
    pictures = []
    for turn, tilt in angles:
        spin = rotation_from_axis_angle(torch.tensor([0.0, float(np.deg2rad(turn)), 0.0]))
        tip = rotation_from_axis_angle(torch.tensor([float(np.deg2rad(tilt)), 0.0, 0.0]))
        rotation = tip @ spin
        moved = Posed(
            joints=joints,
            rotations=posed.rotations[:1].detach().cpu(),
            centres=(posed.centres[:1].detach().cpu() - middle) @ rotation.T,
            axes=rotation @ posed.axes[:1].detach().cpu(),
            semi_axes=posed.semi_axes[:1].detach().cpu(),
        )
        camera = WeakPerspective(torch.tensor([size / 2 / reach]), torch.full((1, 2), size / 2))
        white = np.full((size, size, 3), 255, dtype=np.uint8)
        pictures.append(blend(white, shade_body(moved, camera, (size, size)), 1.0))
    return pictures
