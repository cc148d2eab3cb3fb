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
    from pathlib import Path

    from PIL.Image import Image

    from .fitting import FitResult

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
    difference[counted & (target > 0) & ~wrong] = (205, 205, 205)
    difference[wrong & (shown == 0)] = _MISSING
    difference[wrong & (target == 0)] = _EXTRA
    difference[wrong & (shown > 0) & (target > 0)] = _CONFUSED
    difference[~counted] = (120, 120, 120)

    rows, columns = np.nonzero((counted & (target > 0)) | (shown > 0))
    if rows.size:
        margin = 12
        box = (columns.min() - margin, rows.min() - margin, columns.max() + margin + 1, rows.max() + margin + 1)
    else:
        box = (0, 0, target.shape[1], target.shape[0])
    box = (max(box[0], 0), max(box[1], 0), min(box[2], target.shape[1]), min(box[3], target.shape[0]))
    width, height = int(box[2] - box[0]), int(box[3] - box[1])
    zoom = max(1, round(480 / max(width, height)))
    width, height, bar = width * zoom, height * zoom, 34
    names = ("target", "result", "difference")
    sheet = PilImage.new("RGB", (3 * max(width, 180) + 40, height + 2 * bar), "white")
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(15)
    left = 10
    for name, image in zip(names, (colours[target], colours[shown], difference), strict=True):
        picture = PilImage.fromarray(image).crop(tuple(map(int, box))).resize((width, height), PilImage.Resampling.NEAREST)
        sheet.paste(picture, (left, bar))
        draw.text((left, 8), name, fill="black", font=font)
        left += max(width, 180) + 10
    left = 10
    for text, colour in (
        ("missing", _MISSING),
        ("too much", _EXTRA),
        ("another part", _CONFUSED),
        ("ignored", (120, 120, 120)),
    ):
        draw.rectangle([left, bar + height + 10, left + 14, bar + height + 24], fill=colour)
        draw.text((left + 20, bar + height + 8), text, fill="black", font=font)
        left += 40 + 8 * len(text)
    return sheet


# of the difference picture; told apart by colour-blind people too
_MISSING = (0, 90, 181)
_EXTRA = (220, 50, 32)
_CONFUSED = (255, 194, 10)


def loss_chart(result: FitResult, path: Path) -> None:
    """The energy of the winner and its ancestors over all iterations, one panel a stage, as PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 3.2), layout="constrained")
    FigureCanvasAgg(figure)
    stages = result.options.stages
    axes = figure.subplots(1, len(stages), squeeze=False, width_ratios=[stage.iterations for stage in stages])[0]
    first = 0
    for axis, stage, energies in zip(axes, stages, result.history, strict=True):
        axis.plot(np.arange(first, first + len(energies)), energies, color="black", linewidth=1.2)
        axis.set_title(f"{stage.name}\n{stage.size or 'no'} px", fontsize=9)
        axis.set_ylim(bottom=0)
        axis.grid(alpha=0.3)
        axis.tick_params(labelsize=8)
        first += stage.iterations
    axes[0].set_ylabel("energy of the winner")
    figure.supxlabel("iteration", fontsize=10)
    figure.savefig(path, dpi=110)
