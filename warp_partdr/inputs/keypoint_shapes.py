"""Shapes of keypoint files: whatever program wrote a file, its people become a list of ``PersonEntry``.

``keypoint_files`` lists the shapes, and reads and checks the numbers. This module finds the people in a file; names,
format and picture of their keypoints; and the people of one photo.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any

from ..body.keypoint_names import landmark_of_name
from ..errors import InputError, shown
from .annotated_sizes import StatedSize, find_size, stated_size
from .keypoint_categories import (
    NAME_KEYS,
    KeypointCategory,
    common_category,
    listed_names,
    number_of,
    read_categories,
)
from .labelled_points import labelled_people, labelled_tasks

# Keys of objects that hold a list of people, or of frames.
_LISTS = (
    *("people", "persons", "bodies", "instances", "annotations", "instance_info", "predictions"),
    *("images", "frames", "results"),
)
KEYPOINTS = (
    *("keypoints", "pose_keypoints_2d", "pose_keypoints", "keypoints_2d"),  # the third is OpenPose's before version 1.2
    *("joints", "kpts"),  # AlphaPose's ``--format cmu``
)
_SCORES = (
    *("keypoint_scores", "keypoints_scores", "keypoint_score", "keypoints_score", "kp_score", "kpt_scores"),
    *("keypoint_confidence", "keypoints_confidence", "keypoint_confidences", "keypoints_conf", "keypoint_conf"),
    *("kpts_conf", "kpts_scores", "kpt_score", "kpt_conf", "joint_scores", "joints_conf", "joints_confidence"),
    *("joints_vis", "joint_vis", "joints_visible", "keypoints_visible", "keypoint_visible", "keypoints_visibility"),
    *("keypoint_visibility", "keypoints_vis", "keypoint_vis", "kpts_vis", "visibilities", "confidences"),
)
# Keys of lists of scores that may also hold one number about the whole person.
_SCORES_OR_SCORE = ("scores", "confidence", "visibility", "visible", "conf", "vis", "score", "likelihood")
_LOOSE_NAMES = 2  # least number of landmarks in a list of names under an unknown key
_ROW_NAMES = (
    *("name", "part", "label", "class", "class_name", "keypoint", "keypoint_name", "joint", "joint_name", "body_part"),
    *("bodypart", "type", "landmark"),
)
_ROW_NUMBERS = (
    "id",
    "class_id",
    "index",
    "idx",
    "keypoint_id",
    "joint_id",
    "label",
    "class",
    "label_id",
    "category_id",
)
_WHOLE_BODY = {"foot_kpts": 6, "face_kpts": 68, "lefthand_kpts": 21, "righthand_kpts": 21}  # points, in their order
_PICTURES = (
    *("file_name", "filename", "image_name", "img_name", "imgname", "image_file", "image_path", "img_path"),
    *("image", "image_id", "img_id", "picture", "photo"),
)
_NAME_TABLES = (*NAME_KEYS, "keypoint_name2id", "keypoint_info")  # within MMPose's data about a data set
_MOST_LISTED = 6  # most pictures that a message names


@dataclass(frozen=True)
class PersonEntry:
    """One person's keypoints as a file holds them, with the file's data about them.

    Attributes:
        keypoints: Rows, a flat list, or lists by column; None or empty: nobody.
        scores: Confidences, one a keypoint, if the file has them in a separate list.
        format: The file's spelling of the format.
        names: Names of the points, one a row.
        by_name: True if each point has its name beside it, so that the order of the rows means nothing.
        category: COCO's category of the person.
        picture: Index of the picture in ``FilePeople.pictures``.
        size: Size of the picture, if it is stated beside the keypoints.
        numbers: Numbers of the points in their format, one a row, counted from 0 or 1, if not all points are given.
        loose: Lists of texts in the file; each may hold the points' names if it is as long.
        further: COCO-WholeBody's points of feet, face and hands, which continue ``keypoints``: rows of numbers.
    """

    keypoints: Any = None
    scores: Any = None
    format: Any = None
    names: tuple[Any, ...] | None = None
    by_name: bool = False
    category: KeypointCategory | None = None
    picture: int = 0
    size: StatedSize | None = None
    numbers: tuple[int, ...] | None = None
    loose: tuple[tuple[str, ...], ...] = ()
    further: tuple[list[float], ...] = ()

    def of_picture(self, index: int) -> PersonEntry:
        """Entry of the same person in a picture."""
        return self if self.picture == index else replace(self, picture=index)


@dataclass(frozen=True)
class FilePicture:
    """Picture of a file: its name, and the size (H, W) that the file states [px]; None if the file does not say."""

    name: str | None = None
    size: tuple[int, int] | None = None


@dataclass
class FilePeople:
    """People in a file, and all its pictures, also those without people."""

    people: list[PersonEntry] = field(default_factory=list)
    pictures: list[FilePicture] = field(default_factory=list)

    def picture(self, name: str | None = None, size: tuple[int, int] | None = None) -> int:
        """Index of the picture with this name, which is added if it is new; without a name, always a new picture."""
        if name is not None:
            for index, known in enumerate(self.pictures):
                if known.name == name:
                    return index
        self.pictures.append(FilePicture(name, size))
        return len(self.pictures) - 1

    def of_photo(self, photo: Path | None, where: str) -> tuple[list[PersonEntry], FilePicture]:
        """Find the people in a photo, and the photo's own entry among the pictures.

        If the file has a single picture, it is taken for the photo, whatever its name.

        Raises:
            InputError: If the file has several pictures, and none or several of them have the photo's name.
        """
        if len(self.pictures) == 1:
            return self.people, self.pictures[0]
        names = [picture.name for picture in self.pictures if picture.name is not None]
        if not names:
            raise InputError(f"{where}: people of {len(self.pictures)} pictures; expected those of one")
        if photo is None:
            several = f"people of {len(self.pictures)} pictures ({_some(names)})"
            raise InputError(f"{where}: {several}; expected those of one, or a photo that tells which")
        found = matching_names(photo, names)
        if len(found) > 1:
            raise InputError(f"{where}: {len(found)} pictures called {photo.name} ({_some(found)}); expected one")
        if not found:
            raise InputError(
                f"{where}: no keypoints of {photo.name}; expected one of its {len(names)} pictures: {_some(names)}"
            )
        index = self.picture(found[0])
        return [person for person in self.people if person.picture == index], self.pictures[index]


def file_people(data: Any, where: str) -> FilePeople:
    """Find all people in a file's content.

    Raises:
        InputError: If it has none of the known shapes. ``where`` begins the message.
    """
    if not isinstance(data, Mapping | list):
        raise InputError(f"{where}: {type(data).__name__}; expected an object or a list of keypoints")
    found = FilePeople()
    try:
        _add_everybody(found, data, where)
    except RecursionError:
        raise InputError(f"{where}: nested too deeply; expected keypoints of people") from None
    if not found.pictures:
        found.picture()
    found.people = [_with_loose_names(person) for person in found.people]
    return found


def _with_loose_names(person: PersonEntry) -> PersonEntry:
    """Entry with the first of its loose lists that has as many names as there are points, if it has no names yet."""
    categorised = person.category is not None and person.category.skeleton is not None
    if not person.loose or person.names is not None or categorised or not isinstance(person.keypoints, list):
        return person
    count = len(person.keypoints)
    nested = any(isinstance(row, list | Mapping) for row in person.keypoints)
    counts = {count} if nested else {count / 3, count / 2}
    return replace(person, names=next((names for names in person.loose if len(names) in counts), None))


def file_names(data: Mapping[str, Any], keypoints: Any, where: str) -> tuple[Any, ...] | None:
    """Names of points at the top level of a file, for people with such keypoints; None if there are none.

    Raises:
        InputError: If they are no list of names.
    """
    entry, _ = _with_statements(data, PersonEntry(), None, where)
    return _with_loose_names(replace(entry, keypoints=keypoints)).names


def _add_everybody(found: FilePeople, data: Any, where: str) -> None:
    tasks = labelled_tasks(data)
    if tasks is not None:
        for task in tasks:
            _add_labelled(found, task, where)
    elif isinstance(data, Mapping) and isinstance(data.get("annotations"), list):
        _add_coco(found, data, where)
    else:
        _add(found, data, PersonEntry(), None, where)


def matching_names(photo: Path, names: Sequence[str]) -> list[str]:
    """Names of pictures that fit a photo: one, or several that fit equally well, or none.

    The base name counts first and, if several pictures have it, the folders before it. Then the name without its ending
    counts, and last a number, because COCO's pictures have numbers as names.
    """
    wanted = _parts(str(photo))
    counted = [(_common_tail(_parts(name), wanted), name) for name in names]
    most = max((count for count, _ in counted), default=0)
    if most:
        return [name for count, name in counted if count == most]
    uploaded = [name for name in names if _parts(name)[-1].endswith(f"-{wanted[-1]}")]  # Label Studio's
    if uploaded:
        return uploaded
    stem = photo.stem.casefold()
    named = [name for name in names if stem in (_parts(name)[-1], PurePosixPath(_parts(name)[-1]).stem)]
    if named:
        return named
    digits = re.search(r"\d+$", photo.stem)
    return [name for name in names if digits and name.isdecimal() and int(name) == int(digits[0])]


def _parts(name: str) -> list[str]:
    """Folders and base name of a path, written on any operating system."""
    return [part for part in name.casefold().replace("\\", "/").split("/") if part not in ("", ".")] or [""]


def _common_tail(one: Sequence[str], other: Sequence[str]) -> int:
    count = 0
    for mine, its in zip(reversed(one), reversed(other), strict=False):
        if mine != its:
            break
        count += 1
    return count


def _some(names: Sequence[str]) -> str:
    """List a few names for a message."""
    few = ", ".join(shown(name)[1:-1] for name in names[:_MOST_LISTED])
    return few if len(names) <= _MOST_LISTED else f"{few} and {len(names) - _MOST_LISTED} more"


def _add_labelled(found: FilePeople, task: Mapping[str, Any], where: str) -> None:
    """Add the people of a picture whose points were named one by one, in LabelMe or Label Studio."""
    labelled = labelled_people(task, where)
    picture = found.picture(labelled.picture, labelled.size)
    for rows in labelled.people:
        found.people.append(PersonEntry(rows, names=labelled.names, by_name=True, picture=picture))


def _add_coco(found: FilePeople, data: Mapping[str, Any], where: str) -> None:
    """Add the people of COCO's annotations. Lists of pictures and categories may be missing."""
    images: dict[int | str | None, int] = {}
    sizes: dict[int, StatedSize] = {}  # by picture, if the size is stated under other keys than COCO's
    for image in data.get("images") or ():
        if isinstance(image, Mapping) and isinstance(image.get("file_name"), str):
            size = stated_size(image, f"{where}: {shown(image['file_name'])[1:-1]}")
            stated = find_size(image, where) if size is None else None
            index = found.picture(image["file_name"], size)
            images[number_of(image.get("id"))] = index
            if stated is not None:
                sizes[index] = stated
    categories = {number_of(key): value for key, value in read_categories(data.get("categories"), where).items()}
    only = common_category(categories.values())
    common, _ = _with_statements(data, PersonEntry(), None, where)
    for index, entry in enumerate(data["annotations"]):
        if not isinstance(entry, Mapping | list):
            raise InputError(f"{where}: person {index}: {type(entry).__name__}; expected an object or a list")
        if not isinstance(entry, Mapping) or entry.get("image_id") is None:
            _add(found, entry, replace(common, category=only), None, f"{where}: person {index}")
            continue
        image_id = number_of(entry["image_id"])
        picture = images[image_id] if image_id in images else found.picture(str(entry["image_id"]))
        category = categories.get(number_of(entry.get("category_id")), only)
        if any(key in entry for key in KEYPOINTS):  # other annotations have only a box
            known = replace(common, category=category, size=sizes.get(picture, common.size))
            person, _ = _with_statements(entry, known, None, where)
            found.people.append(_with_keypoints(entry, replace(person, picture=picture)))


def _add(found: FilePeople, data: Any, common: PersonEntry, picture: str | None, where: str) -> None:
    """Add the people of an object or a list. ``common`` is known of all of them, and ``picture`` is its name."""
    if isinstance(data, list):
        if data and not _holds_people(data):
            found.people.append(replace(common, keypoints=data, picture=_picture_index(found, picture)))
        else:
            _add_all(found, data, common, picture, where)
        return
    common, picture = _with_statements(data, common, picture, where)
    people = next((data[key] for key in _LISTS if isinstance(data.get(key), list)), None)
    rows = next((data[key] for key in KEYPOINTS if key in data), None)
    if people is None and isinstance(rows, list) and _holds_people(rows):
        _add_with_scores(found, rows, _scores(data, rows), common, picture, where)
    elif people is not None:
        _add_all(found, people, common, picture, where)
    elif any(key in data for key in KEYPOINTS):
        found.people.append(_with_keypoints(data, common.of_picture(_picture_index(found, picture))))
    elif _is_by_picture(data):
        for name, value in data.items():
            if isinstance(value, Mapping | list):
                found.picture(name)
                _add(found, value, common, name, f"{where}: {shown(name)[1:-1]}")
    else:
        raise InputError(
            f"{where}: no list of keypoints; expected one under keypoints or pose_keypoints_2d, or a file as OpenPose, "
            "COCO, MMPose, Ultralytics, AlphaPose, LabelMe or Label Studio write it"
        )


def _add_all(found: FilePeople, entries: list[Any], common: PersonEntry, picture: str | None, where: str) -> None:
    """Add the people of a list, which holds people, or pictures with people."""
    frames = any(_is_frame(entry) for entry in entries)
    if not entries:
        _picture_index(found, picture)
    for index, entry in enumerate(entries):
        subject = f"{where}: person {index}"
        if not isinstance(entry, Mapping | list):
            raise InputError(f"{subject}: {type(entry).__name__}; expected an object or a list")
        if frames:
            _add_frame(found, entry, common, picture, where)
        elif isinstance(entry, list):
            found.people.append(replace(common, keypoints=entry, picture=_picture_index(found, picture)))
        else:
            _add(found, entry, common, picture, subject)


def _add_with_scores(
    found: FilePeople, people: list[Any], scores: Any, common: PersonEntry, picture: str | None, where: str
) -> None:
    """Add the people of a list whose scores are in another list, one list a person, as torchvision writes them.

    Its scores are logits: a point with a score below 0 is missing.
    """
    before = len(found.people)
    _add_all(found, people, common, picture, where)
    if not isinstance(scores, list) or not scores:
        return
    listed = scores if isinstance(scores[0], list) else [scores]
    if len(listed) != len(people) or len(found.people) - before != len(people):
        raise InputError(f"{where}: scores of {len(listed)} people; expected those of {len(people)}")
    found.people[before:] = [
        replace(person, scores=_without_negative(each))
        for person, each in zip(found.people[before:], listed, strict=True)
    ]


def _without_negative(scores: Any) -> Any:
    if not isinstance(scores, list):
        return scores
    return [0 if type(score) in (int, float) and score < 0 else score for score in scores]


def _scores(entry: Mapping[str, Any], keypoints: Any) -> Any:
    """Scores of an object's keypoints, one each, or a list of them for each of several people; None without."""
    for key in _SCORES:
        if entry.get(key) is not None and entry[key] != []:
            return entry[key]
    for key in _SCORES_OR_SCORE:
        scores = entry.get(key)
        if not isinstance(scores, list) or not isinstance(keypoints, list) or not scores:
            continue
        of_people = _holds_people(keypoints) and len(scores) == len(keypoints)
        if isinstance(scores[0], list) or (len(scores) > 1 and not of_people):
            return scores
    return None


def _add_frame(found: FilePeople, entry: Any, common: PersonEntry, picture: str | None, where: str) -> None:
    """Add the people of one picture in a list of pictures. These are mostly a film's, which have no names."""
    if isinstance(entry, Mapping):
        common, picture = _with_statements(entry, common, None, where)
        if isinstance(entry.get("instances"), Mapping | str | int | float):
            raise InputError(f"{where}: instances: {type(entry['instances']).__name__}; expected a list of people")
        people = next((entry[key] for key in _LISTS if isinstance(entry.get(key), list)), entry)
    else:
        people = entry
    index = found.picture(picture)
    inner = FilePeople()
    if people:
        _add(inner, people, common, None, where)
    found.people.extend(replace(person, picture=index) for person in inner.people)


def _picture_index(found: FilePeople, picture: str | None) -> int:
    """Index of a picture by its name. All people whose picture has no name share one picture."""
    if picture is not None:
        return found.picture(picture)
    for index, known in enumerate(found.pictures):
        if known.name is None:
            return index
    return found.picture()


def _with_statements(
    entry: Mapping[str, Any], common: PersonEntry, picture: str | None, where: str
) -> tuple[PersonEntry, str | None]:
    """Copy of ``common`` with the format, names and size that an object states, and the name of the picture.

    Anything that the object does not state stays as it is in ``common`` and ``picture``.
    """
    meta = entry.get("meta_info")  # MMPose's
    meta = meta if isinstance(meta, Mapping) else {}
    form = entry.get("format", meta.get("dataset_name"))
    names = next((entry[key] for key in NAME_KEYS if entry.get(key)), None)
    for key in ("meta_info", "dataset_meta", "dataset_info", "metainfo", "info"):
        inner = entry.get(key)
        if names is None and isinstance(inner, Mapping):
            tables = (inner.get(table) for table in _NAME_TABLES)
            names = next((table for table in tables if isinstance(table, list | Mapping) and table), None)
            loose = [] if names is not None else _loose_names(inner)
            common = replace(common, loose=(*loose, *common.loose))
    if names is not None:
        common = replace(common, names=listed_names(names, where))
    loose = _loose_names(entry)
    size = find_size(entry, where)
    if loose:
        common = replace(common, loose=(*loose, *common.loose))
    if size is not None:
        common = replace(common, size=size)
    if form is not None:
        common = replace(common, format=form)
    for key in _PICTURES:
        value = entry.get(key)
        value = number_of(value) if type(value) is float else value
        if (isinstance(value, str) and value) or type(value) is int:
            return common, str(value)
    return common, picture


def _loose_names(entry: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Lists of texts in an object, under any key, if at least half of each list are names of landmarks."""
    found: list[tuple[str, ...]] = []
    for value in entry.values():
        if isinstance(value, list) and value and all(isinstance(name, str) for name in value):
            known = sum(landmark_of_name(name, value) is not None for name in value)
            if known >= _LOOSE_NAMES and 2 * known >= len(value):
                found.append(tuple(value))
    return found


def _with_keypoints(entry: Mapping[str, Any], common: PersonEntry) -> PersonEntry:
    """Copy of ``common`` with an object's keypoints and scores; points that are named one by one become named rows."""
    values = next(entry[key] for key in KEYPOINTS if key in entry)
    scores = _scores(entry, values)
    if isinstance(values, Mapping) and values and not {"x", "y"} & set(values):
        return replace(common, keypoints=list(values.values()), names=tuple(values), by_name=True)
    if isinstance(values, list) and values and all(isinstance(row, Mapping) for row in values):
        names = _row_names(values)
        if names is not None:
            return replace(common, keypoints=values, scores=scores, names=names, by_name=True)
        return replace(common, keypoints=values, scores=scores, numbers=_row_numbers(values))
    labels = entry.get("labels")  # of transformers' ViTPose
    numbers = None
    if isinstance(labels, list) and isinstance(values, list) and len(labels) == len(values):
        numbers = _distinct(labels)
    return replace(common, keypoints=values, scores=scores, numbers=numbers, further=_further(entry))


def _row_names(rows: Sequence[Mapping[str, Any]]) -> tuple[str, ...] | None:
    """Names of points that are each an object, under the key with most names of landmarks; None if they have none."""
    best: tuple[int, tuple[str, ...]] | None = None
    for key in dict.fromkeys((*_ROW_NAMES, *(key for row in rows for key in row))):
        texts = [row.get(key) for row in rows]
        names = [text for text in texts if isinstance(text, str) and text]
        known = sum(landmark_of_name(name, names) is not None for name in names)
        usual = key in ("name", "part", "label") and len(names) == len(rows)
        if (known or usual) and (best is None or known > best[0]):
            best = known, tuple(text if isinstance(text, str) and text else "without a name" for text in texts)
    return None if best is None else best[1]


def _row_numbers(rows: Sequence[Mapping[str, Any]]) -> tuple[int, ...] | None:
    """Numbers of points that are each an object; None if they have none, or one number twice."""
    found = (_distinct([row.get(key) for row in rows]) for key in _ROW_NUMBERS)
    return next((numbers for numbers in found if numbers is not None), None)


def _distinct(numbers: list[Any]) -> tuple[int, ...] | None:
    """Numbers as ints, if all are whole, not negative and different; else None."""
    whole = [number_of(number) for number in numbers]
    if not all(isinstance(number, int) and number >= 0 for number in whole) or len({*whole}) < len(whole):
        return None
    return tuple(number for number in whole if isinstance(number, int))


def has_further(entry: Mapping[str, Any]) -> bool:
    """True if an annotation has any of COCO-WholeBody's points of feet, face and hands."""
    return any(isinstance(entry.get(key), list) and entry[key] for key in _WHOLE_BODY)


def _further(entry: Mapping[str, Any]) -> tuple[list[float], ...]:
    """COCO-WholeBody's rows of feet, face and hands, 0 where a part is missing; none if the entry has none of them."""
    if not has_further(entry):
        return ()
    rows: list[list[float]] = []
    for key, count in _WHOLE_BODY.items():
        given = entry.get(key) or [0] * (3 * count)
        numeric = isinstance(given, list) and all(type(value) in (int, float) for value in given)
        if not numeric or len(given) != 3 * count:
            raise InputError(
                f"{key}: {shown(given)}; expected {3 * count} numbers, x, y and visibility of {count} points"
            )
        labels = {*given[2::3]}
        share = 0.5 if 2 in labels and labels <= {0, 1, 2} else 1.0
        rows += [[given[k], given[k + 1], given[k + 2] * share] for k in range(0, 3 * count, 3)]
    return tuple(rows)


def _is_by_picture(data: Mapping[str, Any]) -> bool:
    """True if an object has one entry a picture, as AlphaPose's ``--format open`` has."""
    pictures = [value for value in data.values() if isinstance(value, Mapping | list)]
    return bool(pictures) and all(
        any(key in value for key in (*_LISTS, *KEYPOINTS))
        if isinstance(value, Mapping)
        else not value or isinstance(value[0], Mapping | list)
        for value in pictures
    )


def _is_frame(entry: Any) -> bool:
    if isinstance(entry, Mapping):
        return "instances" in entry or any(isinstance(entry.get(key), list) for key in _LISTS)
    return isinstance(entry, list) and any(isinstance(one, Mapping) and not is_point(one) for one in entry)


def _holds_people(values: Any) -> bool:
    """True if this is a list of people, not of one person's rows or numbers."""
    if not isinstance(values, list) or not values:
        return False
    first = values[0]
    if isinstance(first, Mapping):
        return not is_point(first)
    return isinstance(first, list) and (len(first) > 3 or any(isinstance(value, list | Mapping) for value in first))


def is_point(entry: Mapping[str, Any]) -> bool:
    """True if an object is one keypoint: TensorFlow.js and others write {"name": ..., "x": ..., "y": ..., ...}."""
    return "position" in entry or ("x" in entry and "y" in entry and not any(key in entry for key in KEYPOINTS))
