"""Bodies as shaded pictures, drawn with the project's own renderer: no window, no OpenGL."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from ..body.posing import Posed
from ..body.rotations import rotation_from_axis_angle
from ..cameras import Camera, Crop, WeakPerspective, first_of
from ..models.model import Detailed, DetailedModel, detailed_mesh
from ..render.mesh import draw_mesh
from ..render.part_mesh import PartMesh, ellipbody_mesh
from .palette import PART_COLOURS

_SUBDIVISIONS = 3
_LIGHT = np.array([-0.35, -0.6, -0.72])  # toward the light, camera frame
_AMBIENT = 0.45
SKIN_COLOUR = np.array([196, 208, 226], dtype=np.uint8)  # apart from people's
_SAMPLES = 2  # a side, for smooth outlines


def shade_body(posed: Posed, camera: Camera, image_size: tuple[int, int]) -> np.ndarray:
    """The first body's ellipsoids, coloured by part and lit, on nothing: RGBA, shape (H, W, 4), uint8."""
    mesh = ellipbody_mesh(_SUBDIVISIONS)
    return shade_mesh(posed.vertices(_SUBDIVISIONS)[:1], mesh, camera, image_size, PART_COLOURS)


def shade_detailed(detailed: Detailed, model: DetailedModel, camera: Camera, image_size: tuple[int, int]) -> np.ndarray:
    """The first body's skin in one colour, lit, on nothing: RGBA, shape (H, W, 4), uint8."""
    return shade_skin(detailed.vertices, model, camera, image_size)


def shade_skin(
    vertices: torch.Tensor,
    model: DetailedModel,
    camera: Camera,
    image_size: tuple[int, int],
    colour: np.ndarray = SKIN_COLOUR,
) -> np.ndarray:
    """Skin of the first body with these vertices, (B, V, 3) in the camera frame [m], as ``shade_detailed`` has it.

    Args:
        vertices: Of the model's bodies.
        model: The model.
        camera: The camera.
        image_size: (H, W) of the picture [px].
        colour: RGB, shape (3,), uint8.
    """
    colours = np.broadcast_to(colour, PART_COLOURS.shape)
    return shade_mesh(vertices[:1], detailed_mesh(model).to("cpu"), camera, image_size, colours)


def shade_mesh(
    vertices: torch.Tensor, mesh: PartMesh, camera: Camera, image_size: tuple[int, int], colours: np.ndarray
) -> np.ndarray:
    """A mesh with vertices (1, V, 3) in the camera frame [m], in the colours of its labels: RGBA, (H, W, 4), uint8."""
    points, camera = vertices.detach().cpu(), first_of(camera).to("cpu")
    rgba = np.zeros((*image_size, 4), dtype=np.uint8)
    rows, columns = _window(points, camera, image_size)  # most of a photo shows no body
    size = (rows.stop - rows.start) * _SAMPLES, (columns.stop - columns.start) * _SAMPLES
    if 0 in size:
        return rgba
    image = draw_mesh(points, mesh, camera.in_crop(Crop(columns.start, rows.start, _SAMPLES, size)), size)
    corners = points[0].numpy()[mesh.faces.numpy()]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12
    light = _LIGHT / np.linalg.norm(_LIGHT)
    brightness = _AMBIENT + (1 - _AMBIENT) * np.clip(normals @ light, 0, 1)
    index, labels = (each[0].numpy() for each in (image.face_index, image.labels))
    # Colours count by how much of them is there, or outlines would turn dark.
    covered = (labels > 0)[..., None].astype(np.float32)
    colour = colours[labels] * brightness[index][..., None].astype(np.float32) * covered
    colour, alpha = (
        each.reshape(labels.shape[0] // _SAMPLES, _SAMPLES, labels.shape[1] // _SAMPLES, _SAMPLES, each.shape[-1]).sum(
            (1, 3)
        )
        for each in (colour, covered)
    )
    shaded = np.concatenate([colour / np.maximum(alpha, 1), alpha * 255.0 / _SAMPLES**2], axis=-1)
    rgba[rows, columns] = shaded.clip(0, 255).astype(np.uint8)
    return rgba


def _window(vertices: torch.Tensor, camera: Camera, size: tuple[int, int]) -> tuple[slice, slice]:
    """Rows and columns of a picture of (H, W) pixels that may show a body with these vertices, (1, V, 3)."""
    seen = camera.project(vertices)[0]
    if camera.perspective and bool((seen[:, 2] <= 0).any()):  # partly behind the camera, where no place is true
        return slice(0, size[0]), slice(0, size[1])
    low, high = seen[:, :2].amin(0).floor().long().tolist(), seen[:, :2].amax(0).ceil().long().tolist()
    low, high = ([min(max(edge, 0), side) for edge, side in zip(each, size[::-1], strict=True)] for each in (low, high))
    return slice(low[1], high[1]), slice(low[0], high[0])


def _seen(shown: np.ndarray) -> tuple[slice, slice]:
    """Rows and columns that hold what is shown, (H, W)."""
    rows, columns = (np.flatnonzero(shown.any(axis)) for axis in (1, 0))
    if not len(rows):
        return slice(0, 0), slice(0, 0)
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def blend(photo: np.ndarray, rgba: np.ndarray, opacity: float) -> np.ndarray:
    """``rgba`` over ``photo``, shape (H, W, 3), uint8."""
    blended, seen = photo.copy(), _seen(rgba[..., 3] > 0)
    alpha = rgba[seen][..., 3:].astype(np.float32) / 255 * opacity
    blended[seen] = (photo[seen] * (1 - alpha) + rgba[seen][..., :3] * alpha).astype(np.uint8)
    return blended


def turntable_views(posed: Posed, angles: tuple[tuple[float, float], ...], size: int = 320) -> list[np.ndarray]:
    """The first body from other sides on white, RGB (size, size, 3) each.

    Its turn about the vertical and tilt about the horizontal are ``angles`` [degrees]; (0, 0) is the photo's view.
    """
    body = Posed(*(tensor[:1].detach().cpu() for tensor in vars(posed).values()))
    middle = (body.joints.amax(1) + body.joints.amin(1)) / 2
    reach = float((body.joints - middle[:, None]).norm(dim=-1).max()) * 1.15 + 0.05
    camera = WeakPerspective(torch.tensor([size / 2 / reach]), torch.full((1, 2), size / 2))
    white = np.full((size, size, 3), 255, dtype=np.uint8)
    pictures = []
    for turn, tilt in np.deg2rad(angles).tolist():
        spin, tip = (rotation_from_axis_angle(torch.tensor(vector)) for vector in ([0.0, turn, 0.0], [tilt, 0.0, 0.0]))
        rotation = tip @ spin
        moved = replace(body, centres=(body.centres - middle) @ rotation.T, axes=rotation @ body.axes)
        pictures.append(blend(white, shade_body(moved, camera, (size, size)), 1.0))
    return pictures
