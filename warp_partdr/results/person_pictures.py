"""Pictures of one person for pages: the part of the photo that shows the person, and the body from the side."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
import torch

from ..cameras import Crop, WeakPerspective
from .overlays import GRAY, gray_picture, surface_over
from .shading import BodySurface

_MARGIN = 0.08  # margin around what is shown, as a share of it
_BEYOND = 0.75  # farthest that a body is shown beyond the person's box, as a share of the box
_QUALITY = 80  # of JPEG files
# Rotation that brings the camera's z axis to x: the camera is then at the left of the picture, and y stays vertical.
_FROM_THE_SIDE = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0))


def person_window(box: Sequence[float] | np.ndarray, points: np.ndarray, side: int) -> Crop:
    """Window of a picture that holds a person's box and, unless it is far off, the body.

    Args:
        box: Left, top, right and bottom of the person [px].
        points: Points of the body in the picture [px], shape (N, 2).
        side: Longer side of the window's own picture [px].
    """
    left, top, right, bottom = np.asarray(box, dtype=np.float64).tolist()
    beyond = _BEYOND * max(right - left, bottom - top, 1.0)
    inside = np.clip(points, (left - beyond, top - beyond), (right + beyond, bottom + beyond))
    return _window_of(np.minimum(inside.min(0), (left, top)), np.maximum(inside.max(0), (right, bottom)), side)


def _window_of(low: np.ndarray, high: np.ndarray, side: int) -> Crop:
    """Window around a rectangle, with a margin; its edges are whole pixels."""
    margin = _MARGIN * max(*(high - low), 1.0) + 1
    low, high = np.floor(low - margin), np.ceil(high + margin)
    zoom = side / float((high - low).max())
    width, height = np.maximum(np.ceil((high - low) * zoom), 1).astype(int).tolist()
    return Crop(float(low[0]), float(low[1]), zoom, (height, width))


def cut_window(photo: np.ndarray, crop: Crop) -> np.ndarray:
    """Cut a window of a photo, shape (H, W, 3), uint8; it is gray beyond the border of the photo."""
    from PIL import Image

    left, top = int(crop.left), int(crop.top)
    height, width = round(crop.size[0] / crop.zoom), round(crop.size[1] / crop.zoom)
    window = Image.new("RGB", (width, height), GRAY)
    rows = slice(max(top, 0), max(top + height, 0))
    columns = slice(max(left, 0), max(left + width, 0))
    part = photo[rows, columns]
    if part.size:
        window.paste(Image.fromarray(part), (columns.start - left, rows.start - top))
    return np.asarray(window.resize((crop.size[1], crop.size[0]), Image.Resampling.LANCZOS))


def draw_side_view(surface: BodySurface, side: int) -> np.ndarray:
    """Draw a body as somebody at the right of the photo sees it, on gray, shape (H, W, 3), uint8.

    The camera of the photo is at the left, and what is vertical in the photo stays vertical.

    Args:
        surface: BodySurface of the body in the frame of the camera.
        side: Longer side of the picture [px].
    """
    turned = surface.moved(np.array(_FROM_THE_SIDE), -surface.vertices.mean(0, dtype=np.float64))
    points = 1000 * turned.vertices[:, :2].astype(np.float64)  # one millimetre is a pixel of the full picture
    crop = _window_of(points.min(0), points.max(0), side)
    camera = WeakPerspective(torch.full((1,), 1000.0), torch.zeros(1, 2)).in_crop(crop)
    return surface_over(gray_picture(crop.size), turned, camera)


def jpeg_file(picture: np.ndarray) -> bytes:
    """Bytes of a JPEG file of a picture, shape (H, W, 3), uint8."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, "JPEG", quality=_QUALITY)
    return buffer.getvalue()
