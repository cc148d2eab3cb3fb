"""Read 2D keypoints from JSON, in the shapes in which detectors write them.

* ``{"format": "coco17", "keypoints": [[x, y, confidence], ...]}``, the format's name and order as in ``skeletons.py``;
  ``[x, y]`` alone, flat lists ``[x, y, confidence, x, y, ...]`` and a missing ``format`` are fine too;
* OpenPose's own: ``{"people": [{"pose_keypoints_2d": [x, y, confidence, ...]}, ...]}``, and folders of such files;
* COCO's annotations or results: objects with flat ``keypoints``, alone, in a list, or under ``annotations``; their
  visibilities 1 and 2 become the confidences 0.5 and 1;
* MMPose's predictions: objects with ``keypoints`` and ``keypoint_scores``, in a list, under ``instances`` or under
  ``instance_info``, or, of a film, one frame with its ``instances``;
* Ultralytics' results (``to_json``): objects whose ``keypoints`` hold the lists ``x``, ``y`` and ``visible``, their
  confidences; it writes (0, 0) for points that are less than half sure, which are missing;
* the bare list of one person's keypoints, or a list of such lists.

Without a name, the number of keypoints tells the format; 17 is COCO. Points that are no landmark are left out. Missing
are keypoints of confidence 0, with null or NaN for all their numbers, and, where no confidences are given, those at
exactly (0, 0).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from ..body.skeletons import SKELETONS, Skeleton, skeleton
from ..errors import InputError, shown
from ..files.json_files import read_json
from .keypoints import LARGEST_PLACE, Keypoints2D

# Spellings of a format, without case, blanks and punctuation.
_ALIASES: dict[str, str] = {
    **{name: name for name in SKELETONS},
    "coco": "coco17",
    "openpose": "body25",
    "openposebody25": "body25",
    "openposecoco": "coco18",
    "openposecoco18": "coco18",
    "openpose18": "coco18",
    "halpe": "halpe26",
    "wholebody": "wholebody133",
    "cocowholebody": "wholebody133",
    "cocowholebody133": "wholebody133",
    "blazepose": "blazepose33",
    "mediapipe": "blazepose33",
    "mediapipepose": "blazepose33",
    "h36m": "h36m17",
    "human36m": "h36m17",
    "human36m17": "h36m17",
    "lsp": "lsp14",
    "mpii": "mpii16",
    "openposebody25b": "body25b",
    "openposebody135": "body135",
    "halpefullbody": "halpe136",
    "crowdpose": "crowdpose14",
    "aic": "aic14",
    "aichallenger": "aic14",
    "posetrack": "posetrack17",
    "posetrack18": "posetrack17",
}
# Formats with as many points as another, which the number alone is taken for.
NAMED_ALONE = ("h36m17", "posetrack17", "crowdpose14", "aic14", "body25b")
_BY_COUNT: dict[int, Skeleton] = {form.count: form for name, form in SKELETONS.items() if name not in NAMED_ALONE}
# Keys of objects that hold a list of people, or of frames.
_LISTS = ("people", "instances", "annotations", "instance_info", "predictions")
_KEYPOINTS = ("keypoints", "pose_keypoints_2d", "pose_keypoints")  # the last: OpenPose's before version 1.2
_NUMBERS = {int, float}
_MAX_CONFIDENCE = 1.5  # Heat maps peak a little above 1 now and then; those are taken as 1.
_MAX_NORMALISED = 1.5  # MediaPipe's coordinates in shares of the picture's size go a little beyond it.
_MIN_EXTENT = 1.0  # [px]; keypoints closer together than a pixel are one point.


def keypoint_file(path: Path, photo: Path | None) -> Path:
    """The file itself, or a photo's file in a folder such as OpenPose writes, ``NAME_keypoints.json``.

    Raises:
        InputError: If a folder has none for the photo, or, without a photo, not exactly one.
    """
    if not path.is_dir():
        return path
    if photo is None:
        found = sorted(path.glob("*_keypoints.json"))
        if len(found) != 1:
            raise InputError(f"{path}: {len(found)} *_keypoints.json there; expected one, or a photo that tells which")
        return found[0]
    names = [f"{photo.stem}{ending}" for ending in ("_keypoints.json", ".keypoints.json", ".json")]
    for name in names:
        if (path / name).is_file():
            return path / name
    raise InputError(f"{path}: no keypoints of {photo.name}; expected {' or '.join(names)} there")


def read_keypoints(path: str | Path, keypoint_format: str | Path | Skeleton | None = None) -> list[Keypoints2D]:
    """Read everybody's 2D keypoints from a JSON file, in its order, but for people without visible keypoints.

    Args:
        path: The file.
        keypoint_format: Name of the format, if the file's is missing or wrong, or a JSON file of one's own.

    Raises:
        InputError: If the file can't be read or understood, or nobody in it has usable keypoints.
    """
    return parse_keypoints(read_json(path, "keypoints in JSON"), keypoint_format, name=str(path))


def parse_keypoints(
    data: Any, keypoint_format: str | Path | Skeleton | None = None, *, name: str = "keypoints"
) -> list[Keypoints2D]:
    """Read everybody's 2D keypoints from a file's content; errors call it ``name``.

    Raises:
        InputError: If it can't be understood, or nobody in it has usable keypoints.
    """
    given = None if keypoint_format is None else given_format(keypoint_format)
    entries = _people(data, name)
    if not entries:
        raise InputError(f"{name}: nobody in it; expected keypoints of at least one person")
    places = [name] if len(entries) == 1 else [f"{name}: person {index}" for index in range(len(entries))]
    alike: dict[tuple[Skeleton, int], list[int]] = {}  # whose keypoints make one array: format and numbers a keypoint
    numbers: list[list[float]] = []
    for index, (entry, where) in enumerate(zip(entries, places, strict=True)):
        form, width, values = _person(entry, given, where)
        alike.setdefault((form, width), []).append(index)
        numbers.append(values)
    people: dict[int, Keypoints2D] = {}
    reasons: dict[int, str] = {}
    for (form, width), group in alike.items():
        table = np.array([numbers[index] for index in group]).reshape(len(group), -1, width)
        points, confidence = _checked(table, form, [places[index] for index in group])
        known = form.name if _is_known(form) else form
        for row, (index, reason) in enumerate(zip(group, _why_unusable(points, confidence), strict=True)):
            if reason is None:
                people[index] = Keypoints2D(known, points[row], confidence[row])
            else:
                reasons[index] = f"{places[index]}: {reason}"
    if not people:
        raise InputError(reasons[0])
    return [people[index] for index in sorted(people)]


def _is_known(form: Skeleton) -> bool:
    """True if a skeleton has the joints of the format of its name, whatever the order of a file."""
    known = SKELETONS.get(form.name)
    return known is not None and (form.landmarks, form.marks) == (known.landmarks, known.marks)


def given_format(given: str | Path | Skeleton) -> Skeleton:
    """Skeleton that a user names, or describes in a JSON file.

    Raises:
        InputError: If there is no such format or file.
    """
    if isinstance(given, Skeleton) or Path(given).suffix == ".json":
        return skeleton(given)
    return _named_format(given, "keypoint format", ", or a JSON file")


def format_of(count: int, given: Skeleton | None, where: str) -> Skeleton:
    """Format of so many keypoints a person: the given one, or else the one that the number tells.

    Raises:
        InputError: If the number tells none, or is not the given format's; ``where`` begins it.
    """
    if given is None and count not in _BY_COUNT:
        counts = ", ".join(f"{known} ({form.name})" for known, form in sorted(_BY_COUNT.items()))
        raise InputError(f"{where}: {count} keypoints; expected {counts}, or a format")
    form = given or _BY_COUNT[count]
    if count != form.count:
        raise InputError(f"{where}: {count} keypoints; expected {form.count} of {form.name}")
    return form


def _named_format(text: Any, where: str, also: str = "") -> Skeleton:
    """Skeleton by a user's or file's spelling: "BlazePose33 x,y,visibility px" is blazepose33."""
    words = str(text).lower().split()
    for candidate in ("".join(words), words[0] if words else ""):
        key = re.sub(r"[^a-z0-9]", "", candidate)
        if key in _ALIASES:
            return SKELETONS[_ALIASES[key]]
    raise InputError(f"{where}: {shown(text)}; expected one of {', '.join(SKELETONS)}{also}")


def _people(data: Any, name: str) -> list[Mapping[str, Any]]:
    """Objects with "keypoints", one per person, whatever the file's shape."""
    common, bare = {}, isinstance(data, list)
    if isinstance(data, Mapping):
        lists = [data[key] for key in _LISTS if isinstance(data.get(key), list)]
        if not lists and not _holds_people(data.get("keypoints")):
            return [data]
        meta = data.get("meta_info")  # MMPose's
        said = data.get("format", meta.get("dataset_name") if isinstance(meta, Mapping) else None)
        if said is not None:
            common = {"format": said}
        data = lists[0] if lists else data["keypoints"]
    elif not bare:
        raise InputError(f"{name}: {type(data).__name__}; expected an object or a list of keypoints")
    data = _one_picture(data, name)
    if bare and not _holds_people(data):
        return [{"keypoints": data}] if data else []
    people: list[Mapping[str, Any]] = []
    for index, entry in enumerate(data):
        if isinstance(entry, list):
            people.append({**common, "keypoints": entry})
        elif isinstance(entry, Mapping):
            people.append({**common, **entry})
        else:
            raise InputError(f"{name}: person {index}: {type(entry).__name__}; expected an object or a list")
    images = {str(person["image_id"]) for person in people if isinstance(person.get("image_id"), int | str)}
    if len(images) > 1:
        raise InputError(f"{name}: people of {len(images)} pictures; expected those of one")
    return people


def _one_picture(entries: list[Any], name: str) -> list[Any]:
    """People of a list of frames, of which there must be one; people as they are."""
    frames = [entry["instances"] for entry in entries if isinstance(entry, Mapping) and "instances" in entry]
    frames += [entry for entry in entries if isinstance(entry, list) and any(isinstance(one, Mapping) for one in entry)]
    if not frames:
        return entries
    if len(entries) > 1:
        raise InputError(f"{name}: people of {len(entries)} pictures; expected those of one")
    if not isinstance(frames[0], list):
        raise InputError(f"{name}: instances: {type(frames[0]).__name__}; expected a list of people")
    return frames[0]


def _holds_people(values: Any) -> bool:
    """True if this is a list of people, not of one person's rows or numbers."""
    if not isinstance(values, list) or not values:
        return False
    first = values[0]
    return isinstance(first, Mapping) or (
        isinstance(first, list) and (len(first) > 3 or any(isinstance(value, list) for value in first))
    )


def _person(entry: Mapping[str, Any], given: Skeleton | None, where: str) -> tuple[Skeleton, int, list[float]]:
    """Format, numbers a keypoint, and these numbers, one landmark's after the other's; null is NaN."""
    values = next((entry[key] for key in _KEYPOINTS if key in entry), None)
    if isinstance(values, Mapping):
        values = _columns(values, where)
    if not isinstance(values, list):
        raise InputError(f"{where}: no list of keypoints; expected one under keypoints or pose_keypoints_2d")
    form = given
    if form is None and entry.get("format") is not None:
        form = _named_format(entry["format"], f"{where}: format")
    rows = _rows(values, form, where)
    form = format_of(len(rows), form, where)
    scores = entry.get("keypoint_scores")
    if scores is not None:
        if not isinstance(scores, list) or len(scores) != len(rows):
            raise InputError(f"{where}: keypoint_scores: not one a keypoint; expected {len(rows)}")
        rows = [[*row[:2], score] for row, score in zip(rows, scores, strict=True)]
    missing = [None] * len(rows[0]) if rows else []
    rows = [missing if place < 0 else rows[place] for place in form.places]
    width, values = len(rows[0]), list(chain.from_iterable(rows))
    if set(map(type, values)) <= _NUMBERS:
        with suppress(OverflowError):
            return form, width, list(map(float, values))
    names = [f"{where}: {_named(form, joint)}" for joint in range(len(form))]
    return form, width, [_number(value, names[index // width]) for index, value in enumerate(values)]


def _named(form: Skeleton, joint: int) -> str:
    """A joint in a message: its row in the file, and its landmark."""
    return f"keypoint {form.places[joint]} ({form.landmarks[joint]})"


def _columns(lists: Mapping[str, Any], where: str) -> list[list[Any]]:
    """Rows from Ultralytics' lists x, y and, where there are confidences, visible; (0, 0) is missing."""
    columns: list[Any] = [lists.get(name) for name in ("x", "y", "visible") if name != "visible" or name in lists]
    if not all(isinstance(column, list) for column in columns) or len(set(map(len, columns))) > 1:
        raise InputError(f"{where}: keypoints: no lists x and y, and visible, of one length; expected such")
    rows = [list(row) for row in zip(*columns, strict=True)]
    return [[0] * len(row) if row[:2] == [0, 0] else row for row in rows]


def _rows(values: list[Any], form: Skeleton | None, where: str) -> list[list[Any]]:
    """Rows [x, y] or [x, y, confidence] from such rows (or null) or from a flat list."""
    kinds = set(map(type, values))
    if list in kinds:
        widths = {len(value) for value in values if type(value) is list}
        if widths not in ({2}, {3}) or not kinds <= {list, type(None)}:
            raise InputError(f"{where}: rows of {_listed(widths)} numbers; expected [x, y] or [x, y, confidence] each")
        return values if len(kinds) == 1 else [[None] * max(widths) if value is None else value for value in values]
    counts = {form.count} if form else set(_BY_COUNT)
    for width in (3, 2):
        if len(values) % width == 0 and len(values) // width in counts:
            return [values[k : k + width] for k in range(0, len(values), width)]
    raise InputError(
        f"{where}: {len(values)} numbers; expected 3 (x, y, confidence) or 2 a keypoint, of {_listed(counts)} keypoints"
    )


def _listed(numbers: set[int]) -> str:
    return " or ".join(map(str, sorted(numbers)))


def _number(value: Any, name: str) -> float:
    """A float; null is NaN."""
    if value is None:
        return math.nan
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{name}: {shown(value)}; expected numbers")
    try:
        return float(value)
    except OverflowError:
        return math.inf


def _checked(table: np.ndarray, form: Skeleton, places: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, J, 2) and confidences (N, J), float32, from N people's numbers (N, J, 2 or 3)."""

    def refuse(wrong: np.ndarray, found: Callable[[np.ndarray], str]) -> None:
        if wrong.any():
            person, joint = np.argwhere(wrong)[0].tolist()
            raise InputError(f"{places[person]}: {_named(form, joint)}: {found(table[person, joint])}")

    def listed(row: np.ndarray) -> str:
        return f"[{', '.join(f'{value:g}' for value in row)}]"

    points, unknown = table[..., :2], np.isnan(table).all(axis=-1)
    confidence = table[..., 2] if table.shape[-1] == 3 else np.ones(table.shape[:2])
    missing = unknown | ((confidence == 0) if table.shape[-1] == 3 else (points == 0).all(axis=-1))
    refuse(~missing & ~np.isfinite(table).all(axis=-1), lambda row: f"{listed(row)}; expected finite numbers")
    points = np.where(missing[..., None], 0.0, points)
    confidence = np.where(missing, 0.0, confidence)
    if (confidence == 2).any():
        visibility = np.isin(confidence, (0, 1, 2)).all(axis=1) & (confidence == 2).any(axis=1)
        confidence[visibility] /= 2  # COCO's: 1 = labelled, but hidden.
    refuse((confidence < 0) | (confidence > _MAX_CONFIDENCE), lambda row: f"confidence {row[2]:g}; expected 0 to 1")
    refuse(
        (np.abs(points) > LARGEST_PLACE).any(axis=-1),
        lambda row: f"{listed(row[:2])}; expected pixels, up to {LARGEST_PLACE:g}",
    )
    return points.astype(np.float32), np.minimum(confidence, 1.0).astype(np.float32)


def _why_unusable(points: np.ndarray, confidence: np.ndarray) -> list[str | None]:
    """Reason why each of N people's keypoints can't be used, None where they can."""
    visible = confidence[..., None] > 0
    lowest = np.where(visible, points, np.inf).min(axis=1)
    highest = np.where(visible, points, -np.inf).max(axis=1)
    extents = (highest - lowest).max(axis=1)
    largest = np.maximum(-lowest, highest).max(axis=1)
    reasons: list[str | None] = [None] * len(points)
    for person in np.flatnonzero(extents < _MIN_EXTENT):
        x, y = lowest[person]
        reasons[person] = f"all visible keypoints in one point ({x:g}, {y:g}); expected a person"
    for person in np.flatnonzero((extents > 0) & (largest <= _MAX_NORMALISED)):
        reasons[person] = "all keypoints between 0 and 1; expected pixels, not shares of the picture's size"
    for person in np.flatnonzero(~visible.any(axis=(1, 2))):
        reasons[person] = "no visible keypoint; expected some with confidence above 0"
    return reasons
