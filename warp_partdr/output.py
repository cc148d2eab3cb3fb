"""The files that ``partdr fit`` leaves: written to a temporary folder first, then moved into place as one."""

from __future__ import annotations

import json
import platform
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from . import __version__, metrics
from .body.labels import BACKGROUND, IGNORE, LabelSet, label_set, regroup
from .body.template import JOINT_NAMES
from .body_file import BodyFile
from .export import ellipbody_scene
from .fitting import FitResult
from .keypoints import Keypoints2D, person_height
from .palette import group_colours
from .part_files import PartLabels
from .person import select_person
from .pictures import blend, draw_keypoints, loss_chart, panels, shade_body

_LSP6 = "lsp6"


@contextmanager
def replacing(folder: Path) -> Iterator[Path]:
    """A temporary folder beside ``folder``, whose files take their places in it when all are written.

    Files of other names in ``folder`` stay. On an error nothing there changes.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}-") as scratch:
        temporary = Path(scratch)
        yield temporary
        folder.mkdir(exist_ok=True)
        for path in temporary.iterdir():
            shutil.move(path, folder / path.name)


def save_fit(
    result: FitResult,
    folder: str | Path,
    *,
    keypoints: Keypoints2D,
    parts: PartLabels | None = None,
    photo: np.ndarray | None = None,
    others: tuple[Keypoints2D, ...] = (),
) -> dict[str, Any]:
    """Write body.npz, body.json, ellipbody.glb, overlay.png, parts.png, loss.png and report.json.

    Args:
        result: Of ``fit_body``.
        folder: Made if it is not there.
        keypoints: The fitted person's.
        parts: The picture's labels, if there were any.
        photo: The picture, shape (H, W, 3), uint8, if there was one.
        others: Other people's keypoints, as given to the fit.

    Returns:
        The report.
    """
    from PIL import Image

    size = image_size(keypoints, parts, photo)
    target = None if parts is None else select_person(parts.groups, keypoints, others)
    labels = result.draw(size).labels[0].cpu().numpy()
    report = make_report(result, keypoints, labels, target, None if parts is None else parts.label_set)
    canvas = np.full((*size, 3), 235, dtype=np.uint8) if photo is None else photo
    overlay = Image.fromarray(blend(canvas, shade_body(result.posed, result.camera, size), 0.72))
    draw_keypoints(overlay, keypoints)
    with replacing(Path(folder)) as temporary:
        body_file(result, size).save(temporary / "body.npz")
        _write_json(temporary / "body.json", describe_body(result))
        ellipbody_scene(result.posed).export(temporary / "ellipbody.glb")
        overlay.save(temporary / "overlay.png")
        if parts is not None and target is not None:
            shown = parts.label_set.part_groups[labels]
            panels(target, shown, group_colours(parts.label_set.part_groups)).save(temporary / "parts.png")
        loss_chart(result, temporary / "loss.png")
        _write_json(temporary / "report.json", report)
    return report


def image_size(keypoints: Keypoints2D, parts: PartLabels | None, photo: np.ndarray | None) -> tuple[int, int]:
    """(H, W) of the picture; without photo and labels, what holds all keypoints."""
    for image in (photo, None if parts is None else parts.groups):
        if image is not None:
            return int(image.shape[0]), int(image.shape[1])
    width, height = np.ceil(keypoints.points[keypoints.visible].max(0) * 1.1 + 1).astype(int)
    return int(max(height, 1)), int(max(width, 1))


def body_file(result: FitResult, size: tuple[int, int]) -> BodyFile:
    """The fitted body as ``body.npz`` holds it."""
    from .body.rotations import rotation_from_axis_angle

    parameters, camera = result.parameters.detach(), result.camera
    numbers = {
        "global_orient": parameters.global_orient()[0],
        "translation": parameters.lengths.new_zeros(3),
        "rotations": rotation_from_axis_angle(parameters.free_rotations())[0],
        "lengths": parameters.lengths[0],
        "thicknesses": parameters.thicknesses[0],
        "camera_scale": camera.scale[0],
        "camera_translation": camera.translation[0],
    }
    return BodyFile(**{name: value.cpu().numpy() for name, value in numbers.items()}, image_size=np.array(size))


def describe_body(result: FitResult) -> dict[str, Any]:
    """Measurements in cm and joint positions, for people and programs that don't read npz."""
    measured = body_file(result, (1, 1)).body("cpu").measure()
    joints = result.posed.joints[0].detach().cpu().numpy()
    pixels = result.camera.project(result.posed.joints)[0, :, :2].detach().cpu().numpy()
    return {
        "measurements_cm": {name: round(100 * value, 2) for name, value in measured.items()},
        "joints": {
            "frame": "camera: x right, y down, z away from the viewer; metres from the pelvis",
            "names": list(JOINT_NAMES),
            "points_m": joints.round(4).tolist(),
            "pixels": pixels.round(2).tolist(),
        },
        "camera": {
            "model": "weak perspective: u = scale X + translation[0], v = scale Y + translation[1]",
            "scale_px_per_m": round(float(result.camera.scale[0]), 4),
            "translation_px": result.camera.translation[0].cpu().numpy().round(3).tolist(),
        },
    }


def make_report(
    result: FitResult, keypoints: Keypoints2D, labels: np.ndarray, target: np.ndarray | None, source: LabelSet | None
) -> dict[str, Any]:
    """Losses, accuracy and times of a fit."""
    sure = keypoints.confident
    names = [name for name, there in zip(keypoints.format.landmarks, sure, strict=True) if there]
    posed, camera = result.posed, result.camera
    from .energy import LandmarkGather

    seen = camera.project(LandmarkGather(names, camera.scale.device)(posed))[0, :, :2].detach().cpu().numpy()
    distance = float(np.linalg.norm(seen - keypoints.points[sure], axis=1).mean())
    height = person_height(keypoints)
    report: dict[str, Any] = {
        "energy": {name: round(value, 4) for name, value in result.energy.items()},
        "energy_total": round(sum(result.energy.values()), 4),
        "energy_of_other_finalists": [round(value, 4) for value in result.alternatives],
        "hypotheses": result.hypotheses,
        "keypoints": {
            "confident": int(sure.sum()),
            "mean_distance_px": round(distance, 3),
            "mean_distance_share_of_person_height": round(distance / height, 5) if height else None,
        },
        "seconds": {name: round(value, 3) for name, value in result.stage_seconds.items()},
        "seconds_total": round(sum(result.stage_seconds.values()), 3),
        "versions": _versions(),
    }
    if target is not None and source is not None:
        report["parts"] = {"label_set": source.name, **_scores(source.part_groups[labels], target, source.group_names)}
        try:
            table, lsp6 = regroup(source, label_set(_LSP6)), label_set(_LSP6)
        except ValueError:
            pass  # the set is not finer than LSP's six parts
        else:
            report["parts_lsp6"] = _scores(table[source.part_groups[labels]], table[target], lsp6.group_names)
    return report


def _scores(shown: np.ndarray, target: np.ndarray, names: tuple[str, ...]) -> dict[str, Any]:
    counts = metrics.confusion(shown, target, len(names) + 1)
    each = metrics.f1_scores(counts)
    return {
        "foreground_f1": round(metrics.part_f1(metrics.foreground_counts(counts)), 4),
        "part_f1": round(metrics.part_f1(counts), 4),
        "part_accuracy": round(metrics.accuracy(counts), 4),
        "f1": {
            name: None if np.isnan(score) else round(float(score), 4)
            for name, score in zip(("background", *names), each, strict=True)
        },
        "pixels": {
            "person": int(((target != BACKGROUND) & (target != IGNORE)).sum()),
            "ignored": int((target == IGNORE).sum()),
        },
    }


def _versions() -> dict[str, str]:
    import torch
    import warp as wp

    return {
        "warp-partdr": __version__,
        "warp": wp.config.version,
        "torch": torch.__version__,
        "python": platform.python_version(),
        "machine": platform.machine(),
    }


def _write_json(path: Path, data: dict[str, Any]) -> None:
    path.write_text(json.dumps(data, indent=1) + "\n")
