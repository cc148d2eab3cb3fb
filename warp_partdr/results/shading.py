"""Bodies as shaded pictures, drawn with the project's own renderer: no window, no OpenGL."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from ..body.posing import Posed
from ..body.rotations import rotation_from_axis_angle
from ..cameras import Camera, Crop, WeakPerspective, first_of
from ..inputs.person import label_bounds
from ..models.model import Detailed, DetailedModel, detailed_mesh
from ..render.mesh import draw_mesh
from ..render.part_mesh import PartMesh, ellipbody_mesh
from .palette import PART_COLOURS

_SUBDIVISIONS = 3
_LIGHT = np.array([-0.35, -0.6, -0.72])  # direction toward the light, camera frame
_AMBIENT = 0.45
SKIN_COLOUR = np.array([196, 208, 226], dtype=np.uint8)  # unlike all PEOPLE_COLOURS
_SAMPLES = 2  # samples of a pixel in each direction, for smooth outlines


def shade_body(posed: Posed, camera: Camera, image_size: tuple[int, int]) -> np.ndarray:
    """Draw the first body's ellipsoids, coloured by part and lit, on a transparent ground: RGBA, (H, W, 4), uint8.

    Examples:
        >>> from PIL import Image
        >>> from warp_partdr import BodyParameters
        >>> from warp_partdr.plot import shade_body
        >>> body = BodyParameters.mean(1)
        >>> picture = shade_body(body.posed(), body.camera(256), (256, 256))
        >>> Image.fromarray(picture).save("body.png")  # with a transparent ground
        >>> picture.shape
        (256, 256, 4)
    """
    mesh = ellipbody_mesh(_SUBDIVISIONS)
    return shade_mesh(posed.vertices(_SUBDIVISIONS)[:1], mesh, camera, image_size, PART_COLOURS)


def shade_detailed(detailed: Detailed, model: DetailedModel, camera: Camera, image_size: tuple[int, int]) -> np.ndarray:
    """Draw the first body's skin in one colour, lit, on a transparent ground: RGBA, shape (H, W, 4), uint8.

    Examples:
        After ``mesh = refine_mesh(result)``:

        >>> from warp_partdr.plot import shade_detailed
        >>> shade_detailed(mesh.body.detailed, mesh.body.model, mesh.camera, (512, 384)).shape
        (512, 384, 4)
    """
    return shade_skin(detailed.vertices, model, camera, image_size)


def shade_skin(
    vertices: torch.Tensor,
    model: DetailedModel,
    camera: Camera,
    image_size: tuple[int, int],
    colour: np.ndarray = SKIN_COLOUR,
) -> np.ndarray:
    """Draw the skin of the first body with given vertices, like ``shade_detailed``: RGBA, shape (H, W, 4), uint8.

    Args:
        vertices: Vertices of the model's bodies in the camera frame [m], shape (B, V, 3).
        model: Model of the bodies.
        camera: Camera of the picture.
        image_size: Size (H, W) of the picture [px].
        colour: Colour of the skin, RGB, shape (3,), uint8.
    """
    colours = np.broadcast_to(colour, PART_COLOURS.shape)
    return shade_mesh(vertices[:1], detailed_mesh(model).to("cpu"), camera, image_size, colours)


def shade_mesh(
    vertices: torch.Tensor, mesh: PartMesh, camera: Camera, image_size: tuple[int, int], colours: np.ndarray
) -> np.ndarray:
    """Draw a mesh with vertices (1, V, 3) in the camera frame [m] in its labels' colours: RGBA, (H, W, 4), uint8."""
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
    index = image.face_index[0].numpy()
    labels = image.labels[0].numpy()
    # Colours are weighted by the covered share of a pixel, or outlines would turn dark.
    covered = (labels > 0)[..., None].astype(np.float32)
    colour = _sum_samples(colours[labels] * brightness[index][..., None].astype(np.float32) * covered)
    alpha = _sum_samples(covered)
    shaded = np.concatenate([colour / np.maximum(alpha, 1), alpha * 255.0 / _SAMPLES**2], axis=-1)
    rgba[rows, columns] = shaded.clip(0, 255).astype(np.uint8)
    return rgba


def _sum_samples(samples: np.ndarray) -> np.ndarray:
    """Sums over the samples of each pixel: (H S, W S, C) to (H, W, C)."""
    height, width, channels = samples.shape
    sums: np.ndarray = samples.reshape(height // _SAMPLES, _SAMPLES, width // _SAMPLES, _SAMPLES, channels).sum((1, 3))
    return sums


def _window(vertices: torch.Tensor, camera: Camera, size: tuple[int, int]) -> tuple[slice, slice]:
    """Rows and columns of a picture of (H, W) pixels that may show a body with these vertices, (1, V, 3)."""
    projected = camera.project(vertices)[0]
    if camera.perspective and bool((projected[:, 2] <= 0).any()):  # points behind the camera have no true position
        return slice(0, size[0]), slice(0, size[1])
    left, top = projected[:, :2].amin(0).floor().long().tolist()
    right, bottom = projected[:, :2].amax(0).ceil().long().tolist()
    height, width = size
    rows = slice(min(max(top, 0), height), min(max(bottom, 0), height))
    return rows, slice(min(max(left, 0), width), min(max(right, 0), width))


def blend(photo: np.ndarray, rgba: np.ndarray, opacity: float) -> np.ndarray:
    """Blend ``rgba`` over ``photo``, shape (H, W, 3), uint8.

    Examples:
        >>> from warp_partdr import BodyParameters, read_photo
        >>> from warp_partdr.plot import blend, shade_body
        >>> photo, body = read_photo("photo.png"), BodyParameters.mean(1)
        >>> blend(photo, shade_body(body.posed(), body.camera(384), photo.shape[:2]), opacity=0.6).shape
        (512, 384, 3)
    """
    blended, used = photo.copy(), label_bounds(rgba[..., 3] > 0)
    alpha = rgba[used][..., 3:].astype(np.float32) / 255 * opacity
    blended[used] = (photo[used] * (1 - alpha) + rgba[used][..., :3] * alpha).astype(np.uint8)
    return blended


def turntable_views(posed: Posed, angles: tuple[tuple[float, float], ...], size: int = 320) -> list[np.ndarray]:
    """Draw the first body from other sides on white, RGB, shape (size, size, 3) each.

    Args:
        posed: Posed bodies.
        angles: Turns about the vertical and tilts about the horizontal [degrees]; (0, 0) is the photo's view.
        size: Side of the pictures [px].

    Examples:
        After ``result = fit_body(person, parts)``:

        >>> from PIL import Image
        >>> from warp_partdr.plot import turntable_views
        >>> front, side, above = turntable_views(result.posed, ((0, 0), (90, 0), (0, 90)), size=256)
        >>> Image.fromarray(side).save("side.png")
        >>> side.shape
        (256, 256, 3)
    """
    body = Posed(*(tensor[:1].detach().cpu() for tensor in vars(posed).values()))
    middle = (body.joints.amax(1) + body.joints.amin(1)) / 2
    reach = float((body.joints - middle[:, None]).norm(dim=-1).max()) * 1.15 + 0.05
    camera = WeakPerspective(torch.tensor([size / 2 / reach]), torch.full((1, 2), size / 2))
    white = np.full((size, size, 3), 255, dtype=np.uint8)
    pictures = []
    for turn, tilt in np.deg2rad(angles).tolist():
        about_vertical = rotation_from_axis_angle(torch.tensor([0.0, turn, 0.0]))
        about_horizontal = rotation_from_axis_angle(torch.tensor([tilt, 0.0, 0.0]))
        rotation = about_horizontal @ about_vertical
        turned = replace(body, centres=(body.centres - middle) @ rotation.T, axes=rotation @ body.axes)
        pictures.append(blend(white, shade_body(turned, camera, (size, size)), 1.0))
    return pictures
