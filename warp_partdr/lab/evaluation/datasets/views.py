"""Views of real people with 3D truth: one layout of arrays, in an ``.npz`` file.

A row is a person, a moment and a camera. ``Views`` says what each array holds; readers of data sets make them, and
``view_samples`` makes samples of their rows. docs/how_to/evaluate.md says how to bring a data set of one's own.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ....body.keypoint_names import skeleton_of_names
from ....body.landmarks import CONVENTIONS, LANDMARKS, annotated, mirror_name
from ....body.skeletons import MPJPE_JOINTS, Skeleton, known_edges, skeleton
from ....body.stature import LEAST_STATURE, MOST_STATURE
from ....cameras import Perspective
from ....errors import InputError, cause, check_whole, shown, told_of
from ....files.array_files import read_npz
from ....inputs.films import FilmPicture
from ....inputs.keypoints import LARGEST_COORDINATE, Keypoints2D
from ....inputs.sample import Sample
from ..sizes import trunk_and_legs

ROWS = ("inside", "baseline", "every")
CLUSTERS = ("people", "moments")
FILE_NAMES = ("views.npz", "sights.npz")

_MAX_BYTES = 4 << 30  # of a file's arrays when unpacked
_NUMBERS, _WHOLE, _TEXT, _FLAGS, _NAMES = "fiu", "iu", "U", "b", "Uiu"  # kinds of dtypes


class _Rule(NamedTuple):
    """Rule for an array: kinds of dtypes, shape (N rows, J joints, K keypoints), and the range of its numbers."""

    kinds: str
    shape: tuple[str | int, ...]
    least: float = -math.inf
    most: float = math.inf


_ARRAYS = {
    "joint_names": _Rule(_TEXT, ("J",)),
    "joints_camera": _Rule(_NUMBERS, ("N", "J", 3), -1e5, 1e5),
    "keypoints": _Rule(_NUMBERS, ("N", "K", 2), -LARGEST_COORDINATE, LARGEST_COORDINATE),
    "person": _Rule(_NAMES, ("N",)),
    "keypoint_names": _Rule(_TEXT, ("K",)),
    "confidence": _Rule(_NUMBERS, ("N", "K"), 0.0, 1.0),
    "set": _Rule(_TEXT, ("N",)),
    "frame": _Rule(_NAMES, ("N",)),
    "camera": _Rule(_NAMES, ("N",)),
    "convention": _Rule(_TEXT, ("N",)),
    "focal": _Rule(_NUMBERS, ("N", 2), 1.0, 1e6),
    "centre": _Rule(_NUMBERS, ("N", 2), -1e6, 1e6),
    "picture_size": _Rule(_WHOLE, ("N", 2), 1, LARGEST_COORDINATE),
    "stature": _Rule(_NUMBERS, ("N",), LEAST_STATURE, MOST_STATURE),
    "baseline": _Rule(_FLAGS, ("N",)),
    "picture": _Rule(_TEXT, ("N",)),
    "film": _Rule(_TEXT, ("N",)),
    "film_frame": _Rule(_WHOLE, ("N",), 0),
}
_MAY_BE_NAN = ("joints_camera", "keypoints", "stature")
_REQUIRED = ("joint_names", "joints_camera", "keypoints", "person")
_EXPECTED = "views of people with 3D truth: views.npz or sights.npz with the arrays of docs/how_to/evaluate.md"
# Sets whose joints are another convention's: Panoptic's are triangulated from detections of a network that learned from
# COCO, and Campus was annotated as Shelf.
_CONVENTION_OF_SET = {"panoptic": "coco", "campus": "shelf"}
_KNOWN_CONVENTIONS = ("coco", *CONVENTIONS)
_SMALLEST, _LARGEST = 0.1, 10.0  # [m], extent of what is known of people, by which other units than metres are seen
_FEW = 4  # joints that tell an extent
_FEWEST = 3  # joints that can be aligned with a body's
# Share of the stature from ankles by knees to hips, and from there up to the shoulders: Drillis and Contini (1966).
_STANDING_SHARE = 0.779


@dataclass(frozen=True)
class Views:
    """N views of people with 3D truth, as arrays of the names that they have in a file.

    Attributes:
        joint_names: Landmarks of the J joints, text.
        joints_camera: True joints in the camera frame [m], shape (N, J, 3). They are NaN where unknown.
        keypoints: Keypoints in the picture without lens distortion, where the middle of the first pixel is at (0.5,
            0.5) [px], shape (N, K, 2). They are NaN where missing.
        person: Name or number of the person within the set, shape (N,).
        keypoint_names: Names of the K keypoints, as a detector has them. If it is None, they are the joints' names, at
            the same points.
        confidence: Confidence of the keypoints, 0 to 1, shape (N, K). If it is None, it is 1.
        set: Name of the data set, shape (N,), text. If it is None, it is the name of the folder.
        frame: Name or number of the moment, shape (N,).
        camera: Name or number of the camera, shape (N,).
        convention: Convention whose points of the body the joints mark, such as "coco", shape (N,), or "" where they
            are the body's own. If it is None, it is the set's name up to its first "_", such as "h36m". Panoptic's are
            COCO's, and Campus's are Shelf's.
        focal: Focal lengths (f_x, f_y) [px], shape (N, 2). If it is None, they are unknown.
        centre: Principal points [px], shape (N, 2). If it is None, they are unknown.
        picture_size: Height and width (H, W) of the pictures [px], shape (N, 2), whole numbers. If it is None, they are
            unknown.
        stature: Height of the person standing [m], shape (N,), NaN where unknown. If it is None, the bones tell it.
        baseline: Mask of the rows of a selection that is always the same, shape (N,), bool.
        picture: File of the picture, shape (N,), text. It is "" where there is none.
        film: File of the film that the picture is from, shape (N,), text. It is "" where there is none.
        film_frame: Number of the picture in its film, 0 for the first, shape (N,).
        folder: Folder that files are relative to.

    Raises:
        InputError: If an array has another shape or kind, holds NaN or numbers that can't be, or a name is no landmark;
            or if people are of another size than people's, or stand behind their cameras.

    Examples:
        >>> import numpy as np
        >>> from warp_partdr.benchmark import Views, make_sample
        >>> sample = make_sample(0, "clean")
        >>> joints = sample.joints[None] + [0, 0, 4]  # one view of a person, 4 m away [m]
        >>> views = Views(
        ...     joint_names=np.array(sample.joint_names),
        ...     joints_camera=joints,
        ...     keypoints=1000 * joints[..., :2] / joints[..., 2:] + 500,
        ...     person=np.array(["somebody"]),
        ... )
        >>> len(views), views.keypoints.shape
        (1, (1, 14, 2))
    """

    joint_names: np.ndarray
    joints_camera: np.ndarray
    keypoints: np.ndarray
    person: np.ndarray
    keypoint_names: np.ndarray | None = None
    confidence: np.ndarray | None = None
    set: np.ndarray | None = None
    frame: np.ndarray | None = None
    camera: np.ndarray | None = None
    convention: np.ndarray | None = None
    focal: np.ndarray | None = None
    centre: np.ndarray | None = None
    picture_size: np.ndarray | None = None
    stature: np.ndarray | None = None
    baseline: np.ndarray | None = None
    picture: np.ndarray | None = None
    film: np.ndarray | None = None
    film_frame: np.ndarray | None = None
    folder: Path = Path()

    def __post_init__(self) -> None:
        sizes = {"N": len(np.atleast_1d(self.person)), "J": len(np.atleast_1d(self.joint_names))}
        names = self.joint_names if self.keypoint_names is None else self.keypoint_names
        sizes["K"] = len(np.atleast_1d(names))
        for name, values in self.arrays().items():
            _check_array(name, values, sizes)
        for one, other in (("focal", "centre"), ("film", "film_frame")):
            if (getattr(self, one) is None) != (getattr(self, other) is None):
                raise InputError(f"{one}, {other}: one without the other; expected both, or neither")
        _check_names("joint_names", self.joint_names)
        _check_landmarks(self.joint_names)
        if self.keypoint_names is not None:
            _check_names("keypoint_names", self.keypoint_names)
        _check_metres(self.joints_camera)
        if self.focal is not None:
            _check_before_cameras(self.joints_camera, self.keypoints)

    def __len__(self) -> int:
        """Number of views, N."""
        return len(self.person)

    def arrays(self) -> dict[str, np.ndarray]:
        """Arrays that are there, by name."""
        return {name: values for name in _ARRAYS if (values := getattr(self, name)) is not None}

    def rows(self, chosen: np.ndarray) -> Views:
        """Views of some rows, by their numbers."""
        whole = ("joint_names", "keypoint_names")
        kept = {name: values if name in whole else values[chosen] for name, values in self.arrays().items()}
        return Views(**kept, folder=self.folder)

    def inside(self) -> np.ndarray:
        """Keypoints that are known and in the picture, shape (N, K), bool."""
        there = np.isfinite(self.keypoints).all(axis=-1)
        if self.picture_size is not None:
            with np.errstate(invalid="ignore"):
                there &= ((self.keypoints >= 0) & (self.keypoints < self.picture_size[:, None, ::-1])).all(axis=-1)
        return there

    def usable(self) -> np.ndarray:
        """Rows that can be fitted and compared: a keypoint is seen and three joints are known, shape (N,), bool."""
        seen = self.inside() if self.confidence is None else self.inside() & (self.confidence > 0)
        return seen.any(axis=1) & (np.isfinite(self.joints_camera).all(axis=-1).sum(axis=1) >= _FEWEST)

    def people(self) -> np.ndarray:
        """Name of each row's person, with the set's, such as "shelf/0", shape (N,)."""
        person = self.person.astype(str)
        return person if self.set is None else np.char.add(np.char.add(self.set.astype(str), "/"), person)

    def frames(self) -> np.ndarray:
        """Name of each row's moment, shape (N,); "0" where none is told."""
        return np.full(len(self), "0") if self.frame is None else self.frame.astype(str)


def read_views(path: str | Path) -> Views:
    """Read views of people.

    Args:
        path: An ``.npz`` file, or a folder with ``views.npz`` or ``sights.npz``. Other arrays may be in the file.

    Raises:
        InputError: If there is no such file, or an array is missing or wrong.
    """
    file = path = Path(path)
    if path.is_dir():
        file = next((path / name for name in FILE_NAMES if (path / name).is_file()), path / FILE_NAMES[0])
    optional = tuple(name for name in _ARRAYS if name not in _REQUIRED)
    arrays = read_npz(file, _REQUIRED, optional, expected=_EXPECTED, most=_MAX_BYTES)
    with told_of(file):
        views = Views(**arrays, folder=file.parent)
    if views.set is None:
        name = path.resolve().name if path.is_dir() else path.stem
        views = replace(views, set=np.full(len(views), name))
    return views


def concatenate_views(several: Sequence[Views]) -> Views:
    """Join views of the same joints, with the same arrays, into one.

    Raises:
        InputError: If there are none, or some are of other joints or have other arrays than the first.
    """
    if not several:
        raise InputError("views: none; expected at least one")
    first, whole = several[0], ("joint_names", "keypoint_names")
    for views in several:
        if views.arrays().keys() != first.arrays().keys():
            only = sorted(views.arrays().keys() ^ first.arrays().keys())
            raise InputError(f"{first.folder}: {', '.join(only)}: in some files alone; expected it in all, or none")
        if not np.array_equal(views.joint_names, first.joint_names):
            counts = f"{len(first.joint_names)} and {len(views.joint_names)}"
            raise InputError(f"{first.folder}: files with {counts} joints; expected one kind of file a folder")
    arrays = {
        name: values if name in whole else np.concatenate([views.arrays()[name] for views in several])
        for name, values in first.arrays().items()
    }
    return Views(**arrays, folder=first.folder)


def write_views(path: str | Path, views: Views) -> None:
    """Write views to an ``.npz`` file; files of pictures and films are named by their whole paths.

    Raises:
        InputError: If the file can't be written.
    """
    arrays = views.arrays()
    for name in ("picture", "film"):
        if name in arrays:
            paths = [str((views.folder / each).resolve()) if each else "" for each in arrays[name].tolist()]
            arrays[name] = np.array(paths)
    try:
        with Path(path).open("wb") as file:
            np.savez_compressed(file, **arrays)  # type: ignore[arg-type]  # numpy's stubs take them for options
    except OSError as error:
        raise InputError(f"{path}: {cause(error)}; expected a file that can be written") from error


@dataclass(frozen=True)
class ViewSelection:
    """Choice of rows.

    Attributes:
        rows: Kind of rows: "inside" for those with all known keypoints in the picture, "baseline" for those that are
            marked so, or "every" for all.
        people: Names of people or sets, such as "shelf/0" or "shelf". If it is empty, all are taken.
        leave_out: Names of people or sets that are left out.
        frames: Names or numbers of moments. If it is empty, all are taken.
        step: Distance of the rows that are taken: 1 takes each row, and 2 every second one.

    Examples:
        With ``views``, people of the class ``Views``:

        >>> from warp_partdr.benchmark import ViewSelection
        >>> ViewSelection("every", step=2).of(views)
        array([0])
    """

    rows: str = "inside"
    people: tuple[str, ...] = ()
    leave_out: tuple[str, ...] = ()
    frames: tuple[str, ...] = ()
    step: int = 1

    def of(self, views: Views) -> np.ndarray:
        """Numbers of the rows, in order.

        Raises:
            InputError: If a person is unknown, the file marks no baseline, or no row is left.
        """
        check_whole("step", self.step, 1)
        if self.rows not in ROWS:
            raise InputError(f"rows: {shown(self.rows)}; expected {', '.join(ROWS)}")
        known = np.isfinite(views.keypoints).all(axis=-1)
        kept = (views.inside() | ~known).all(axis=1) if self.rows == "inside" else np.ones(len(views), dtype=bool)
        if self.rows == "baseline":
            if views.baseline is None:
                raise InputError("rows: baseline, but there is no array baseline; expected it, or rows inside or every")
            kept = views.baseline.copy()
        kept &= views.usable()
        if self.people:
            kept &= _named(views, self.people)
        if self.leave_out:
            kept &= ~_named(views, self.leave_out)
        if self.frames:
            kept &= np.isin(views.frames(), self.frames)
        found = np.flatnonzero(kept)[:: self.step]
        if not len(found):
            raise InputError(f"rows: none of {len(views)} left; expected at least one (rows inside, baseline or every)")
        return found


def view_samples(
    views: Views,
    rows: np.ndarray,
    *,
    convention: str | None = None,
    keypoints: str | None = None,
    clusters: str = "people",
) -> list[Sample]:
    """Make samples of some rows; keypoints that are out of the picture are missing, as no detector sees them.

    Args:
        views: Views that ``read_views`` returns, or a data set's reader.
        rows: Indices of the rows.
        convention: Convention that replaces that of the rows, such as "coco" or "h36m". "" means that joints mark the
            body's own points.
        keypoints: Format of the keypoints, such as "coco17". Views that know all of its keypoints give these alone, at
            the format's own marks. Other views give what they know, as do all views if it is None.
        clusters: Kind of the groups within which samples are not independent: "people", or people's "moments".

    Raises:
        InputError: If there are no such clusters, convention or format, or names of keypoints tell nothing.

    Examples:
        With ``views``, people of the class ``Views``:

        >>> from warp_partdr.benchmark import ViewSelection, evaluate, real_methods, view_samples
        >>> samples = view_samples(views, ViewSelection("every").of(views))
        >>> report = evaluate(samples, {"network": real_methods()["network"]})
        >>> len(samples), len(report.scores)
        (2, 2)
    """
    if clusters not in CLUSTERS:
        raise InputError(f"intervals: {shown(clusters)}; expected {' or '.join(CLUSTERS)}")
    inside, statures, people, frames = views.inside(), _statures(views), views.people(), views.frames()
    cameras = np.arange(len(views)).astype(str) if views.camera is None else views.camera.astype(str)
    if convention is not None:
        convention = _known_convention(convention)
    times: Counter[str] = Counter()
    samples = []
    for row in rows.tolist():
        own_convention = _convention(views, row) if convention is None else convention
        person, moment = str(people[row]), f"{people[row]}/{frames[row]}"
        name = f"{moment}/{cameras[row]}"
        times[name] += 1
        if times[name] > 1:  # methods are compared on samples of the same name
            name = f"{name} ({times[name]})"
        samples.append(
            Sample(
                source="people" if views.set is None else str(views.set[row]),
                name=name,
                keypoints=_keypoints(views, row, inside[row], own_convention, keypoints),
                joints=_take(views.joints_camera[row], _landmarks(views.joint_names), MPJPE_JOINTS),
                joint_marks=annotated(MPJPE_JOINTS, convention=own_convention),
                picture=_picture(views, row),
                camera=_camera(views, row),
                stature=None if np.isnan(statures[row]) else float(statures[row]),
                cluster=person if clusters == "people" else moment,
            )
        )
    return samples


def _check_array(name: str, values: object, sizes: dict[str, int]) -> None:
    kinds, shape, least, most = _ARRAYS[name]
    expected = tuple(sizes[each] if isinstance(each, str) else each for each in shape)
    if not isinstance(values, np.ndarray) or values.dtype.kind not in kinds:
        kind_names = {_TEXT: "text", _FLAGS: "true or false", _NAMES: "text or whole numbers", _WHOLE: "whole numbers"}
        raise InputError(
            f"{name}: {getattr(values, 'dtype', type(values).__name__)}; expected {kind_names.get(kinds, 'numbers')}"
        )
    if values.shape != expected:
        raise InputError(f"{name}: shape {values.shape}; expected {expected}, ({', '.join(map(str, shape))})")
    if kinds == _NUMBERS:
        wrong = np.isinf(values) if name in _MAY_BE_NAN else ~np.isfinite(values)
        if wrong.any():
            also = ", or NaN" if name in _MAY_BE_NAN else ""
            raise InputError(f"{name}: {values[wrong][0]} in it; expected finite numbers{also}")
    if kinds in (_NUMBERS, _WHOLE):
        wrong = (values < least) | (values > most)
        if wrong.any():
            bounds = f"{least:g} or more" if math.isinf(most) else f"{least:g} to {most:g}"
            raise InputError(f"{name}: {values[wrong][0]} in it; expected {bounds}")


def _check_names(name: str, names: np.ndarray) -> None:
    """Raise InputError unless there are names, each of them once."""
    if not len(names):
        raise InputError(f"{name}: none; expected at least one")
    most, times = Counter(names.tolist()).most_common(1)[0]
    if times > 1:
        raise InputError(f"{name}: {shown(most)} {times} times; expected each name once")


def _check_metres(joints: np.ndarray) -> None:
    """Raise InputError if most people of joints (N, J, 3) are as large as none is in metres."""
    known = np.isfinite(joints).all(axis=-1)
    rows = known.sum(axis=1) >= _FEW
    if not rows.any():
        return
    some = joints[rows].astype(np.float64)
    low, high = (np.where(known[rows][..., None], some, end) for end in (np.inf, -np.inf))
    extent = float(np.median(np.linalg.norm(high.max(axis=1) - low.min(axis=1), axis=-1)))
    if not _SMALLEST <= extent <= _LARGEST:
        raise InputError(f"joints_camera: people of {extent:.3g} m; expected joints in metres")


def _check_before_cameras(joints: np.ndarray, keypoints: np.ndarray) -> None:
    """Raise InputError if a row of joints (N, J, 3) that is seen lies behind its camera with all that is known."""
    depths = joints[..., 2]
    known = np.isfinite(depths)
    behind = known.any(axis=1) & ~(known & (depths > 0)).any(axis=1) & np.isfinite(keypoints).all(axis=-1).any(axis=1)
    if behind.any():
        row = int(behind.argmax())
        raise InputError(f"joints_camera: row {row} is behind its camera; expected z away from the viewer")


def _check_landmarks(names: np.ndarray) -> None:
    listed = names.tolist()
    for name in listed:
        if name not in LANDMARKS:
            raise InputError(f"joint_names: {shown(name)}; expected landmarks of body/landmarks.py, such as left_hip")
        if mirror_name(name) not in listed:
            raise InputError(f"joint_names: {name}, without {mirror_name(name)}; expected both sides")


def _named(views: Views, names: Sequence[str]) -> np.ndarray:
    """Rows of these people or sets, shape (N,), bool."""
    people = views.people()
    sets = np.full(len(views), "") if views.set is None else views.set.astype(str)
    found = np.zeros(len(views), dtype=bool)
    for name in names:
        own = (people == name) | (sets == name)
        if not own.any():
            raise InputError(
                f"people: {shown(name)}; expected of {', '.join(dict.fromkeys(people.tolist()))}, or a set"
            )
        found |= own
    return found


def _convention(views: Views, row: int) -> str:
    if views.convention is not None:
        return _known_convention(str(views.convention[row]))
    if views.set is None:
        return ""
    name = str(views.set[row]).lower().partition("_")[0]
    return _CONVENTION_OF_SET.get(name, name)


def _known_convention(name: str) -> str:
    """Convention of this name, or of the data set of this name; "" is the body's own."""
    found = _CONVENTION_OF_SET.get(name, name)
    if found not in ("", *_KNOWN_CONVENTIONS):
        known = ", ".join((*_KNOWN_CONVENTIONS, *_CONVENTION_OF_SET))
        raise InputError(f"convention: {shown(name)}; expected {known}, or the body's own")
    return found


def _keypoints(views: Views, row: int, there: np.ndarray, convention: str, wanted: str | None) -> Keypoints2D:
    """Keypoints of a view that are ``there``, in a format that is wanted, or else in the file's own."""
    confidence = there.astype(np.float32)
    if views.confidence is not None:
        confidence *= views.confidence[row].astype(np.float32)
    if views.keypoint_names is None:
        form = _skeleton(_landmarks(views.joint_names), convention)
    else:
        form = _detected_skeleton(_landmarks(views.keypoint_names))
    names, indices = form.landmarks, np.array(form.places)
    known = np.where(indices >= 0, confidence[indices], 0.0)
    points = np.where(known[:, None] > 0, views.keypoints[row][indices], 0.0)
    truly = set(np.array(names)[np.isfinite(views.keypoints[row][indices]).all(axis=1)].tolist())
    if wanted is not None and truly >= set(skeleton(wanted).landmarks):
        form = skeleton(wanted)
        known, points = (_take(each, names, form.landmarks) for each in (known, points))
    size = _picture_size(views, row)
    return Keypoints2D(form, points.astype(np.float32), known.astype(np.float32), image_size=size)


def _take(values: np.ndarray, names: Sequence[str], wanted: Sequence[str]) -> np.ndarray:
    """Rows of the landmarks that are wanted; NaN for those that are not among the names."""
    unknown = np.full(values.shape[1:], np.nan)
    return np.stack([values[names.index(name)] if name in names else unknown for name in wanted])


def _landmarks(names: np.ndarray) -> tuple[str, ...]:
    return tuple(map(str, names))


@lru_cache(maxsize=64)
def _skeleton(names: tuple[str, ...], convention: str) -> Skeleton:
    marks = annotated(names, convention=convention)
    return Skeleton(convention or "named", names, marks, known_edges(names), tuple(range(len(names))), len(names))


@lru_cache(maxsize=8)
def _detected_skeleton(names: tuple[str, ...]) -> Skeleton:
    found = skeleton_of_names(names, "keypoint_names")
    if found is None:
        raise InputError(f"keypoint_names: {shown(names[0])} and others; expected names such as left_shoulder")
    return found


def _picture_size(views: Views, row: int) -> tuple[int, int] | None:
    if views.picture_size is None:
        return None
    height, width = views.picture_size[row].tolist()
    return height, width


def _picture(views: Views, row: int) -> Path | FilmPicture | None:
    """File of a view's picture, or the frame of its film."""
    if views.picture is not None and views.picture[row]:
        return views.folder / str(views.picture[row])
    if views.film is not None and views.film_frame is not None and views.film[row]:
        return FilmPicture(views.folder / str(views.film[row]), int(views.film_frame[row]))
    return None


def _camera(views: Views, row: int) -> Perspective | None:
    """Camera of a view; of two focal lengths the geometric mean, as fits need square pixels."""
    if views.focal is None or views.centre is None:
        return None
    focal = float(np.sqrt(views.focal[row].prod()))
    u, v = views.centre[row].tolist()
    return Perspective.of_picture(_picture_size(views, row) or (1, 1), focal=focal, principal=(u, v))


def _statures(views: Views) -> np.ndarray:
    """Height of each row's person [m]: as given, or as the person's bones tell it in the mean; NaN: unknown."""
    statures = np.full(len(views), np.nan) if views.stature is None else views.stature.astype(np.float64)
    names, people = _landmarks(views.joint_names), views.people()
    bones = trunk_and_legs(views.joints_camera, names) / _STANDING_SHARE
    for person in dict.fromkeys(people.tolist()):
        own = people == person
        if np.isfinite(bones[own]).any():
            statures[own & np.isnan(statures)] = np.nanmean(bones[own])
    return statures
