"""Joints over time in a world that calibrated cameras see: ``.trc`` files of Pose2Sim, OpenCap and OpenSim, and arrays.

Every camera's view of every moment is a row of ``Views``, whose keypoints are the joints as a pinhole shows them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ....body.keypoint_names import skeleton_of_names
from ....errors import InputError, cause, shown, told_of
from ....files.array_files import read_npz
from ....inputs.calibrated_camera import CalibratedCamera
from ....inputs.camera_files import read_cameras
from ....inputs.camera_names import assign_cameras
from ....inputs.films import FILM_SUFFIXES
from ....inputs.keypoints import LARGEST_COORDINATE
from .views import Views

_METRES = {"m": 1.0, "mm": 1e-3, "cm": 1e-2}
_HEADER_LINES = 5  # of a .trc file: kind, names of facts, facts, names of markers, their axes
_EXPECTED_TRC = "a .trc file of joints, as Pose2Sim, OpenCap and OpenSim write it"
_EXPECTED_NPZ = "joints over time: joint_names (J,), joints_world (T, J, 3) [m] and perhaps frames (T,)"
AXES = ("x y z", "z x y")  # as cameras have them; and as Pose2Sim turns them, so that y is up


@dataclass(frozen=True)
class Trajectories:
    """Joints of one person over time.

    Attributes:
        names: Names of the J joints or markers.
        points: Points in the world [m], shape (T, J, 3). They are NaN where unknown.
        frames: Number of each moment, rising, shape (T,), whole numbers.

    Raises:
        InputError: If a name repeats, a point is infinite, or frames do not rise.
    """

    names: tuple[str, ...]
    points: np.ndarray
    frames: np.ndarray

    def __post_init__(self) -> None:
        if twice := [name for name in self.names if self.names.count(name) > 1]:
            raise InputError(f"names: {shown(twice[0])} {len(twice)} times; expected joints of one person, each once")
        if np.isinf(self.points).any():
            raise InputError("points: infinite; expected numbers, or NaN where unknown")
        if (np.diff(self.frames) <= 0).any():
            row = int((np.diff(self.frames) <= 0).argmax())
            fault = f"{self.frames[row + 1]} after {self.frames[row]}"
            raise InputError(f"frames: {fault}; expected rising numbers")


def read_trc(path: str | Path) -> Trajectories:
    """Read a ``.trc`` file: joints or markers over time.

    Raises:
        InputError: If it can't be read, or is no such file.
    """
    try:
        lines = Path(path).read_text(encoding="utf-8-sig", errors="replace").splitlines()
    except OSError as error:
        raise InputError(f"{path}: {cause(error)}; expected {_EXPECTED_TRC}") from error
    if len(lines) <= _HEADER_LINES or not lines[0].startswith("PathFileType"):
        raise InputError(f"{path}: {shown(lines[0] if lines else '')} in its first line; expected {_EXPECTED_TRC}")
    facts = dict(zip(lines[1].split("\t"), lines[2].split("\t"), strict=False))
    unit = facts.get("Units", "").strip().lower()
    if unit not in _METRES:
        raise InputError(f"{path}: Units: {shown(unit)}; expected {', '.join(_METRES)}")
    names = tuple(name.strip() for name in lines[3].split("\t")[2:] if name.strip())
    rows = [line.split("\t") for line in lines[_HEADER_LINES:] if line.strip()]
    if not names or not rows:
        raise InputError(f"{path}: {len(names)} markers, {len(rows)} frames; expected {_EXPECTED_TRC}")
    width = 3 * len(names)
    numbers = np.full((len(rows), width), np.nan)
    frames = np.zeros(len(rows), dtype=np.int64)
    for row, cells in enumerate(rows):
        try:
            frames[row] = int(cells[0])
            values = [float(cell) if cell.strip() else np.nan for cell in cells[2 : 2 + width]]
        except ValueError as error:
            raise InputError(f"{path}: frame {row}: {cause(error)}; expected numbers between tabs") from error
        if len(values) % 3:  # cells at a row's end may be missing, those of whole joints
            raise InputError(f"{path}: frame {frames[row]}: {len(values)} numbers; expected {width}")
        numbers[row, : len(values)] = values
    with told_of(path):
        return Trajectories(names, _METRES[unit] * numbers.reshape(len(rows), len(names), 3), frames)


def read_joint_arrays(path: str | Path) -> Trajectories:
    """Read joints over time from an ``.npz`` file: ``joint_names``, ``joints_world`` [m] and perhaps ``frames``.

    Raises:
        InputError: If it can't be read, or an array is missing or wrong.
    """
    arrays = read_npz(path, ("joint_names", "joints_world"), ("frames",), expected=_EXPECTED_NPZ)
    names, points = arrays["joint_names"], arrays["joints_world"]
    if names.dtype.kind != "U" or names.ndim != 1 or points.dtype.kind not in "fiu":
        raise InputError(f"{path}: joint_names, joints_world: {names.dtype}, {points.dtype}; expected {_EXPECTED_NPZ}")
    if points.ndim != 3 or points.shape[1:] != (len(names), 3):
        fault = f"joint_names, joints_world: {names.shape}, {points.shape}"
        raise InputError(f"{path}: {fault}; expected {_EXPECTED_NPZ}")
    frames = arrays.get("frames", np.arange(len(points)))
    if frames.shape != points.shape[:1] or frames.dtype.kind not in "iu":
        raise InputError(f"{path}: frames: {frames.dtype} {frames.shape}; expected {len(points)} whole numbers")
    with told_of(path):
        return Trajectories(tuple(map(str, names)), points.astype(np.float64), frames)


def read_trajectories(
    path: str | Path, cameras: str | Path, *, films: str | Path | None = None, axes: str | None = None
) -> Views:
    """Read joints over time, as calibrated cameras see them.

    Args:
        path: A ``.trc`` file, or an ``.npz`` of ``read_joint_arrays``.
        cameras: File of calibrated cameras (``read_cameras``), in the world of the joints.
        films: Folder of the cameras' films, whose names tell the cameras. Their first frame is the first row's, and
            where the file leaves out a frame's number, the films' frame is left out as well.
        axes: Axes of the file that are x, y and z of the cameras' world, such as "x -z y". If it is None, the file is
            taken as it is, or as Pose2Sim turns it ("z x y"), whichever puts more joints into pictures.

    Raises:
        InputError: If a file can't be read, names are no landmarks, or no camera sees a joint.
    """
    found = read_trc(path) if Path(path).suffix.lower() == ".trc" else read_joint_arrays(path)
    form = skeleton_of_names(found.names, str(path))
    if form is None:
        raise InputError(f"{path}: names that tell nothing; expected joints such as RShoulder or left_hip")
    indices = np.array(form.places)
    points = np.where((indices >= 0)[None, :, None], found.points[:, indices], np.nan)
    known = read_cameras(cameras)
    choices = [_views(points @ _axes(each).T, known) for each in ((axes,) if axes is not None else AXES)]
    joints, keypoints, inside = max(choices, key=lambda choice: np.count_nonzero(choice[2]))
    if not inside.any():
        raise InputError(f"{path}: no camera of {cameras} sees a joint; expected joints in its world (axes, units)")
    count = len(points)
    sizes = [camera.size for camera in known.values()]
    stem = Path(path).stem
    names = np.array(list(known))
    of_film = None if films is None else _films(Path(films), list(known))
    with told_of(path):
        return Views(
            joint_names=np.array(form.landmarks),
            joints_camera=joints,
            keypoints=keypoints,
            person=np.full(len(joints), "0"),
            set=np.full(len(joints), stem),
            frame=np.repeat(found.frames, len(known)),
            camera=np.tile(names, count),
            convention=np.full(len(joints), "" if form.marks == form.landmarks else "coco"),
            focal=np.tile([camera.focal for camera in known.values()], (count, 1)),
            centre=np.tile([camera.principal for camera in known.values()], (count, 1)),
            picture_size=None if None in sizes else np.tile(np.array(sizes), (count, 1)),
            film=None if of_film is None else np.tile(of_film, count),
            film_frame=None if of_film is None else np.repeat(found.frames - found.frames[0], len(known)),
        )


def _axes(text: str) -> np.ndarray:
    """Matrix (3, 3) from a file's axes to the world's."""
    rows = []
    for word in text.split():
        sign, name = (-1.0, word[1:]) if word.startswith("-") else (1.0, word)
        if name not in ("x", "y", "z"):
            break
        rows.append(sign * np.eye(3)["xyz".index(name)])
    matrix = np.array(rows)
    if matrix.shape != (3, 3) or not np.isclose(np.linalg.det(matrix), 1):
        raise InputError(
            f"axes: {shown(text)}; expected x, y and z in an order, such as 'x -z y', that mirrors nothing"
        )
    return matrix


def _views(points: np.ndarray, cameras: Mapping[str, CalibratedCamera]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (T, J, 3) before each camera [m], in its picture [px], and whether it shows them; rows by time."""
    joints = np.stack([points @ each.rotation.T + each.translation for each in cameras.values()], axis=1)
    focal, principal = (np.array([getattr(each, name) for each in cameras.values()]) for name in ("focal", "principal"))
    with np.errstate(all="ignore"):
        projected = joints[..., :2] / joints[..., 2:] * focal[:, None] + principal[:, None]
        before = (joints[..., 2] > 0) & (np.abs(projected) <= LARGEST_COORDINATE).all(axis=-1)
        size = np.array([each.size or (np.inf, np.inf) for each in cameras.values()])[:, None, ::-1]
        inside = before & ((projected >= 0) & (projected < size)).all(axis=-1)
    projected[~before] = np.nan
    count = points.shape[1]
    return joints.reshape(-1, count, 3), projected.reshape(-1, count, 2), inside.reshape(-1, count)


def _films(folder: Path, cameras: Sequence[str]) -> np.ndarray:
    """Film of each camera, shape (C,), text."""
    found = sorted(each for each in folder.glob("*") if each.suffix.lower() in FILM_SUFFIXES)
    if len(found) != len(cameras):
        raise InputError(f"{folder}: {len(found)} films; expected {len(cameras)}, one a camera")
    of_film = assign_cameras(found, cameras).cameras
    return np.array([str(found[of_film.index(index)].resolve()) for index in range(len(cameras))])
