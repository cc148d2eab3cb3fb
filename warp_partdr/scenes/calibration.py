"""Calibrated cameras from files, and pictures without their lenses' distortion.

A ``View`` has square pixels and no distortion; a real camera has neither. ``CalibratedCamera`` knows both: its view,
and how what its own pictures show moves into the view's. Two layouts are read, in metres, world to camera:

**Pose2Sim's Calib.toml**, a table a camera:

    [cam01]
    name = "cam01"
    size = [1088.0, 1920.0]                        # W, H
    matrix = [[1681.2, 0.0, 540.2], [0.0, 1681.7, 954.6], [0.0, 0.0, 1.0]]
    distortions = [-0.046, 0.139, -0.001, 0.0007]  # k1, k2, p1, p2, then k3, then k4, k5, k6
    rotation = [1.21, -0.86, 0.71]                 # a rotation vector [rad]
    translation = [0.21, 0.35, 5.16]
    fisheye = false

**OpenCV's FileStorage as JSON**, one camera a file, or one a key, with matrices as OpenCV writes them or as lists:
``camera_matrix``, ``distortion_coefficients``, ``image_width``, ``image_height``, and ``R`` or ``rvec``, ``T`` or
``tvec``; OpenCV's samples' other names (``cameraMatrix``, ``distCoeffs``, ``K``, ``D``) will do.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..body.labels import IGNORE
from ..body.rotations import rotation_from_axis_angle
from ..cameras import Perspective
from ..errors import InputError, shown
from ..files.json_files import read_json
from ..files.sections import read_toml
from ..inputs.keypoints import Keypoints2D
from ..inputs.part_labels import PartLabels
from .scene import View

_EXPECTED = "cameras: Pose2Sim's Calib.toml, or OpenCV's FileStorage as .json"
_CENTRE = 0.5  # of a pixel: OpenCV's first one has its centre at 0, ours at 0.5
_STEPS, _CLOSE = 200, 1e-12  # of the search for a point without distortion, and when it ends
_COEFFICIENTS = (0, 4, 5, 8)  # so many there may be
_NAMES = {
    "matrix": ("camera_matrix", "cameraMatrix", "K", "matrix"),
    "distortions": ("distortion_coefficients", "distCoeffs", "dist_coeffs", "D", "distortions"),
    "rotation": ("R", "rvec", "rotation"),
    "translation": ("T", "tvec", "translation"),
}


@dataclass(frozen=True)
class CalibratedCamera:
    """Camera of calibrated views.

    Attributes:
        name: As its file has it.
        size: (H, W) of its pictures [px].
        view: Where it stands; its camera has no distortion, and pixels as high as they are wide.
        matrix: Focal lengths and principal point, in this library's pixels, shape (3, 3).
        distortion: k1, k2, p1, p2, k3, k4, k5, k6 of Brown and Conrady's model, as OpenCV has it, shape (8,).
    """

    name: str
    size: tuple[int, int]
    view: View
    matrix: np.ndarray
    distortion: np.ndarray

    @property
    def _pinhole(self) -> tuple[np.ndarray, np.ndarray]:
        """Focal lengths and principal point [px], shape (2,) each."""
        return self.matrix[[0, 1], [0, 1]], self.matrix[:2, 2]

    def straight(self, points: np.ndarray) -> np.ndarray:
        """Places in the camera's pictures [px], shape (N, 2), as the view's camera sees them."""
        focal, centre = self._pinhole
        seen = (points.astype(np.float64) - centre) / focal
        rays = seen.copy()
        for _ in range(_STEPS):
            missed = seen - distort(rays, self.distortion)
            rays += missed
            if not np.abs(missed).max(initial=0.0) > _CLOSE:
                break
        return rays * focal[0] + centre

    def straight_keypoints(self, keypoints: Keypoints2D) -> Keypoints2D:
        """Keypoints in the camera's pictures as the view's camera sees them."""
        moved = np.where(keypoints.visible[:, None], self.straight(keypoints.points), 0.0)
        return replace(keypoints, points=moved.astype(np.float32))

    def straight_labels(self, labels: PartLabels) -> PartLabels:
        """Part labels of a picture as the view's camera sees them, each pixel from the nearest one; beyond it 255.

        Raises:
            InputError: If they are of another size.
        """
        if labels.groups.shape != self.size:
            given, expected = labels.groups.shape[::-1], self.size[::-1]
            raise InputError(f"labels: {given}; expected {expected}, as of camera {self.name}")
        rows, columns = np.indices(self.size).reshape(2, -1) + 0.5
        focal, centre = self._pinhole
        rays = (np.stack([columns, rows], axis=1) - centre) / focal[0]
        across, down = np.floor(distort(rays, self.distortion) * focal + centre).astype(np.int64).T
        inside = (across >= 0) & (across < self.size[1]) & (down >= 0) & (down < self.size[0])
        place = down.clip(0, self.size[0] - 1), across.clip(0, self.size[1] - 1)

        def moved(image: np.ndarray, fill: float) -> np.ndarray:
            return np.where(inside, image[..., *place], fill).astype(image.dtype).reshape(*image.shape[:-2], *self.size)

        maps = None if labels.maps is None else moved(labels.maps, 0.0)
        instances = None if labels.instances is None else moved(labels.instances, IGNORE)
        return replace(labels, groups=moved(labels.groups, IGNORE), maps=maps, instances=instances)


def distort(rays: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Points (x / z, y / z), shape (N, 2), where a lens shows them (Brown and Conrady's model, OpenCV's order)."""
    k1, k2, p1, p2, k3, k4, k5, k6 = coefficients
    x, y = rays.T
    square = x * x + y * y
    radial = (1 + square * (k1 + square * (k2 + square * k3))) / (1 + square * (k4 + square * (k5 + square * k6)))
    return np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x),
            y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y,
        ],
        axis=1,
    )


def read_cameras(path: str | Path) -> list[CalibratedCamera]:
    """Calibrated cameras of a file, or of a folder of OpenCV's files, one camera each, by name.

    Raises:
        InputError: If a file can't be read, has no camera, or a number is missing or can't be.
    """
    path = Path(path)
    if path.is_dir():
        files = sorted(path.glob("*.json"))
        found = [camera for file in files for camera in _read_file(file)]
    else:
        found = list(_read_file(path))
    if not found:
        raise InputError(f"{path}: no camera in it; expected {_EXPECTED}")
    names = [camera.name for camera in found]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise InputError(f"{path}: camera {twice!r} twice; expected each once")
    return found


def _read_file(path: Path) -> Iterator[CalibratedCamera]:
    if path.suffix.lower() == ".toml":
        tables: Any = read_toml(path, str(path), _EXPECTED)
    elif path.suffix.lower() == ".json":
        tables = read_json(path, _EXPECTED)
        if isinstance(tables, dict) and any(name in tables for name in _NAMES["matrix"]):
            tables = {path.stem: tables}
    else:
        raise InputError(f"{path}: neither .toml nor .json; expected {_EXPECTED}")
    if not isinstance(tables, dict):
        raise InputError(f"{path}: {shown(tables)}; expected {_EXPECTED}")
    for key, table in tables.items():
        if isinstance(table, dict) and any(name in table for name in _NAMES["matrix"]):
            yield _camera(table, f"{path}: {key}", key)


def _camera(table: Mapping[str, Any], where: str, key: str) -> CalibratedCamera:
    if table.get("fisheye"):
        raise InputError(f"{where}: fisheye; expected a lens of Brown and Conrady's model")
    matrix = _numbers(table, "matrix", where, (9,)).reshape(3, 3)
    if not (matrix[0, 0] > 0 and matrix[1, 1] > 0 and matrix[0, 1] == 0 and matrix[2].tolist() == [0, 0, 1]):
        raise InputError(f"{where}: matrix: {matrix.tolist()}; expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
    matrix[:2, 2] += _CENTRE
    given = _numbers(table, "distortions", where, _COEFFICIENTS)
    rotation = _numbers(table, "rotation", where, (3, 9))
    translation = _numbers(table, "translation", where, (3,))
    size = _size(table, where)
    if len(rotation) == 3:
        turn = rotation_from_axis_angle(torch.from_numpy(rotation))
    else:
        turn = torch.from_numpy(rotation.reshape(3, 3))
    principal = float(matrix[0, 2]), float(matrix[1, 2])
    try:
        camera = Perspective.of_picture(size, focal=float(matrix[0, 0]), principal=principal)
        view = View(camera, turn.float(), torch.from_numpy(translation).float())
    except ValueError as error:
        raise InputError(f"{where}: {error}") from None
    name = table.get("name", key)
    return CalibratedCamera(str(name), size, view, matrix, np.pad(given, (0, 8 - len(given))))


def _size(table: Mapping[str, Any], where: str) -> tuple[int, int]:
    """(H, W)."""
    given = table.get("size", [table.get("image_width"), table.get("image_height")])
    try:
        width, height = (int(side) for side in given)
    except (TypeError, ValueError, OverflowError):
        width, height = 0, 0
    if min(width, height) < 1:
        raise InputError(f"{where}: size: {shown(given)}; expected [width, height], or image_width and image_height")
    return height, width


def _numbers(table: Mapping[str, Any], what: str, where: str, counts: tuple[int, ...]) -> np.ndarray:
    """Numbers in a row, of which there are so many, in the order of a matrix' rows."""
    name = next((name for name in _NAMES[what] if name in table), None)
    if name is None:
        raise InputError(f"{where}: {what}: missing; expected one of {', '.join(_NAMES[what])}")
    value = table[name]
    if isinstance(value, Mapping):  # OpenCV's matrices
        value = value.get("data")
    try:
        numbers = np.asarray(value, dtype=np.float64).reshape(-1)
    except (TypeError, ValueError):
        numbers = np.full(1, np.nan)
    if len(numbers) not in counts or not np.isfinite(numbers).all():
        expected = " or ".join(map(str, counts))
        raise InputError(f"{where}: {name}: {shown(value)}; expected {expected} finite numbers")
    return numbers
