"""Reader of the results of ``partdr fit FILM``: the people's motions, and the cameras of the films."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..cameras import Perspective
from ..errors import InputError, cause
from ..files.array_files import read_npz
from ..files.json_files import read_json
from ..inputs.calibrated_camera import CalibratedCamera
from ..inputs.scene import PersonShape, View
from ..models.clothes import CLOTHED
from ..models.model import DetailedModel
from ..pipelines.film import Motion
from .motion_confidence import CONFIDENCE_ARRAYS, read_confidence
from .plausible import check_picture_size, check_plausible
from .predictions import FilmBodies, load_film_bodies
from .result_sets import PEOPLE_REPORT

_EXPECTED = "the people.json of `partdr fit FILM --out FOLDER`"
_MOTION = "a personN.npz of `partdr fit FILM --out FOLDER`"
_VIEW = '{"film": name, "size": [W, H], "focal", "principal": [u, v], "rotation", "translation", "lens"}'
_MOST_FRAMES = 10_000_000
_RATES = 1e-5, 1e5  # frames a second; the least is about one a day


@dataclass(frozen=True)
class FilmView:
    """View of a scene, and the film that was taken there.

    Attributes:
        film: Name of the film, "" if it isn't known.
        size: Size (H, W) of its pictures [px].
        view: Camera and position, in pixels without distortion.
        lens: Camera whose distortion was removed; None: it has no distortion.
        numbers: Index of each frame in the film's file, -1 for none; None: all frames, from the first one on.
    """

    film: str
    size: tuple[int, int]
    view: View
    lens: CalibratedCamera | None = None
    numbers: tuple[int, ...] | None = None

    def number(self, frame: int) -> int | None:
        """Index of a frame in the film's file; None if the file has no such frame."""
        if self.numbers is None:
            return frame
        found = self.numbers[frame] if frame < len(self.numbers) else -1
        return None if found < 0 else found


@dataclass(frozen=True)
class SavedFilm:
    """Motions of people in a film, or in several films of one scene.

    Attributes:
        rate: Frames a second in most of the film.
        times: Time of each frame since the first [s], shape (T,).
        motions: Motions by person.
        views: Views, one for each film.
    """

    rate: float
    times: np.ndarray
    motions: dict[int, Motion]
    views: list[FilmView]


def load_film_fit(folder: str | Path, model: DetailedModel) -> SavedFilm:
    """Read a folder that ``save_film_fit`` wrote.

    Args:
        folder: Folder with people.json.
        model: Detailed model of the people's bodies.

    Raises:
        InputError: If files are missing or damaged, or belong to another model or to different runs.
    """
    path = Path(folder) / PEOPLE_REPORT
    report = read_json(path, _EXPECTED)
    try:
        rate, count = float(report["rate"]), int(report["frames"])
        names = {int(each["person"]): f"person{int(each['person'])}.npz" for each in report["people"]}
        views = [_view(each, f"{path}: views") for each in report.get("views", ())]
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"{path}: of no film ({type(error).__name__}: {cause(error)}); expected {_EXPECTED}"
        ) from error
    if not (_RATES[0] <= rate <= _RATES[1] and 0 < count <= _MOST_FRAMES and names):
        raise InputError(f"{path}: {len(names)} people, {count} frames, {rate:g} a second; expected some of each")
    motions, known = {}, np.full(count, np.nan)
    for person, name in names.items():
        bodies = load_film_bodies(Path(folder) / name)
        motions[person] = _motion(Path(folder) / name, bodies, count, model)
        known[bodies.rows["frames"]] = bodies.rows["times"]
        views = views or [_view_of(Path(folder) / name, bodies)]
    stated = report.get("times")
    times = _times(known, rate) if stated is None else _stated_times(stated, count, path)
    return SavedFilm(rate, times, motions, views)


def _motion(path: Path, bodies: FilmBodies, count: int, model: DetailedModel) -> Motion:
    """Read the motion in a person's file, whose bodies ``load_film_bodies`` has read."""
    rows, joints = len(bodies.rows), model.num_joints
    shapes = {
        "clothes": (len(CLOTHED),),
        "detailed_shape": (model.num_shapes,),
        "detailed_rotations": (rows, joints, 3, 3),
        "detailed_translation": (rows, 3),
    }
    data = read_npz(path, ("detailed_model", *shapes), CONFIDENCE_ARRAYS, expected=_MOTION)
    if (named := str(data.pop("detailed_model"))[:40]) != model.name:
        raise InputError(f"{path}: a body of {named!r}; expected one of {model.name!r}, the model that is loaded")
    for name, shape in shapes.items():
        if data[name].shape != shape or data[name].dtype.kind != "f" or not np.isfinite(data[name]).all():
            raise InputError(f"{path}: {name}: {data[name].dtype} {data[name].shape}; expected finite numbers {shape}")
        check_plausible(data[name], name, str(path))
    frames = bodies.rows["frames"].astype(np.int64)
    if frames[0] < 0 or frames[-1] >= count or (np.diff(frames) <= 0).any():
        raise InputError(f"{path}: frames: {frames[0]} to {frames[-1]}; expected some of 0 to {count - 1}, in order")
    tensors = {name: torch.from_numpy(data[name].astype(np.float32)).to(model.rest_vertices) for name in shapes}
    shape_of_person = PersonShape(tensors["detailed_shape"], tensors["clothes"])
    confidence = read_confidence(data, rows, str(path))
    return Motion(
        model, frames, shape_of_person, tensors["detailed_rotations"], tensors["detailed_translation"], confidence
    )


def _view(values: Any, where: str) -> FilmView:
    """Read a view of the report."""
    try:
        width, height = map(int, values["size"])
        check_picture_size((height, width), f"{where}: size")
        u, v = map(float, values["principal"])
        camera = Perspective.of_picture((height, width), focal=float(values["focal"]), principal=(u, v))
        rotation = torch.tensor(values["rotation"], dtype=torch.float32)
        translation = torch.tensor(values["translation"], dtype=torch.float32)
        check_plausible(translation.numpy(), "translation", where)
        lens = None
        if "lens" in values:
            across, down = map(float, values["lens"]["focal"])
            distortion = tuple(map(float, values["lens"]["distortion"]))
            lens = CalibratedCamera((across, down), (u, v), distortion, size=(height, width))
        numbers = None if values.get("film_frames") is None else tuple(map(int, values["film_frames"]))
        return FilmView(str(values["film"]), (height, width), View(camera, rotation, translation), lens, numbers)
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, OverflowError, RuntimeError) as error:
        raise InputError(f"{where}: {type(error).__name__}: {cause(error)}; expected {_VIEW} each") from error


def _view_of(path: Path, bodies: FilmBodies) -> FilmView:
    """Make the only view of bodies that are given in the camera's frame."""
    row = bodies.rows[0]
    u, v = row["camera_translation"].tolist()
    try:
        if not bodies.perspective:
            raise ValueError("camera_perspective: 0")
        camera = Perspective.of_picture(bodies.image_size, focal=float(row["camera_scale"]), principal=(u, v))
    except ValueError as error:
        raise InputError(f"{path}: {error}; expected {_MOTION}") from error
    return FilmView("", bodies.image_size, View(camera))


def _stated_times(stated: Any, count: int, path: Path) -> np.ndarray:
    """Check the times of all frames that the report has."""
    try:
        times = np.asarray(stated, dtype=np.float64)
    except (TypeError, ValueError):
        times = np.zeros(0)
    if times.shape != (count,) or not np.isfinite(times).all() or (np.diff(times) <= 0).any():
        raise InputError(f"{path}: times: not of {count} frames, or they do not rise; expected {_EXPECTED}")
    return times


def _times(known: np.ndarray, rate: float) -> np.ndarray:
    """Times of all frames: those that are known; between and around them, times at the film's rate."""
    frames, given = np.arange(len(known)), np.flatnonzero(np.isfinite(known))
    late = (known - frames / rate)[given]
    return np.asarray(np.maximum.accumulate(frames / rate + np.interp(frames, given, late)))
