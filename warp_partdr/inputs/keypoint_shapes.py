"""Shapes of keypoint files: whatever program wrote a file, its people become a list of ``PersonEntry``.

``keypoint_files`` lists the shapes. Here it is found where in a file the people are, what it says of their keypoints'
names, format and picture, and which of them are in a photo. Numbers are looked at there.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any

from ..errors import InputError, shown
from .annotated_sizes import stated_size
from .keypoint_categories import KeypointCategory, read_categories
from .labelled_points import labelled_people, labelled_tasks

# Keys of objects that hold a list of people, or of frames.
_LISTS = (
    *("people", "persons", "bodies", "instances", "annotations", "instance_info", "predictions"),
    *("images", "frames", "results"),
)
KEYPOINTS = (
    *("keypoints", "pose_keypoints_2d", "pose_keypoints", "keypoints_2d"),  # the third: OpenPose's before version 1.2
    *("joints", "kpts"),  # AlphaPose's ``--format cmu``
)
_SCORES = ("keypoint_scores", "keypoints_scores", "keypoint_score", "kp_score", "scores")
_NAMES = ("keypoint_names", "keypoints_names", "keypoint_name", "joint_names", "landmark_names", "bodyparts")
_PICTURES = (
    *("file_name", "filename", "image_name", "img_name", "imgname", "image_file", "image_path", "img_path"),
    *("image", "image_id", "img_id", "picture", "photo"),
)
_MOST_LISTED = 6  # pictures that a message names


@dataclass(frozen=True)
class PersonEntry:
    """One person's keypoints as a file holds them, and what it says about them.

    Attributes:
        keypoints: Rows, a flat list, or lists by column; None or empty: nobody.
        scores: Confidences, one a keypoint, where they stand apart.
        format: The file's spelling of the format.
        names: Names of the points, one a row.
        by_name: True if each point was named by itself, so that the rows' order is made here.
        category: COCO's.
        picture: Index of the picture in ``FilePeople.pictures``.
    """

    keypoints: Any = None
    scores: Any = None
    format: Any = None
    names: tuple[Any, ...] | None = None
    by_name: bool = False
    category: KeypointCategory | None = None
    picture: int = 0


@dataclass(frozen=True)
class FilePicture:
    """One picture of a file: its name, and the (H, W) that the file states; None where the file does not say."""

    name: str | None = None
    size: tuple[int, int] | None = None


@dataclass
class FilePeople:
    """Everybody in a file, and all its pictures, also those in which nobody is."""

    people: list[PersonEntry] = field(default_factory=list)
    pictures: list[FilePicture] = field(default_factory=list)

    def picture(self, name: str | None = None, size: tuple[int, int] | None = None) -> int:
        """Index of the picture of this name, which is added if it is new; without a name, always a new one."""
        if name is not None:
            for index, known in enumerate(self.pictures):
                if known.name == name:
                    return index
        self.pictures.append(FilePicture(name, size))
        return len(self.pictures) - 1

    def of_photo(self, photo: Path | None, where: str) -> tuple[list[PersonEntry], FilePicture]:
        """People in a photo, and the photo's own entry among the pictures.

        A file of one picture is taken to be of the photo, whatever its name.

        Raises:
            InputError: If the file has several pictures, and none or several of them are called like the photo.
        """
        if len(self.pictures) == 1:
            return self.people, self.pictures[0]
        names = [picture.name for picture in self.pictures if picture.name is not None]
        if not names:
            raise InputError(f"{where}: people of {len(self.pictures)} pictures; expected those of one")
        if photo is None:
            told = f"people of {len(self.pictures)} pictures ({_some(names)})"
            raise InputError(f"{where}: {told}; expected those of one, or a photo that tells which")
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
    """Find everybody in a file's content.

    Raises:
        InputError: If it has another shape than those known; ``where`` begins it.
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
    return found


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
    """Names of pictures that mean a photo: one, or several that mean it equally well, or none.

    The base name counts first, and where several have it, the folders before it; then the name without its ending; then
    a number, which COCO's pictures have for a name.
    """
    wanted = _parts(str(photo))
    alike = [(_common_tail(_parts(name), wanted), name) for name in names]
    most = max((count for count, _ in alike), default=0)
    if most:
        return [name for count, name in alike if count == most]
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
    """Folders and base name of a path of any system."""
    return [part for part in name.casefold().replace("\\", "/").split("/") if part not in ("", ".")] or [""]


def _common_tail(one: Sequence[str], other: Sequence[str]) -> int:
    count = 0
    for mine, its in zip(reversed(one), reversed(other), strict=False):
        if mine != its:
            break
        count += 1
    return count


def _some(names: Sequence[str]) -> str:
    """A few names for a message."""
    few = ", ".join(shown(name)[1:-1] for name in names[:_MOST_LISTED])
    return few if len(names) <= _MOST_LISTED else f"{few} and {len(names) - _MOST_LISTED} more"


def _add_labelled(found: FilePeople, task: Mapping[str, Any], where: str) -> None:
    """Add the people of a picture whose points an annotation tool labelled one by one: LabelMe, Label Studio."""
    labelled = labelled_people(task, where)
    picture = found.picture(labelled.picture, labelled.size)
    for rows in labelled.people:
        found.people.append(PersonEntry(rows, names=labelled.names, by_name=True, picture=picture))


def _add_coco(found: FilePeople, data: Mapping[str, Any], where: str) -> None:
    """Add the people of COCO's annotations, whose pictures and categories may be missing."""
    images: dict[str, int] = {}
    for image in data.get("images") or ():
        if isinstance(image, Mapping) and isinstance(image.get("file_name"), str):
            size = stated_size(image, f"{where}: {shown(image['file_name'])[1:-1]}")
            images[str(image.get("id"))] = found.picture(image["file_name"], size)
    categories = {str(key): value for key, value in read_categories(data.get("categories"), where).items()}
    only = next(iter(categories.values())) if len(categories) == 1 else None
    common, _ = _said(data, PersonEntry(), None, where)
    for index, entry in enumerate(data["annotations"]):
        if not isinstance(entry, Mapping | list):
            raise InputError(f"{where}: person {index}: {type(entry).__name__}; expected an object or a list")
        if not isinstance(entry, Mapping) or entry.get("image_id") is None:
            _add(found, entry, replace(common, category=only), None, f"{where}: person {index}")
            continue
        image_id = str(entry["image_id"])
        picture = images[image_id] if image_id in images else found.picture(image_id)
        category = categories.get(str(entry.get("category_id")), only)
        if any(key in entry for key in KEYPOINTS):  # others have a box alone
            person, _ = _said(entry, replace(common, category=category), None, where)
            found.people.append(_with_keypoints(entry, replace(person, picture=picture)))


def _add(found: FilePeople, data: Any, common: PersonEntry, picture: str | None, where: str) -> None:
    """Add the people of an object or a list, of which ``common`` is known, with the name of their picture."""
    if isinstance(data, list):
        if data and not _holds_people(data):
            found.people.append(replace(common, keypoints=data, picture=_place(found, picture)))
        else:
            _add_all(found, data, common, picture, where)
        return
    common, picture = _said(data, common, picture, where)
    people = next((data[key] for key in _LISTS if isinstance(data.get(key), list)), None)
    if people is None and _holds_people(data.get("keypoints")):
        people = data["keypoints"]
    if people is not None:
        _add_all(found, people, common, picture, where)
    elif any(key in data for key in KEYPOINTS):
        found.people.append(_with_keypoints(data, replace(common, picture=_place(found, picture))))
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
    """Add the people of a list: of people, or of pictures with people."""
    frames = any(_is_frame(entry) for entry in entries)
    if not entries:
        _place(found, picture)
    for index, entry in enumerate(entries):
        place = f"{where}: person {index}"
        if not isinstance(entry, Mapping | list):
            raise InputError(f"{place}: {type(entry).__name__}; expected an object or a list")
        if frames:
            _add_frame(found, entry, common, picture, where)
        elif isinstance(entry, list):
            found.people.append(replace(common, keypoints=entry, picture=_place(found, picture)))
        else:
            _add(found, entry, common, picture, place)


def _add_frame(found: FilePeople, entry: Any, common: PersonEntry, picture: str | None, where: str) -> None:
    """Add the people of one picture of a list of pictures, of films above all, whose pictures have no names."""
    if isinstance(entry, Mapping):
        common, picture = _said(entry, common, None, where)
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


def _place(found: FilePeople, picture: str | None) -> int:
    """Index of a picture by its name; without a name, of the one that all without a name share."""
    if picture is not None:
        return found.picture(picture)
    for index, known in enumerate(found.pictures):
        if known.name is None:
            return index
    return found.picture()


def _said(
    entry: Mapping[str, Any], common: PersonEntry, picture: str | None, where: str
) -> tuple[PersonEntry, str | None]:
    """Format and names of the keypoints, and name of the picture, as an object says or, if it does not, as known."""
    meta = entry.get("meta_info")  # MMPose's
    meta = meta if isinstance(meta, Mapping) else {}
    said = entry.get("format", meta.get("dataset_name"))
    names = next((entry[key] for key in _NAMES if entry.get(key)), None)
    if names is None:
        names = meta.get("keypoint_id2name") or meta.get("keypoint_name2id")
    if names is not None:
        common = replace(common, names=_listed_names(names, where))
    if said is not None:
        common = replace(common, format=said)
    for key in _PICTURES:
        value = entry.get(key)
        if (isinstance(value, str) and value) or type(value) is int:
            return common, str(value)
    return common, picture


def _listed_names(names: Any, where: str) -> tuple[Any, ...]:
    """Names in the order of the rows, from a list, or from MMPose's tables by number or of numbers."""
    if isinstance(names, list):
        return tuple(names)
    if isinstance(names, Mapping):
        numbered = names if all(str(key).isdecimal() for key in names) else {str(n): name for name, n in names.items()}
        if all(str(key).isdecimal() for key in numbered):
            return tuple(numbered[key] for key in sorted(numbered, key=int))
    raise InputError(f"{where}: keypoint names: {shown(names)}; expected a list of names")


def _with_keypoints(entry: Mapping[str, Any], common: PersonEntry) -> PersonEntry:
    """An object's keypoints and scores; those that it names one by one become rows with names."""
    values = next(entry[key] for key in KEYPOINTS if key in entry)
    scores = next((entry[key] for key in _SCORES if key in entry), None)
    if isinstance(values, Mapping) and values and not {"x", "y"} & set(values):
        return replace(common, keypoints=list(values.values()), names=tuple(values), by_name=True)
    if isinstance(values, list) and values and all(isinstance(row, Mapping) for row in values):
        names = [next((row[key] for key in ("name", "part", "label") if key in row), None) for row in values]
        known = all(isinstance(name, str) for name in names)
        return replace(common, keypoints=values, names=tuple(names) if known else common.names, by_name=known)
    return replace(common, keypoints=values, scores=scores)


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
    return "position" in entry or ("x" in entry and "y" in entry)
