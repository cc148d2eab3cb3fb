"""Bodies and keypoints over pictures, or over gray if there is no picture."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import torch

from ..body.posing import Posed
from ..cameras import Camera, first_of, zoomed
from ..inputs.keypoints import Keypoints2D
from ..models.model import DetailedModel, detailed_mesh
from ..models.registration import Registered
from ..render.mesh import draw_mesh
from ..solve.ellipsoids.result import FitResult
from .shading import SKIN_COLOUR, BodySurface, blend, shade_body

if TYPE_CHECKING:
    from PIL.Image import Image

GRAY = (235, 235, 235)
CLOTHES_COLOUR = np.array([240, 150, 30], dtype=np.uint8)  # of the outline of clothes
OVERLAY_SIDE = 2048  # [px]; overlays of larger photos are scaled down: no screen shows more, and shading takes memory
_ELLIPSOIDS, _SKIN = 0.85, 0.97  # opacities


def body_over(picture: np.ndarray, posed: Posed, camera: Camera, opacity: float = _ELLIPSOIDS) -> np.ndarray:
    """Draw the first body's ellipsoids over a picture, shape (H, W, 3), uint8."""
    return blend(picture, shade_body(posed, camera, (picture.shape[0], picture.shape[1])), opacity)


def skin_over(
    picture: np.ndarray,
    vertices: torch.Tensor,
    model: DetailedModel,
    camera: Camera,
    colour: np.ndarray = SKIN_COLOUR,
    pale: np.ndarray | None = None,
    *,
    bare: bool = False,
) -> np.ndarray:
    """Draw the first detailed body over a picture, shape (H, W, 3), uint8.

    Args:
        picture: Picture, RGB, shape (H, W, 3), uint8.
        vertices: Vertices of the model's bodies in the camera frame [m], shape (B, V, 3).
        model: Model of the bodies.
        camera: Camera of the picture.
        colour: RGB of the skin, shape (3,), uint8.
        pale: Flags of the part labels that are drawn pale because they are guessed (``guessed_parts``), shape (21,).
        bare: True draws the skin alone. By default the body wears a plain T-shirt and shorts.
    """
    return surface_over(picture, BodySurface.of_body(vertices, model, pale=pale, bare=bare), camera, colour)


def surface_over(
    picture: np.ndarray, surface: BodySurface, camera: Camera, colour: np.ndarray = SKIN_COLOUR
) -> np.ndarray:
    """Draw the surface of a detailed body over a picture, like ``skin_over``, shape (H, W, 3), uint8."""
    return shaded_over(picture, surface.draw(camera, (picture.shape[0], picture.shape[1]), colour))


def shaded_over(picture: np.ndarray, shaded: np.ndarray) -> np.ndarray:
    """Lay a detailed body that ``BodySurface.draw`` has drawn over a picture, shape (H, W, 3), uint8."""
    return blend(picture, shaded, _SKIN)


def gray_picture(size: tuple[int, int]) -> np.ndarray:
    """Make a gray picture of (H, W) pixels, shape (H, W, 3), uint8."""
    return np.full((*size, 3), GRAY, dtype=np.uint8)


def overlay_size(size: tuple[int, int], side: int | None = None) -> tuple[float, tuple[int, int]]:
    """Zoom and size (H, W) of overlays and scores of a picture: at most ``side`` px a side, or ``OVERLAY_SIDE``."""
    zoom = min(1.0, (side or OVERLAY_SIDE) / max(size))
    return zoom, (max(round(size[0] * zoom), 1), max(round(size[1] * zoom), 1))


def at_overlay_size(photo: np.ndarray, size: tuple[int, int] | None = None) -> np.ndarray:
    """Scale a photo down to its overlay's size. If it was scaled before, ``size`` is its size (H, W) before that."""
    from PIL import Image

    _, (height, width) = overlay_size(size or (photo.shape[0], photo.shape[1]))
    if photo.shape[:2] == (height, width):
        return photo
    return np.asarray(Image.fromarray(photo).resize((width, height), Image.Resampling.LANCZOS))


def draw_overlay(result: FitResult, size: tuple[int, int], photo: np.ndarray | None = None) -> Image:
    """Draw the body and the keypoints over the photo, or over gray; at most ``OVERLAY_SIDE`` pixels a side."""
    from PIL import Image

    zoom, drawn_size = overlay_size(size)
    below = gray_picture(drawn_size) if photo is None else at_overlay_size(photo, size)
    overlay = Image.fromarray(body_over(below, result.posed, zoomed(result.camera, zoom, drawn_size)))
    keypoints = result.evidence.keypoints
    draw_keypoints(overlay, replace(keypoints, points=keypoints.points * zoom))
    return overlay


def draw_detailed(
    registered: Registered,
    camera: Camera,
    size: tuple[int, int],
    photo: np.ndarray | None = None,
    pale: np.ndarray | None = None,
    *,
    clothes: torch.Tensor | None = None,
    bare: bool = False,
    shaded: np.ndarray | None = None,
) -> Image:
    """Draw the detailed body over the photo, or over gray; at most ``OVERLAY_SIDE`` pixels a side.

    Args:
        registered: Detailed body, the first of its batch.
        camera: Camera of the picture.
        size: Size (H, W) of the picture [px].
        photo: Photo, RGB, shape (H, W, 3), uint8; None: gray.
        pale: Flags of the part labels that are drawn pale because they are guessed (``guessed_parts``), shape (21,).
        clothes: Thicknesses of clothes on the parts ``CLOTHED`` [m], whose outline is drawn, shape (1, 8); None: none.
        bare: True draws the skin alone. By default the body wears a plain T-shirt and shorts.
        shaded: Body as ``shade_for_overlay`` has drawn it with these arguments; None: it is drawn.
    """
    from PIL import Image

    zoom, drawn_size = overlay_size(size)
    below = gray_picture(drawn_size) if photo is None else at_overlay_size(photo, size)
    if shaded is None:
        surface = BodySurface.of_body(registered.detailed.vertices, registered.model, pale=pale, bare=bare)
        shaded = shade_for_overlay(surface, camera, size)
    drawn = shaded_over(below, shaded)
    if clothes is not None:
        drawn = clothes_over(drawn, registered, clothes, zoomed(camera, zoom, drawn_size))
    return Image.fromarray(drawn)


def shade_for_overlay(surface: BodySurface, camera: Camera, size: tuple[int, int]) -> np.ndarray:
    """Draw a body for the overlay of a picture of (H, W) pixels, on a transparent ground: RGBA, uint8."""
    zoom, drawn_size = overlay_size(size)
    return surface.draw(zoomed(camera, zoom, drawn_size), drawn_size)


def clothes_over(picture: np.ndarray, registered: Registered, clothes: torch.Tensor, camera: Camera) -> np.ndarray:
    """Draw the outline of the first body's clothes over a picture as a thin line, shape (H, W, 3), uint8.

    Args:
        picture: Picture, RGB, shape (H, W, 3), uint8.
        registered: Bodies in the camera frame.
        clothes: Thicknesses of clothes on the parts ``CLOTHED`` [m], shape (1, 8).
        camera: Camera of the picture.
    """
    vertices, size = registered.clothed(clothes).vertices[:1].detach(), (picture.shape[0], picture.shape[1])
    labels = draw_mesh(vertices, detailed_mesh(registered.model), first_of(camera).to(vertices.device), size).labels
    covered = (labels[:, None] > 0).float()
    share = torch.nn.functional.avg_pool2d(covered, 3, stride=1, padding=1, count_include_pad=False)[0, 0]
    line = (4 * share * (1 - share))[..., None].cpu().numpy()  # 1 where half of the surroundings are covered
    outlined: np.ndarray = (picture * (1 - line) + CLOTHES_COLOUR * line + 0.5).astype(np.uint8)
    return outlined


def draw_keypoints(image: Image, keypoints: Keypoints2D) -> None:
    """Draw bones and dots of the confident keypoints onto a picture."""
    from PIL import ImageDraw

    draw, radius = ImageDraw.Draw(image), max(image.size) / 250
    points, confident = keypoints.points.astype(float), keypoints.confident
    for a, b in keypoints.format.edges:
        if confident[a] and confident[b]:
            for colour, width in (("black", 3), ("white", 1)):
                draw.line([*points[a], *points[b]], fill=colour, width=width)
    for x, y in points[confident].tolist():
        draw.ellipse([x - radius, y - radius, x + radius, y + radius], fill="white", outline="black")
