"""People cut out of pictures for fits, with what their rows say of them already. What fails is an error in its row."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np

from ..body.skeletons import Skeleton, skeleton
from ..cameras import Perspective, UsualLens
from ..errors import InputError
from ..inputs.cut_out import cut_out_people
from ..inputs.cut_people import CutPeople, CutPerson, batch_people
from ..inputs.evidence import PicturePerson
from ..inputs.observation import LABEL_SIZE
from ..inputs.own_pixels import Mask
from ..inputs.person import check_inside
from ..networks.detection.person import SKELETON
from .outages import PassingError, is_passing
from .rows import FILE_WARNINGS, UNREAD, PeopleRows, Row
from .sources import KnownPerson, PictureSource, SourcePicture

CameraOf = Callable[[str, tuple[int, int]], Perspective | None]
Read = SourcePicture | Exception  # a picture, or why it can't be read
Held = tuple[str, Read]  # with its name

Result = TypeVar("Result")
Attempted = list[tuple[slice, Sequence[Result] | Exception]]

FAULTS = (ValueError, RuntimeError, MemoryError)  # of single pictures; torch's and Warp's, too


def no_camera(name: str, size: tuple[int, int]) -> None:
    """Return None: the camera of no picture is known, and none is assumed."""


def usual_camera(name: str, size: tuple[int, int]) -> UsualLens:
    """Camera that is assumed for a picture of (H, W) pixels, of which none is known."""
    return _usual_lens(size)


_usual_lens = lru_cache(maxsize=1024)(UsualLens.of_size)  # pictures share sizes


@dataclass(frozen=True)
class Cut:
    """People cut out of some pictures.

    Attributes:
        pictures: Names of the pictures.
        rows: Rows of the people.
        people: Groups of people of the same kind, with their rows' indices.
    """

    pictures: tuple[str, ...]
    rows: PeopleRows
    people: list[tuple[np.ndarray, CutPeople]]


@dataclass(frozen=True)
class Cutter:
    """Cuts people out of pictures.

    Attributes:
        camera: The camera of a picture by its name and (H, W), known or assumed; of all pictures or of none.
        skeleton: Format of keypoints in rows; those of other formats lose what it has not.
        label_size: Side [px] at which labels are kept, of people without masks of instances.
        person: Number of the person in each picture who alone is cut out; None: everyone is.
    """

    camera: CameraOf = usual_camera
    skeleton: str | Skeleton = SKELETON
    label_size: int = LABEL_SIZE
    person: int | None = None

    def cut(self, held: Sequence[Held], found: Mapping[int, Read]) -> Cut:
        """Cut people out; ``found`` are pictures with the people who were found in them, by their place."""
        rows: list[Row] = []
        people: list[tuple[int, PicturePerson]] = []
        sources = [found.get(index, seen) for index, (_, seen) in enumerate(held)]
        for index, ((name, seen), known) in enumerate(zip(held, sources, strict=True)):
            row: Row = {"picture": name}
            if isinstance(seen, SourcePicture):
                row |= dict(zip(("height", "width"), seen.size, strict=True))
                if seen.warnings:
                    row[FILE_WARNINGS] = list(seen.warnings)
            if isinstance(known, Exception):
                rows.append(row | _fault(known))
                continue
            assert known.people is not None
            count = len(known.people) + len(known.faults)
            if not count:
                rows.append(row | {"people": 0})
                continue
            try:
                camera = self.camera(name, (row["height"], row["width"]))
            except FAULTS as error:
                rows.append(row | _fault(error))
                continue
            row["people"] = count
            for number, person in enumerate(known.people):
                told = [*row.get(FILE_WARNINGS, ()), *person.warnings]
                rows.append(row | {"person": number, FILE_WARNINGS: told} | _describe(person, self.skeleton))
                if self.person not in (None, number):
                    continue
                try:
                    if index not in found:
                        check_inside(person.keypoints, (row["height"], row["width"]))
                    people.append((len(rows) - 1, _picture_person(known, number, camera)))
                except FAULTS as error:
                    rows[-1] |= _fault(error)
            for number, fault in enumerate(known.faults, start=len(known.people)):
                wrong = {"person": number, "annotation": fault.annotation, "error": one_line(InputError(fault.error))}
                rows.append(row | wrong)
        cut: list[tuple[int, CutPerson]] = []
        for own, some in attempt(self._cut_out, [person for _, person in people]):
            for (number, _), each in zip(people[own], [some] if isinstance(some, Exception) else some, strict=True):
                if isinstance(each, Exception):
                    rows[number] |= _fault(each)
                else:
                    cut.append((number, each))
        numbers = np.array([number for number, _ in cut])
        groups = batch_people([person for _, person in cut])
        return Cut(
            tuple(name for name, _ in held),
            PeopleRows.of(rows),
            [(numbers[row_indices], people) for row_indices, people in groups],
        )

    def _cut_out(self, people: Sequence[PicturePerson]) -> list[CutPerson | InputError]:
        """Cut people out: those of masks at full size on the device that holds these, the others on the CPU."""
        found: dict[int, CutPerson | InputError] = {}
        masks = {place: each.pixels for place, each in enumerate(people) if isinstance(each.pixels, Mask)}
        if masks:
            device = next(iter(masks.values())).owners.device
            found |= zip(masks, cut_out_people([people[place] for place in masks], device), strict=True)
        rest = [place for place in range(len(people)) if place not in masks]
        found |= zip(rest, cut_out_people([people[place] for place in rest], "cpu", self.label_size), strict=True)
        return [found[place] for place in range(len(people))]


def _picture_person(known: SourcePicture, number: int, camera: Perspective | None) -> PicturePerson:
    """One of the people of a picture, with its labels or masks."""
    assert known.people is not None
    keypoints = [each.keypoints for each in known.people]
    if known.parts is not None:
        others = [*keypoints[:number], *keypoints[number + 1 :]]
        return PicturePerson(keypoints[number], known.parts, others, camera)
    mask = None if known.owners is None else Mask(known.owners, number + 1)
    return PicturePerson(keypoints[number], mask, camera=camera)


def read_picture(source: PictureSource, name: str) -> Read:
    """Read a picture; of one that can't be read, why."""
    try:
        return source.read(name)
    except (InputError, OSError, ValueError, MemoryError) as error:
        return PassingError(one_line(error)) if is_passing(error) else error


def _fault(error: Exception) -> Row:
    """Text that a row has for an error."""
    return {"error": one_line(error)} | ({UNREAD: True} if is_passing(error) else {})


def one_line(error: Exception) -> str:
    """An error as one line of at most 300 characters."""
    text = " ".join(str(error).split()) or type(error).__name__
    return (text if isinstance(error, InputError) else f"{type(error).__name__}: {text}")[:300]


def _describe(person: KnownPerson, form: str | Skeleton) -> dict[str, Any]:
    given = person.keypoints
    keypoints = np.column_stack([given.points, given.confidence])
    own, landmarks = given.format.landmarks, skeleton(form).landmarks
    if own != landmarks:
        missing = np.zeros(3, dtype=np.float32)
        order = [own.index(name) if name in own else None for name in landmarks]
        keypoints = np.stack([missing if index is None else keypoints[index] for index in order])
    return {
        "annotation": person.annotation,
        "score": person.score,
        "box": np.array(person.box),
        "keypoints": keypoints,
        "warnings": [],
    }


def attempt(work: Callable[[Any], Sequence[Result]], items: Sequence[Any], start: int = 0) -> Attempted[Result]:
    """Results of a batch; if it fails, of its halves, so that in the end only those that are at fault have an error.

    With each, where in the batch it is, whose first item has the number ``start``.
    """
    if not items:
        return []
    own = slice(start, start + len(items))
    try:
        return [(own, work(items))]
    except FAULTS as error:
        if len(items) == 1:
            return [(own, error)]
    half = len(items) // 2
    return [*attempt(work, items[:half], start), *attempt(work, items[half:], start + half)]
