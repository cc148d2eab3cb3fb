"""Pictures of a fit, drawn with the project's own renderer: no window, no OpenGL."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch

from ..body.posing import Posed
from ..body.rotations import rotation_from_axis_angle
from ..body.skeletons import Skeleton
from ..cameras import WeakPerspective
from ..clothing.mesh import detailed_mesh
from ..clothing.model import Detailed, DetailedModel
from ..inputs.keypoints import Keypoints2D
from ..render.mesh import draw_mesh
from ..render.part_mesh import PartMesh, ellipbody_mesh
from .palette import PART_COLOURS

if TYPE_CHECKING:
    from PIL.Image import Image

    from ..fit.result import FitResult

_SUBDIVISIONS = 3
_LIGHT = np.array([-0.35, -0.6, -0.72])  # toward the light, camera frame
_AMBIENT = 0.45
_SKIN = np.array([196, 208, 226], dtype=np.uint8)  # apart from people's
_SAMPLES = 2  # a side, for smooth outlines
_PANEL_SIDE = 480  # [px]
# Of the difference picture; told apart by colour-blind people too
_RIGHT = (215, 215, 215)
_MISSING = (0, 90, 181)
_EXTRA = (220, 50, 32)
_CONFUSED = (255, 194, 10)
_IGNORED = (150, 150, 150)


def shade_body(posed: Posed, camera: WeakPerspective, image_size: tuple[int, int]) -> np.ndarray:
    """The first body's ellipsoids, coloured by part and lit, on nothing: RGBA, shape (H, W, 4), uint8."""
    mesh = ellipbody_mesh(_SUBDIVISIONS)
    return _shade(posed.vertices(_SUBDIVISIONS)[:1], mesh, camera, image_size, PART_COLOURS)


def shade_detailed(
    detailed: Detailed, model: DetailedModel, camera: WeakPerspective, image_size: tuple[int, int]
) -> np.ndarray:
    """The first body's skin in one colour, lit, on nothing: RGBA, shape (H, W, 4), uint8."""
    colours = np.broadcast_to(_SKIN, PART_COLOURS.shape)
    return _shade(detailed.vertices[:1], detailed_mesh(model).to("cpu"), camera, image_size, colours)


def _shade(
    vertices: torch.Tensor, mesh: PartMesh, camera: WeakPerspective, image_size: tuple[int, int], colours: np.ndarray
) -> np.ndarray:
    """A mesh with vertices (1, V, 3) in the camera frame [m], in the colours of its labels: RGBA, (H, W, 4), uint8."""
    height, width = image_size
    points = vertices.detach().cpu()
    scale, translation = (tensor[:1].detach().cpu() * _SAMPLES for tensor in (camera.scale, camera.translation))
    fine = WeakPerspective(scale, translation)
    image = draw_mesh(points, mesh, fine, (height * _SAMPLES, width * _SAMPLES))
    corners = points[0].numpy()[mesh.faces.numpy()]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12
    light = _LIGHT / np.linalg.norm(_LIGHT)
    brightness = _AMBIENT + (1 - _AMBIENT) * np.clip(normals @ light, 0, 1)
    index, labels = image.face_index[0].numpy(), image.labels[0].numpy()
    rgba = np.zeros((*labels.shape, 4), dtype=np.float32)
    rgba[..., :3] = colours[labels] * brightness[index][..., None]
    rgba[..., 3] = 255.0 * (labels > 0)
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


def turntable_views(posed: Posed, angles: tuple[tuple[float, float], ...], size: int = 320) -> list[np.ndarray]:
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


def panels(target: np.ndarray, shown: np.ndarray, colours: np.ndarray) -> Image:
    """Target, result and difference side by side, cut to where something is.

    Args:
        target: Group ids, 255 = ignore, shape (H, W).
        shown: Group ids of the fitted body, the same shape.
        colours: RGB of each group id, shape (256, 3).
    """
    from PIL import Image as PilImage
    from PIL import ImageDraw, ImageFont

    counted = target != 255
    wrong = counted & (shown != target)
    difference = np.full((*target.shape, 3), 255, dtype=np.uint8)
    for colour, pixels in (
        (_RIGHT, counted & (target > 0) & ~wrong),
        (_MISSING, wrong & (shown == 0)),
        (_EXTRA, wrong & (target == 0)),
        (_CONFUSED, wrong & (shown > 0) & (target > 0)),
        (_IGNORED, ~counted),
    ):
        difference[pixels] = colour
    colours = colours.copy()
    colours[0], colours[255] = 255, _IGNORED

    rows, columns = np.nonzero((counted & (target > 0)) | (shown > 0))
    top, bottom = (int(rows.min()), int(rows.max()) + 1) if rows.size else (0, target.shape[0])
    left, right = (int(columns.min()), int(columns.max()) + 1) if rows.size else (0, target.shape[1])
    margin = round(0.03 * max(bottom - top, right - left)) + 1
    box = (
        max(left - margin, 0),
        max(top - margin, 0),
        min(right + margin, target.shape[1]),
        min(bottom + margin, target.shape[0]),
    )
    zoom = _PANEL_SIDE / max(box[2] - box[0], box[3] - box[1])
    # Enlarged by whole numbers, so that every pixel is of one size.
    zoom = max(1, round(zoom)) if zoom > 0.7 else zoom
    width, height = max(round((box[2] - box[0]) * zoom), 1), max(round((box[3] - box[1]) * zoom), 1)
    resample = PilImage.Resampling.NEAREST if zoom >= 1 else PilImage.Resampling.BOX

    font, gap, bar = ImageFont.load_default(15), 12, 34
    legend = {"right": _RIGHT, "missing": _MISSING, "too much": _EXTRA, "another part": _CONFUSED, "ignored": _IGNORED}
    entries = [(text, colour, round(font.getlength(text)) + 38) for text, colour in legend.items()]
    step = max(width, (sum(entry[2] for entry in entries) - gap) // 3) + gap
    sheet = PilImage.new("RGB", (gap + 3 * step, height + 2 * bar), "white")
    draw = ImageDraw.Draw(sheet)
    named = {"target": colours[target], "result": colours[shown], "difference": difference}
    for column, (name, image) in enumerate(named.items()):
        x = gap + column * step
        draw.text((x, 9), name, fill="black", font=font)
        sheet.paste(PilImage.fromarray(image).crop(box).resize((width, height), resample), (x, bar))
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
    powers = np.log10(values[values > 0]) if (values > 0).any() else np.zeros(1)
    high = powers.max() + 0.05
    low = max(powers.min() - 0.05, high - 4)  # no stage falls by more decades
    total = max(sum(map(len, result.history)), 1)

    def at(iteration: float, energy: float) -> tuple[float, float]:
        share = (np.log10(max(energy, 10**low)) - low) / (high - low)
        return left + (right - left) * iteration / total, bottom - (bottom - top) * float(share)

    first = 0
    for index, (stage, energies) in enumerate(zip(result.stages, result.history, strict=True)):
        (start, _), (end, _) = at(first, 1.0), at(first + len(energies), 1.0)
        draw.rectangle([start, top, end, bottom], fill=((246, 246, 246), (232, 237, 243))[index % 2])
        size = f"{stage.size} px" if stage.size and result.observation.labels is not None else "no labels"
        for line, text in enumerate((stage.name, size)):
            if small.getlength(text) < end - start:
                draw.text(((start + end) / 2, top - (26 - 16 * line) * smooth), text, "black", small, anchor="mm")
        first += len(energies)
        draw.text((end, bottom + 6 * smooth), str(first), "black", small, anchor="ma")
    ticks = [digit * 10.0**power for power in range(-6, 9) for digit in (1, 2, 5)]
    for tick in ticks:
        if low <= np.log10(tick) <= high:
            y = at(0, tick)[1]
            draw.line([left, y, right, y], fill=(205, 205, 205), width=1)
            draw.text((left - 6 * smooth, y), f"{tick:g}", "black", small, anchor="rm")
    first = 0
    for energies in result.history:
        points = [at(first + k + 0.5, float(energy)) for k, energy in enumerate(energies)]
        draw.line(points, fill=(20, 70, 140), width=2 * smooth, joint="curve")
        first += len(energies)
    draw.rectangle([left, top, right, bottom], outline=(120, 120, 120), width=smooth)
    draw.text((left, 6 * smooth), "energy of the winner", "black", font)
    draw.text(((left + right) / 2, height - 8 * smooth), "iteration", "black", font, anchor="ms")
    return chart.resize((width // smooth, height // smooth), PilImage.Resampling.LANCZOS)
