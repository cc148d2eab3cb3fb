"""Points that were set and named one by one in an annotation tool: files of LabelMe and Label Studio.

LabelMe writes one file a picture. It has ``shapes`` of the type "point", each with a ``label``, and ``group_id`` tells
people apart. Label Studio writes a list of tasks. Each is a picture with ``annotations``, whose ``result`` holds
``value``s with ``keypointlabels`` and positions in percent of the picture; ``parentID`` is the region that a point
belongs to.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from ..errors import InputError, shown
from .annotated_sizes import stated_size

_LABELS = "keypointlabels"  # Label Studio's


@dataclass(frozen=True)
class LabelledPoints:
    """People of one picture.

    Attributes:
        picture: Name of the picture; None if the file states none.
        size: Size (H, W) of the picture [px]; None if the file states none.
        names: Names of all N points.
        people: Each person's N rows [x, y] in pixels, None where the person has no such point.
    """

    picture: str | None
    size: tuple[int, int] | None
    names: tuple[str, ...]
    people: list[list[list[float] | None]]


def labelled_tasks(data: Any) -> list[Mapping[str, Any]] | None:
    """Pictures of a file that LabelMe or Label Studio wrote; None if neither did."""
    entries = data if isinstance(data, list) else [data]
    if not entries or not all(
        isinstance(entry, Mapping) and (_is_labelme(entry) or _is_task(entry)) for entry in entries
    ):
        return None
    return entries


def labelled_people(task: Mapping[str, Any], where: str) -> LabelledPoints:
    """Read one picture's points.

    Raises:
        InputError: If points are faulty, or nothing says which people they belong to.
    """
    if _is_labelme(task):
        picture = task.get("imagePath")
        size = stated_size(task, where, "imageWidth", "imageHeight")
        return _grouped(list(_labelme_points(task, where)), picture if isinstance(picture, str) else None, size, where)
    results = _results(task, where)
    size = next((_original_size(result, where) for result in results), None)
    points = [_studio_point(result, where) for result in results]
    return _grouped(points, _studio_picture(task), size, where)


@dataclass(frozen=True)
class _Point:
    label: str
    position: list[float]  # [x, y] [px]
    person: Any  # key that the points of one person share


def _grouped(points: list[_Point], picture: str | None, size: tuple[int, int] | None, where: str) -> LabelledPoints:
    """Group points by person. Spellings of a name that differ only in case and punctuation mean the same point."""
    names: dict[str, str] = {}
    people: dict[Any, dict[str, list[float]]] = {}
    for point in points:
        key = re.sub(r"[^a-z0-9]", "", point.label.casefold()) or point.label
        names.setdefault(key, point.label)
        person = people.setdefault(point.person, {})
        if key in person:
            raise InputError(
                f"{where}: {shown(point.label)} twice in one person; expected a group_id (LabelMe) or a region "
                "(Label Studio) for each person"
            )
        person[key] = point.position
    rows = [[person.get(key) for key in names] for person in people.values()]
    return LabelledPoints(picture, size, tuple(names.values()), rows)


def _is_labelme(entry: Mapping[str, Any]) -> bool:
    return isinstance(entry.get("shapes"), list)


def _labelme_points(task: Mapping[str, Any], where: str) -> Iterator[_Point]:
    types: list[str] = []
    for index, shape in enumerate(task["shapes"]):
        subject = f"{where}: shapes: {index}"
        points = shape.get("points") if isinstance(shape, Mapping) else None
        if not isinstance(shape, Mapping) or not isinstance(points, list):
            raise InputError(f"{subject}: {shown(shape)}; expected a shape with its points")
        shape_type = shape.get("shape_type") or ("point" if len(points) == 1 else "polygon")
        types.append(str(shape_type))
        if shape_type != "point":
            continue
        label, group = shape.get("label"), shape.get("group_id")
        if not isinstance(label, str) or len(points) != 1 or not isinstance(group, int | str | None):
            raise InputError(f"{subject}: {shown(shape)}; expected a label, one point [x, y] and a group_id or null")
        yield _Point(label, _pair(points[0], f"{subject} ({label})"), group)
    if types and "point" not in types:
        listed = ", ".join(dict.fromkeys(types))
        raise InputError(
            f"{where}: shapes: {listed}; expected points, each labelled as a keypoint, such as left_shoulder"
        )


def _pair(values: Any, where: str) -> list[float]:
    if not isinstance(values, list) or len(values) != 2 or not all(type(value) in (int, float) for value in values):
        raise InputError(f"{where}: {shown(values)}; expected [x, y]")
    return values


def _is_task(entry: Mapping[str, Any]) -> bool:
    return bool(_annotations(entry)) or bool(_short_results(entry))


def _annotations(task: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Label Studio's annotations of a task, or its predictions if it has no annotations."""
    for key in ("annotations", "completions", "predictions"):
        given = task.get(key)
        if isinstance(given, list):
            found = [each for each in given if isinstance(each, Mapping) and isinstance(each.get("result"), list)]
            if found:
                return found
    return [task] if isinstance(task.get("result"), list) else []


def _short_results(task: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Results in the short export format, JSON-MIN, in which each control of the tool has its own list."""
    lists = [value for value in task.values() if isinstance(value, list)]
    # Rows of numbers are lists: to ask first for their type takes a tenth of the time of asking if they are mappings.
    objects = (entry for each in lists for entry in each if type(entry) is not list)
    return [entry for entry in objects if isinstance(entry, Mapping) and _LABELS in entry]


def _results(task: Mapping[str, Any], where: str) -> list[Mapping[str, Any]]:
    """Results with keypoints; their values are moved to the top level, as in the short format."""
    known: list[list[Mapping[str, Any]]] = []
    for annotation in _annotations(task):
        results: list[Mapping[str, Any]] = [
            {**result, **result["value"]}
            for result in annotation["result"]
            if isinstance(result, Mapping) and isinstance(result.get("value"), Mapping) and _LABELS in result["value"]
        ]
        if results and not annotation.get("was_cancelled"):
            known.append(results)
    if len(known) > 1:
        raise InputError(f"{where}: {len(known)} annotations of one picture; expected those of one annotator")
    return known[0] if known else _short_results(task)


def _studio_point(result: Mapping[str, Any], where: str) -> _Point:
    labels = result[_LABELS]
    if not isinstance(labels, list) or len(labels) != 1 or not isinstance(labels[0], str):
        raise InputError(f"{where}: {_LABELS}: {shown(labels)}; expected one name")
    if result.get("image_rotation") not in (None, 0):
        raise InputError(f"{where}: image_rotation: {shown(result['image_rotation'])}; expected an upright picture, 0")
    size = _original_size(result, where)
    x, y = _pair([result.get("x"), result.get("y")], f"{where}: {labels[0]}")
    if size is None:
        raise InputError(f"{where}: original_width: missing; expected the picture's size, as x and y are in percent")
    parent = result.get("parentID")
    return _Point(labels[0], [x / 100 * size[1], y / 100 * size[0]], parent if isinstance(parent, str) else None)


def _original_size(result: Mapping[str, Any], where: str) -> tuple[int, int] | None:
    return stated_size(result, where, "original_width", "original_height")


def _studio_picture(task: Mapping[str, Any]) -> str | None:
    """Name of a task's picture, from the address at which it was stored."""
    data = task.get("data")
    given = list(data.values()) if isinstance(data, Mapping) else [task.get("image")]
    address = next((value for value in given if isinstance(value, str) and value), task.get("file_upload"))
    if not isinstance(address, str):
        return None
    return address.rpartition("?d=")[2].partition("?")[0]
