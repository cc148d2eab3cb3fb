"""Read 2D keypoints from JSON, in the shapes in which detectors and annotation tools write them.

* ``{"format": "coco17", "keypoints": [[x, y, confidence], ...]}``, the format's name and order as in ``skeletons.py``;
  ``[x, y]`` alone, flat lists ``[x, y, confidence, x, y, ...]`` and a missing ``format`` are fine too;
* OpenPose's own: ``{"people": [{"pose_keypoints_2d": [x, y, confidence, ...]}, ...]}``, and folders of such files;
* COCO's annotations or results: objects with flat ``keypoints``, alone, in a list, or under ``annotations``; their
  visibilities 1 and 2 become the confidences 0.5 and 1;
* MMPose's predictions: objects with ``keypoints`` and ``keypoint_scores``, in a list, under ``instances`` or under
  ``instance_info``, or, for a film, one frame with its ``instances``;
* Ultralytics' results (``to_json``): objects whose ``keypoints`` hold the lists ``x``, ``y`` and ``visible``, which
  holds their confidences; (0, 0), which it writes for confidences below 0.5, is missing;
* AlphaPose's results for many pictures, with ``image_id``; its ``--format open`` and ``cmu`` have an entry a picture;
* points that are named one by one: LabelMe's ``shapes``, Label Studio's ``keypointlabels``, an object
  ``{"left_hip": [x, y, confidence], ...}``, TensorFlow.js' ``[{"name": "left_hip", "x": ..., "y": ..., ...}, ...]``;
* the bare list of one person's keypoints, or a list of such lists.

The order of the points comes from their names in the file: COCO's ``categories``, MMPose's ``meta_info``,
``keypoint_names`` and the like. Without names and without the name of a format, the number of keypoints decides the
format; 17 is COCO. Points that are no landmark are left out. A keypoint is missing if its confidence is 0, if all its
numbers are null or NaN, or, in files without confidences, if it lies at exactly (0, 0).

If a file holds many pictures, only people of the picture with the photo's name are read.

Odd things that can still be read are reported in ``Keypoints2D.warnings``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from ..body.keypoint_names import TWINS, left_out_warning, skeleton_of_names
from ..body.skeletons import SKELETONS, Skeleton, skeleton
from ..errors import InputError, shown
from ..files.json_files import read_json
from .annotated_sizes import StatedSize, match_sizes, outside_warning
from .keypoint_order import mirror_warning, order_warning
from .keypoint_shapes import PersonEntry, file_people, has_further, matching_names
from .keypoints import LARGEST_COORDINATE, Keypoints2D
from .part_labels import read_orientation, scan_photo

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
_PLAIN_BODY = "coco17"
# Formats that the number of points does not decide: another format has as many, or, for the last, few files have it.
_NAMED_ALONE = (*TWINS, "h36m17", "posetrack17", "crowdpose14", "aic14", "body25b", "panoptic19")
_BY_COUNT: dict[int, Skeleton] = {form.count: form for name, form in SKELETONS.items() if name not in _NAMED_ALONE}
_NUMBERS = {int, float}
_MAX_CONFIDENCE = 1.5  # Heat maps peak a little above 1 now and then; those are taken as 1.
# Largest score of models that classify coordinates (SimCC, RTMPose), and of percentages. A person's upper quartile must
# reach this share of the largest score, or that one number alone is wrong.
_MAX_SCORE = 100.0
_LEAST_OF_MAX = 0.15
_MAX_NORMALISED = 1.5  # MediaPipe's coordinates, as shares of the picture's size, go a little beyond it.
_POINT_SCORES = ("score", "confidence", "visibility", "likelihood", "probability", "prob", "conf", "v")
_MIN_EXTENT = 1.0  # [px]; keypoints closer together than a pixel are one point.


def keypoint_file(path: Path, photo: Path | None) -> Path:
    """Return the file itself, or the photo's file ``NAME_keypoints.json`` in a folder, as OpenPose writes them.

    Raises:
        InputError: If the folder has no file for the photo, or, without a photo, not exactly one file.
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


def read_keypoints(
    path: str | Path,
    keypoint_format: str | Path | Skeleton | None = None,
    *,
    photo: str | Path | None = None,
    size: tuple[int, int] | None = None,
) -> list[Keypoints2D]:
    """Read all people's 2D keypoints from a JSON file, in its order. People without visible keypoints are left out.

    Args:
        path: File of keypoints.
        keypoint_format: Name of the format, if the file's is missing or wrong, or a JSON file with a format of one's
            own. It counts more than names in the file; if these give another order, there is a warning.
        photo: File of the picture. If the keypoints' file holds many pictures, this one's people are read.
        size: Size (H, W) of the picture [px]; None: the photo's size, if there is a photo. If the file states another
            size, keypoints are scaled, or turned as the photo's EXIF data say, with a warning. There is also a warning
            if EXIF data turn the photo and the file states no size.

    Raises:
        InputError: If the file can't be read or understood, if nobody in it has usable keypoints, if it has several
            pictures and none is the photo, or if it states a size that does not fit the picture's.

    Examples:
        >>> from warp_partdr import choose_person, read_keypoints
        >>> people = read_keypoints("keypoints.json", photo="photo.png")
        >>> person = choose_person(people)
        >>> person.skeleton, person.points.shape
        ('coco17', (17, 2))
    """
    data, picture = read_json(path, "keypoints in JSON"), None if photo is None else Path(photo)
    return parse_keypoints(data, keypoint_format, name=str(path), photo=picture, size=size)


def parse_keypoints(
    data: Any,
    keypoint_format: str | Path | Skeleton | None = None,
    *,
    name: str = "keypoints",
    photo: Path | None = None,
    size: tuple[int, int] | None = None,
    orientation: int | None = None,
) -> list[Keypoints2D]:
    """Read all people's 2D keypoints from a file's content, as ``read_keypoints`` does.

    Args:
        data: Content of the JSON file.
        keypoint_format: Format, as for ``read_keypoints``.
        name: Name of the file in messages.
        photo: Path of the photo; its file need not exist.
        size: Size (H, W) of the picture [px], as for ``read_keypoints``.
        orientation: EXIF's orientation of the photo, 1 to 8; None: it is read from the photo's file.

    Raises:
        InputError: If it can't be understood, or nobody in it has usable keypoints.
    """
    given = None if keypoint_format is None else given_format(keypoint_format)
    entries, picture = file_people(data, name).of_photo(photo, name)
    sizes = list(dict.fromkeys(entry.size for entry in entries if entry.size is not None))
    entries, common_warnings = _of_people(entries, given)
    entries = [_whole_body(entry, given) for entry in entries]
    if picture.name is not None and photo is not None and not _is_called(picture.name, photo):
        only = shown(picture.name)[1:-1]
        common_warnings.append(f"keypoints: of {only}, the file's only picture; taken for {photo.name}")
    if not entries:
        where = name if photo is None or picture.name is None else f"{name}: {photo.name}"
        raise InputError(f"{where}: nobody in it; expected keypoints of at least one person")
    subjects = [name] if len(entries) == 1 else [f"{name}: person {index}" for index in range(len(entries))]
    batches: dict[tuple[Skeleton, int], list[int]] = {}  # people by format and numbers a keypoint, each as one array
    numbers: list[list[float]] = []
    reasons: dict[int, str] = {}
    order = _Order(given)
    own_warnings: list[tuple[str, ...]] = []
    for index, (entry, where) in enumerate(zip(entries, subjects, strict=True)):
        if entry.keypoints is None or entry.keypoints == []:  # as OpenPose writes it if it finds nobody
            reasons[index] = f"{where}: no visible keypoint; expected some with confidence above 0"
            numbers.append([])
            own_warnings.append(())
            continue
        form, warnings = order.of(entry, where)
        form, width, values = _person(entry, form, where)
        batches.setdefault((form, width), []).append(index)
        numbers.append(values)
        own_warnings.append(warnings)
    people: dict[int, Keypoints2D] = {}
    for (form, width), group in batches.items():
        table = np.array([numbers[index] for index in group]).reshape(len(group), -1, width)
        points, confidence, scaled = _checked(table, form, [subjects[index] for index in group])
        known = form.name if _is_known(form) else form
        for row, (index, reason) in enumerate(zip(group, _why_unusable(points, confidence), strict=True)):
            if reason is None:
                warnings = (
                    *common_warnings,
                    *own_warnings[index],
                    *scaled,
                    *_doubts(entries[index], form, points[row], confidence[row]),
                )
                people[index] = Keypoints2D(known, points[row], confidence[row], warnings)
            else:
                reasons[index] = f"{subjects[index]}: {reason}"
    if not people:
        raise InputError(reasons[min(reasons)])
    found = [people[index] for index in sorted(people)]
    if picture.size is None and len(sizes) == 1:
        return _in_picture(found, sizes[0], photo, size, orientation, name)
    if picture.size is None and sizes:
        listed = " and ".join(f"{each.size[1]} x {each.size[0]}" for each in sizes[:2])
        raise InputError(f"{name}: sizes {listed} of one picture; expected one")
    return _in_picture(
        found, None if picture.size is None else StatedSize(picture.size), photo, size, orientation, name
    )


def is_whole_body(annotation: Mapping[str, Any], form: Skeleton | None) -> bool:
    """True if an annotation has COCO-WholeBody's feet, face or hands, and by ``form`` its keypoints are COCO's 17."""
    keypoints, body = annotation.get("keypoints"), SKELETONS[_PLAIN_BODY]
    plain = isinstance(keypoints, list) and len(keypoints) == 3 * body.count
    return plain and (form is None or _same_rows(form, body)) and has_further(annotation)


def _whole_body(entry: PersonEntry, given: Skeleton | None) -> PersonEntry:
    """Entry of 133 points for a person of COCO-WholeBody, whose feet, face and hands are stored apart."""
    form, body = SKELETONS["wholebody133"], SKELETONS[_PLAIN_BODY]
    named = None if entry.category is None else entry.category.skeleton
    alone = entry.names is None and (named is None or _same_rows(named, body))
    fits = given is form or (given is None and alone)
    if not entry.further or not fits or not isinstance(entry.keypoints, list):
        return entry
    if len(entry.keypoints) != 3 * body.count:
        return entry
    # The body's visibilities in COCO have a scale of their own, like those of the other parts.
    rows = [entry.keypoints[k : k + 3] for k in range(0, 3 * body.count, 3)]
    labels = [row[2] for row in rows]
    if 2 in labels and all(label in (0, 1, 2) for label in labels):
        rows = [[x, y, visibility / 2] for x, y, visibility in rows]
    return replace(entry, keypoints=[*rows, *entry.further], names=None, category=None, format=form.name)


def _doubts(entry: PersonEntry, form: Skeleton, points: np.ndarray, confidence: np.ndarray) -> list[str]:
    """Warnings about one person's keypoints if their order, or their sides, seem wrong."""
    named = entry.names is not None or (entry.category is not None and entry.category.skeleton is not None)
    order = None if named else order_warning(form, points, confidence)
    doubts = [order if order is not None else mirror_warning(form, points, confidence)]
    return [doubt for doubt in doubts if doubt is not None]


def _of_people(entries: Sequence[PersonEntry], given: Skeleton | None) -> tuple[list[PersonEntry], list[str]]:
    """Entries of people, and warnings about those that were left out: animals, or unknown keypoints.

    Raises:
        InputError: If there is no entry of people.
    """
    refused: dict[str, list[str]] = {}
    kept: list[PersonEntry] = []
    for entry in entries:
        category = entry.category
        if category is None or category.refusal is None or (given is not None and not category.animals):
            kept.append(entry)
        else:
            refused.setdefault(category.refusal, []).append(category.name)
    if refused and not kept:
        raise InputError(next(iter(refused)))
    return kept, [
        f"keypoints: {len(names)} of category {shown(names[0])} left out; expected keypoints of people"
        for names in refused.values()
    ]


def _is_called(name: str, photo: Path) -> bool:
    """True if a picture's name in a file may mean a photo; a number, or an address without a file name, may."""
    return "." not in name or bool(matching_names(photo, [name]))


def _in_picture(
    people: list[Keypoints2D],
    stated: StatedSize | None,
    photo: Path | None,
    size: tuple[int, int] | None,
    orientation: int | None,
    where: str,
) -> list[Keypoints2D]:
    """Convert keypoints to pixels of the picture, if the file states another size of it."""
    has_photo = False
    if photo is not None and (orientation is None or size is None):  # else its file is not asked for
        has_photo = stated is not None or photo.is_file()  # maybe only the photo's name is known
    if orientation is None:
        orientation = read_orientation(photo) if has_photo and photo is not None else 1
    if size is None and has_photo and photo is not None:
        size = scan_photo(photo)
    if size is None:
        known = None if stated is None or stated.either else stated.size
        return [replace(person, image_size=known) for person in people]
    change = match_sizes(None if stated is None else stated.of(size, orientation), size, orientation, where)
    warning = None if change.warning is None else f"keypoints: {change.warning}"
    return [
        replace(
            person,
            warnings=(*person.warnings, *filter(None, (warning, outside_warning(person, size)))),
            image_size=size,
        )
        for person in map(change.keypoints, people)
    ]


@dataclass
class _Order:
    """Order of the points of a file's people: by a given format, by names, by the name of a format, or by their number.

    Attributes:
        given: Format that the user gave; None without.
        known: Skeleton and warning for each list of names that was read, because people share such lists.
    """

    given: Skeleton | None
    known: dict[tuple[Any, ...], tuple[Skeleton | None, str | None]] = field(default_factory=dict)

    def of(self, entry: PersonEntry, where: str) -> tuple[Skeleton | None, tuple[str, ...]]:
        """Find the skeleton of one person's rows, None if their number decides it; and warnings."""
        form, left_out = self._named(entry, where)
        if self.given is not None:
            if form is None or _same_rows(form, self.given):
                return self.given, ()
            if entry.by_name:
                return form, (f"keypoints: taken by their names in the file, not as {self.given.name}",)
            return self.given, (f"keypoints: taken as {self.given.name}; their names in the file tell another order",)
        if form is None and entry.format is not None:
            form = _named_format(entry.format, f"{where}: format")
        return form, () if left_out is None else (left_out,)

    def _named(self, entry: PersonEntry, where: str) -> tuple[Skeleton | None, str | None]:
        """Find the skeleton by names, and a warning about names that are no landmarks."""
        if entry.names is None:
            return (None, None) if entry.category is None else (entry.category.skeleton, entry.category.warning)
        if entry.names not in self.known:
            try:
                form = skeleton_of_names(entry.names, where)
            except InputError:
                if self.given is None or entry.by_name:
                    raise
                form = None
            if form is None and entry.by_name:
                raise InputError(f"{where}: keypoint names: {shown([*entry.names])}; expected such as left_shoulder")
            self.known[entry.names] = form, None if form is None else left_out_warning(entry.names, form)
        return self.known[entry.names]


def _same_rows(one: Skeleton, other: Skeleton) -> bool:
    """True if each row that has a landmark in both formats has the same one in both."""
    rows = [dict(zip(form.places, form.landmarks, strict=True)) for form in (one, other)]
    return all(rows[0][row] == rows[1][row] for row in rows[0].keys() & rows[1].keys() - {-1})


def _is_known(form: Skeleton) -> bool:
    """True if a skeleton has the joints of the format with its name, in whatever order a file lists them."""
    known = SKELETONS.get(form.name)
    return known is not None and (form.landmarks, form.marks) == (known.landmarks, known.marks)


def given_format(given: str | Path | Skeleton) -> Skeleton:
    """Return the skeleton that a user names, or describes in a JSON file.

    Raises:
        InputError: If there is no such format or file.
    """
    if isinstance(given, Skeleton) or Path(given).suffix == ".json":
        return skeleton(given)
    return _named_format(given, "keypoint format", ", or a JSON file")


def format_of(count: int, given: Skeleton | None, where: str) -> Skeleton:
    """Format for a number of keypoints a person: the given one, or else the one with this number.

    Raises:
        InputError: If no format has this number, or the given one has another number. ``where`` begins the message.
    """
    if given is None and count not in _BY_COUNT:
        counts = ", ".join(f"{known} ({form.name})" for known, form in sorted(_BY_COUNT.items()))
        raise InputError(f"{where}: {count} keypoints; expected {counts}, or a format")
    form = given or _BY_COUNT[count]
    if count != form.count:
        raise InputError(f"{where}: {count} keypoints; expected {form.count} of {form.name}")
    return form


def _named_format(text: Any, where: str, also: str = "") -> Skeleton:
    """Skeleton for a user's or a file's spelling: "BlazePose33 x,y,visibility px" is blazepose33."""
    words = str(text).lower().split()
    for candidate in ("".join(words), words[0] if words else ""):
        key = re.sub(r"[^a-z0-9]", "", candidate)
        if key in _ALIASES:
            return SKELETONS[_ALIASES[key]]
    raise InputError(f"{where}: {shown(text)}; expected one of {', '.join(SKELETONS)}{also}")


def _person(entry: PersonEntry, form: Skeleton | None, where: str) -> tuple[Skeleton, int, list[float]]:
    """Format, count of numbers a keypoint, and the numbers, one landmark's after another's; null becomes NaN."""
    values = entry.keypoints
    if isinstance(values, Mapping):
        values = _columns(values, where)
    if not isinstance(values, list):
        raise InputError(f"{where}: no list of keypoints; expected one under keypoints or pose_keypoints_2d")
    values = [_point_row(value) if isinstance(value, Mapping) else value for value in values]
    rows = _rows(values, form, where)
    if entry.scores is not None:
        rows = _scored(rows, entry.scores, where)
    if entry.numbers is not None and len(entry.numbers) == len(rows):
        rows = _numbered(rows, entry.numbers, form, where)
    form = format_of(len(rows), form, where)
    missing = [None] * len(rows[0]) if rows else []
    rows = [missing if row < 0 else rows[row] for row in form.places]
    width, values = len(rows[0]), list(chain.from_iterable(rows))
    if set(map(type, values)) <= _NUMBERS:
        with suppress(OverflowError):
            return form, width, list(map(float, values))
    names = [f"{where}: {_named(form, joint)}" for joint in range(len(form))]
    return form, width, [_number(value, names[index // width]) for index, value in enumerate(values)]


def _scored(rows: list[list[Any]], scores: Any, where: str) -> list[list[Any]]:
    """Rows [x, y, score] with scores from a separate list; a row of zeros stays missing."""
    if isinstance(scores, list) and len(scores) == 1 and isinstance(scores[0], list) and len(rows) > 1:
        scores = scores[0]
    if not isinstance(scores, list) or len(scores) != len(rows):
        raise InputError(f"{where}: keypoint_scores: not one a keypoint; expected {len(rows)}")
    scored: list[list[Any]] = []
    for row, given in zip(rows, scores, strict=True):
        score = given[0] if isinstance(given, list) and given else given
        if isinstance(score, bool):
            score = int(score)
        scored.append([*row[:2], 0 if [*row] == [0, 0, 0] else score])
    return scored


def _numbered(rows: list[list[Any]], numbers: Sequence[int], form: Skeleton | None, where: str) -> list[list[Any]]:
    """All rows of a format, from some rows with their numbers in it, which count from 0 or 1; missing ones are null."""
    most = max(numbers)
    if form is None and most >= max(_BY_COUNT):  # numbers of something else
        return rows
    if form is not None and most > form.count:
        return rows
    from_one = 0 not in numbers and (most == form.count if form else most in _BY_COUNT and len(rows) == most)
    if from_one and form is None and most + 1 in _BY_COUNT and most + 1 == SKELETONS[_PLAIN_BODY].count:
        raise InputError(f"{where}: keypoints numbered 1 to {most}, without names; expected their names or a format")
    first = 1 if from_one else 0
    if form is not None:
        count = form.count
    elif len(rows) in _BY_COUNT and most + 1 - first == len(rows):  # all are there
        count = len(rows)
    else:
        body = SKELETONS[_PLAIN_BODY].count
        count = min(known for known in _BY_COUNT if known >= max(body, most + 1 - first))
    by_number = dict(zip(numbers, rows, strict=True))
    missing = [None] * len(rows[0])
    return [by_number.get(number, missing) for number in range(first, first + count)]


def _named(form: Skeleton, joint: int) -> str:
    """Name of a joint in messages: its row in the file, and its landmark."""
    return f"keypoint {form.places[joint]} ({form.landmarks[joint]})"


def _columns(lists: Mapping[str, Any], where: str) -> list[list[Any]]:
    """Rows from Ultralytics' lists x, y and, where there are confidences, visible; (0, 0) is missing."""
    columns: list[Any] = [lists.get(name) for name in ("x", "y", "visible") if name != "visible" or name in lists]
    if not all(isinstance(column, list) for column in columns) or len(set(map(len, columns))) > 1:
        raise InputError(f"{where}: keypoints: no lists x and y, and visible, of one length; expected such")
    rows = [list(row) for row in zip(*columns, strict=True)]
    return [[0] * len(row) if row[:2] == [0, 0] else row for row in rows]


def _point_row(point: Mapping[str, Any]) -> list[Any]:
    """Row for an object {"x": ..., "y": ..., "score": ...}; x and y may be inside of "position"."""
    position = point.get("position")
    position = position if isinstance(position, Mapping) else point
    score = next((point[key] for key in _POINT_SCORES if key in point), None)
    row = [position.get("x"), position.get("y")]
    return row if score is None else [*row, score]


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
    """Convert a number to float; null becomes NaN."""
    if value is None:
        return math.nan
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{name}: {shown(value)}; expected numbers")
    try:
        return float(value)
    except OverflowError:
        return math.inf


def _checked(
    table: np.ndarray, form: Skeleton, subjects: Sequence[str]
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Points (N, J, 2) and confidences (N, J), float32, from N people's numbers (N, J, 2 or 3), and warnings.

    ``subjects`` name the people in messages.
    """

    def refuse(wrong: np.ndarray, found: Callable[[np.ndarray], str]) -> None:
        if wrong.any():
            person, joint = np.argwhere(wrong)[0].tolist()
            raise InputError(f"{subjects[person]}: {_named(form, joint)}: {found(table[person, joint])}")

    def listed(row: np.ndarray) -> str:
        return f"[{', '.join(f'{value:g}' for value in row)}]"

    points = table[..., :2]
    if table.shape[-1] == 3 and _are_plain(table):
        missing = table[..., 2:] == 0
        return np.where(missing, 0.0, points).astype(np.float32), table[..., 2].astype(np.float32), ()
    unknown = np.isnan(table).all(axis=-1)
    confidence = table[..., 2] if table.shape[-1] == 3 else np.ones(table.shape[:2])
    missing = unknown | ((confidence == 0) if table.shape[-1] == 3 else (points == 0).all(axis=-1))
    minus = (points == -1).all(axis=-1)  # as many programs write missing points
    missing |= minus & ((confidence <= 0) if table.shape[-1] == 3 else True)
    refuse(~missing & ~np.isfinite(table).all(axis=-1), lambda row: f"{listed(row)}; expected finite numbers")
    points = np.where(missing[..., None], 0.0, points)
    confidence = np.where(missing, 0.0, confidence)
    if (confidence == 3).any() and np.isin(confidence, (0, 1, 2, 3)).all():
        # OCHuman: 1 = visible, 2 = hidden by the person, 3 = hidden by others. Without a 1, 2 is visible, as in COCO.
        fully_visible = np.where((confidence == 1).any(), 1, 2)
        confidence = np.where(confidence == 0, 0.0, np.where(confidence == fully_visible, 1.0, 0.5))
    if (confidence == 2).any():
        visibility = np.isin(confidence, (0, 1, 2)).all(axis=1) & (confidence == 2).any(axis=1)
        confidence[visibility] /= 2  # COCO: 1 = labelled, but hidden
    refuse(confidence < 0, lambda row: f"confidence {row[2]:g}; expected 0 to 1")
    largest = _largest_score(confidence)
    warnings = () if largest is None else (f"keypoints: scores up to {largest:g}, not 1; divided by that",)
    confidence = confidence if largest is None else confidence / largest
    refuse(
        (confidence > _MAX_CONFIDENCE) & (confidence == confidence.max(initial=0.0)),
        lambda row: f"confidence {row[2]:g}; expected 0 to 1",
    )
    refuse(
        (np.abs(points) > LARGEST_COORDINATE).any(axis=-1),
        lambda row: f"{listed(row[:2])}; expected pixels, up to {LARGEST_COORDINATE:g}",
    )
    return points.astype(np.float32), np.minimum(confidence, 1.0).astype(np.float32), warnings


def _are_plain(table: np.ndarray) -> bool:
    """True if points (..., 3) are as most files have them: finite, in pixels, and with confidences from 0 to 1."""
    confidence = table[..., 2]
    low, high = float(confidence.min(initial=1.0)), float(confidence.max(initial=0.0))
    # Comparisons with NaN are false.
    return low >= 0.0 and high <= 1.0 and bool((np.abs(table) <= LARGEST_COORDINATE).all())


def _largest_score(confidence: np.ndarray) -> float | None:
    """Largest of people's confidences (N, J) if they have another scale than 0 to 1, else None.

    Models that classify coordinates (SimCC, such as RTMPose) give 0 to about 10. A single large number among small ones
    is an error, not such a scale.
    """
    largest = float(confidence.max(initial=0.0))
    if not _MAX_CONFIDENCE < largest <= _MAX_SCORE:
        return None
    person = confidence[int(confidence.max(axis=1).argmax())]
    return largest if np.quantile(person[person > 0], 0.75) >= _LEAST_OF_MAX * largest else None


def _why_unusable(points: np.ndarray, confidence: np.ndarray) -> list[str | None]:
    """Reason why each of N people's keypoints can't be used; None for those that can."""
    visible = confidence[..., None] > 0
    lowest = np.where(visible, points, np.inf).min(axis=1)
    highest = np.where(visible, points, -np.inf).max(axis=1)
    extents = (highest - lowest).max(axis=1)
    largest = np.maximum(-lowest, highest).max(axis=1)
    reasons: list[str | None] = [None] * len(points)
    if ((extents >= _MIN_EXTENT) & (largest > _MAX_NORMALISED)).all():
        return reasons
    for person in np.flatnonzero(extents < _MIN_EXTENT):
        x, y = lowest[person]
        reasons[person] = f"all visible keypoints in one point ({x:g}, {y:g}); expected a person"
    for person in np.flatnonzero((extents > 0) & (largest <= _MAX_NORMALISED)):
        reasons[person] = "all keypoints between 0 and 1; expected pixels, not shares of the picture's size"
    for person in np.flatnonzero(~visible.any(axis=(1, 2))):
        reasons[person] = "no visible keypoint; expected some with confidence above 0"
    return reasons
