"""Pictures of a fit, drawn with the project's own renderer: no window, no OpenGL."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import torch

from ..body.posing import Posed
from ..body.rotations import rotation_from_axis_angle
from ..cameras import Camera, Crop, WeakPerspective, first_of
from ..inputs.keypoints import Keypoints2D
from ..models.model import Detailed, DetailedModel, detailed_mesh
from ..render.mesh import draw_mesh
from ..render.part_mesh import PartMesh, ellipbody_mesh
from .palette import PART_COLOURS

if TYPE_CHECKING:
    from PIL.Image import Image

    from ..solve.ellipsoids.result import FitResult

_SUBDIVISIONS = 3
_LIGHT = np.array([-0.35, -0.6, -0.72])  # toward the light, camera frame
_AMBIENT = 0.45
SKIN_COLOUR = np.array([196, 208, 226], dtype=np.uint8)  # apart from people's
_SAMPLES = 2  # a side, for smooth outlines
_PANEL_SIDE = 480  # [px]
_IGNORED = (150, 150, 150)


def shade_body(posed: Posed, camera: Camera, image_size: tuple[int, int]) -> np.ndarray:
    """The first body's ellipsoids, coloured by part and lit, on nothing: RGBA, shape (H, W, 4), uint8."""
    mesh = ellipbody_mesh(_SUBDIVISIONS)
    return shade_mesh(posed.vertices(_SUBDIVISIONS)[:1], mesh, camera, image_size, PART_COLOURS)


def shade_detailed(detailed: Detailed, model: DetailedModel, camera: Camera, image_size: tuple[int, int]) -> np.ndarray:
    """The first body's skin in one colour, lit, on nothing: RGBA, shape (H, W, 4), uint8."""
    colours = np.broadcast_to(SKIN_COLOUR, PART_COLOURS.shape)
    return shade_mesh(detailed.vertices[:1], detailed_mesh(model).to("cpu"), camera, image_size, colours)


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


def draw_keypoints(image: Image, keypoints: Keypoints2D) -> None:
    """Bones and dots of the confident keypoints, onto a picture."""
    from PIL import ImageDraw

    draw, radius = ImageDraw.Draw(image), max(image.size) / 250
    points, sure = keypoints.points.astype(float), keypoints.confident
    for a, b in keypoints.format.edges:
        if sure[a] and sure[b]:
            for colour, width in (("black", 3), ("white", 1)):
                draw.line([*points[a], *points[b]], fill=colour, width=width)
    for x, y in points[sure].tolist():
        draw.ellipse([x - radius, y - radius, x + radius, y + radius], fill="white", outline="black")


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


def panels(target: np.ndarray, shown: np.ndarray, colours: np.ndarray) -> Image:
    """Target, result and difference side by side, cut to where something is, in the colours (256, 3) of group ids.

    The group ids (H, W) of ``target`` are 255 where nothing is compared; ``shown`` are those of the fitted body.
    """
    from PIL import Image as PilImage
    from PIL import ImageDraw, ImageFont

    counted = target != 255
    wrong = counted & (shown != target)
    # Told apart by colour-blind people too.
    kinds = {
        "right": ((215, 215, 215), counted & (target > 0) & ~wrong),
        "missing": ((0, 90, 181), wrong & (shown == 0)),
        "too much": ((220, 50, 32), wrong & (target == 0)),
        "another part": ((255, 194, 10), wrong & (shown > 0) & (target > 0)),
        "ignored": (_IGNORED, ~counted),
    }
    difference = np.full((*target.shape, 3), 255, dtype=np.uint8)
    for colour, pixels in kinds.values():
        difference[pixels] = colour
    colours = colours.copy()
    colours[0], colours[255] = 255, _IGNORED

    size = np.array(target.shape)
    bodies = np.argwhere((counted & (target > 0)) | (shown > 0))
    low, high = (bodies.min(0), bodies.max(0) + 1) if len(bodies) else (0 * size, size)
    margin = round(0.03 * (high - low).max()) + 1
    low, high = np.maximum(low - margin, 0), np.minimum(high + margin, size)
    zoom = _PANEL_SIDE / (high - low).max()
    # Enlarged by whole numbers, so that every pixel is of one size.
    zoom = max(1, round(zoom)) if zoom > 0.7 else zoom
    height, width = (max(round(side * zoom), 1) for side in (high - low).tolist())
    resample = PilImage.Resampling.NEAREST if zoom >= 1 else PilImage.Resampling.BOX

    font, gap, bar = ImageFont.load_default(15), 12, 34
    entries = [(text, colour, round(font.getlength(text)) + 38) for text, (colour, _) in kinds.items()]
    step = max(width, (sum(entry[2] for entry in entries) - gap) // 3) + gap
    sheet = PilImage.new("RGB", (gap + 3 * step, height + 2 * bar), "white")
    draw = ImageDraw.Draw(sheet)
    named = {"target": colours[target], "result": colours[shown], "difference": difference}
    for column, (name, image) in enumerate(named.items()):
        x = gap + column * step
        draw.text((x, 9), name, fill="black", font=font)
        cut = PilImage.fromarray(image[low[0] : high[0], low[1] : high[1]])
        sheet.paste(cut.resize((width, height), resample), (x, bar))
        draw.rectangle([x - 1, bar - 1, x + width, bar + height], outline=(190, 190, 190))
    x, y = gap, bar + height + 10
    for text, colour, advance in entries:
        draw.rectangle([x, y, x + 14, y + 14], fill=colour, outline=(120, 120, 120))
        draw.text((x + 20, y - 2), text, fill="black", font=font)
        x += advance
    return sheet


def loss_chart(result: FitResult) -> Image:
    """The energy of the winner and its ancestors over all iterations, one band a stage, on a logarithmic scale."""
    from PIL import Image as PilImage
    from PIL import ImageDraw, ImageFont

    smooth = 2  # drawn so much larger, for smooth lines
    width, height = 900 * smooth, 380 * smooth
    left, right, top, bottom = 62 * smooth, width - 14 * smooth, 66 * smooth, height - 44 * smooth
    chart = PilImage.new("RGB", (width, height), "white")
    draw = ImageDraw.Draw(chart)
    font, small = ImageFont.load_default(14 * smooth), ImageFont.load_default(12 * smooth)

    values = np.concatenate([*result.history, np.zeros(0)])
    good = (values > 0) & np.isfinite(values)
    powers = np.log10(values[good]) if good.any() else np.zeros(1)
    high = powers.max() + 0.05
    low = max(powers.min() - 0.05, high - 4)  # no stage falls by more decades
    ends = np.cumsum([0, *map(len, result.history)]).tolist()

    def at(iteration: float, energy: float) -> tuple[float, float]:
        share = (np.log10(min(max(energy, 10**low), 10**high)) - low) / (high - low)
        return left + (right - left) * iteration / max(ends[-1], 1), bottom - (bottom - top) * float(share)

    for index, stage in enumerate(result.stages):
        start, end = (at(iteration, 1.0)[0] for iteration in ends[index : index + 2])
        draw.rectangle([start, top, end, bottom], fill=((246, 246, 246), (232, 237, 243))[index % 2])
        size = f"{stage.size} px" if stage.size and result.observation.labels is not None else "no labels"
        for line, text in enumerate((stage.name, size)):
            if small.getlength(text) < end - start:
                draw.text(((start + end) / 2, top - (26 - 16 * line) * smooth), text, "black", small, anchor="mm")
        draw.text((end, bottom + 6 * smooth), str(ends[index + 1]), "black", small, anchor="ma")
    for tick in (digit * 10.0**power for power in range(-6, 9) for digit in (1, 2, 5)):
        if low <= np.log10(tick) <= high:
            y = at(0, tick)[1]
            draw.line([left, y, right, y], fill=(205, 205, 205), width=1)
            draw.text((left - 6 * smooth, y), f"{tick:g}", "black", small, anchor="rm")
    for first, energies in zip(ends, result.history, strict=False):
        points = [at(first + k + 0.5, float(energy)) for k, energy in enumerate(np.nan_to_num(energies, nan=np.inf))]
        draw.line(points, fill=(20, 70, 140), width=2 * smooth, joint="curve")
    draw.rectangle([left, top, right, bottom], outline=(120, 120, 120), width=smooth)
    draw.text((left, 6 * smooth), "energy of the winner", "black", font)
    draw.text(((left + right) / 2, height - 8 * smooth), "iteration", "black", font, anchor="ms")
    return chart.resize((width // smooth, height // smooth), PilImage.Resampling.LANCZOS)
