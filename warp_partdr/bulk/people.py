"""People of pictures as rows: found, cut out, and fitted in batches. What fails is a row with its error."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any, Literal, TypeVar

import numpy as np

from ..body.skeletons import skeleton
from ..cameras import Perspective
from ..clothing.model import DetailedModel
from ..detection import MIN_SCORE
from ..detection.masks import instance_map
from ..detection.people import find_people_in
from ..detection.person import SKELETON
from ..errors import InputError
from ..fit.cut_people import CutPeople, CutPerson, Kind, stack_alike
from ..fit.mesh_stage import refine_meshes
from ..fit.options import FitOptions
from ..fit.photo import person_evidence
from ..fit.together import fit_together
from ..inputs.evidence import weigh_evidence
from ..inputs.observation import crop_evidence
from ..inputs.person import check_inside
from ..interop.torch_threads import one_torch_thread
from ..kernels.launch import get_num_threads
from ..network.label_network import LabelNetwork
from .rows import PeopleRows, Row, RowPart, describe_bodies, error_part
from .sources import KnownPerson, SourcePicture

BulkQuality = Literal["network", "fast", "mesh"]
CameraOf = Callable[[str, tuple[int, int]], Perspective | None]


def no_camera(name: str, size: tuple[int, int]) -> None:
    """None: the camera of no picture is known."""


Read = SourcePicture | Exception
_Held = tuple[str, Read]
_Cut = tuple[PeopleRows, list[tuple[np.ndarray, CutPeople]]]  # people who are alike, and their rows

Result = TypeVar("Result")
Attempted = list[tuple[slice, Sequence[Result] | Exception]]

_PIXELS = 2**24  # of pictures in which people are looked for at a time
_PICTURES = 32  # the same in number
_MESHES = threading.Lock()  # a mesh stage keeps the buffers of the last one
_FAULTS = (ValueError, RuntimeError, MemoryError)  # of single pictures; torch's and Warp's, too


def stages_of_quality(quality: BulkQuality) -> FitOptions:
    """Options of the ellipsoids' fit: none, of ``partdr fit --quality fast``, or of what a mesh stage goes on from."""
    if quality == "network":
        return replace(FitOptions.at("fast"), stages=())
    return FitOptions.at("fast") if quality == "fast" else FitOptions.at("balanced").without_outline()


@dataclass(frozen=True)
class PeopleFitter:
    """Fits of everyone in pictures.

    Attributes:
        options: Of the fits, such as ``stages_of_quality``.
        network: On the device, in evaluation mode.
        model: On the device; with one, the mesh stage makes the detailed body, too.
        device: "cpu" or a CUDA device.
        batch: People that are fitted at a time.
        min_score: Least confidence that there is a person, of those who are found.
        camera: The camera of a picture by its name and (H, W), if it is known; of all pictures or of none.
        skeleton: Format of keypoints in rows; those of other formats lose what it has not.
    """

    options: FitOptions
    network: LabelNetwork
    model: DetailedModel | None
    device: str
    batch: int
    min_score: float = MIN_SCORE
    camera: CameraOf = no_camera
    skeleton: str = SKELETON

    def rows(self, pictures: Iterable[tuple[str, Read]], tell: Callable[[str], None] | None = None) -> PeopleRows:
        """Rows of pictures, in their order; the same whatever was fitted before.

        Args:
            pictures: Names, and pictures, or why they can't be read.
            tell: Called with each picture's name.
        """
        with ThreadPoolExecutor(self.workers, thread_name_prefix="people") as pool:
            taken = _Taken(self, pool)
            try:
                for name, seen in pictures:
                    taken.add(name, seen)
                    if tell is not None:
                        tell(name)
                return taken.finish()
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise

    @property
    def workers(self) -> int:
        """Threads that find and fit people: on the CPU each takes one core, on CUDA one keeps the device busy."""
        return get_num_threads() if self.device == "cpu" else 1

    def find(self, pictures: Sequence[SourcePicture]) -> list[SourcePicture]:
        """Pictures with their people, found in one batch."""
        with one_torch_thread():
            everyone = find_people_in([each.pixels for each in pictures], device=self.device, min_score=self.min_score)
        return [
            replace(
                picture,
                people=tuple(KnownPerson(each.keypoints, each.score, each.box) for each in people),
                owners=instance_map(people, picture.pixels.shape[:2]) if people else None,
            )
            for picture, people in zip(pictures, everyone, strict=True)
        ]

    def bodies(self, people: CutPeople) -> list[RowPart]:
        """Bodies of people, in one batch."""
        fits = fit_together(people.to(self.device), self.options, self.network)
        if self.model is None:
            return describe_bodies(fits)
        with _MESHES:
            meshes = refine_meshes(fits, self.model, options=self.options.mesh)
        return describe_bodies(meshes)


@dataclass
class _Taken:
    """Pictures that were taken so far, and their rows.

    Groups of pictures, and batches of people, are worked on by threads and come back in order, so that rows depend on
    the pictures alone.
    """

    how: PeopleFitter
    pool: ThreadPoolExecutor
    rows: PeopleRows = field(default_factory=PeopleRows)
    _held: list[_Held] = field(default_factory=list)
    _cutting: deque[Future[_Cut]] = field(default_factory=deque)
    _waiting: list[_Waiting] = field(default_factory=list)
    _fitting: deque[tuple[np.ndarray, Future[list[RowPart]]]] = field(default_factory=deque)

    def add(self, name: str, seen: Read) -> None:
        """Take a picture, and find people when there are some."""
        self._held.append((name, seen))
        there = [each.pixels.size for _, each in self._held if isinstance(each, SourcePicture)]
        if len(there) >= _PICTURES or sum(there) >= 3 * _PIXELS:
            self._cut()

    def finish(self) -> PeopleRows:
        """Wait for all, and give the rows in order."""
        self._cut()
        self._collect_cut(0)
        self._fit(1)
        self._collect_fitted(0)
        return self.rows

    def _cut(self) -> None:
        held, self._held = self._held, []
        if held:
            self._cutting.append(self.pool.submit(_cut_people, self.how, held))
        self._collect_cut(self.how.workers)

    def _collect_cut(self, ahead: int) -> None:
        """Take what was cut out, but for so many groups that may still be in work."""
        while len(self._cutting) > ahead:
            rows, cut = self._cutting.popleft().result()
            numbers = self.rows.extend(rows)
            for places, people in cut:
                self._queue(people).add(numbers[places], people)
            self._fit(self.how.batch)

    def _queue(self, people: CutPeople) -> _Waiting:
        """Those who wait and are alike, for they are fitted together."""
        for waiting in self._waiting:
            if waiting.kind == people.kind:
                return waiting
        self._waiting.append(_Waiting(people.kind))
        return self._waiting[-1]

    def _fit(self, least: int) -> None:
        """Fit those who wait, in batches of ``least`` people at least."""
        for waiting in self._waiting:
            while waiting.count >= least:
                places, people = waiting.take(self.how.batch)
                self._fitting.append((places, self.pool.submit(_fit_people, self.how, people)))
        self._collect_fitted(2 * self.how.workers)

    def _collect_fitted(self, ahead: int) -> None:
        while len(self._fitting) > ahead:
            places, work = self._fitting.popleft()
            self.rows.parts += [part.at(places) for part in work.result()]


@dataclass
class _Waiting:
    """People of one kind who wait for a batch, and their rows."""

    kind: Kind
    count: int = 0
    _parts: list[tuple[np.ndarray, CutPeople]] = field(default_factory=list)

    def add(self, places: np.ndarray, people: CutPeople) -> None:
        self._parts.append((places, people))
        self.count += len(people)

    def take(self, most: int) -> tuple[np.ndarray, CutPeople]:
        """The first ones, so many at most."""
        places = np.concatenate([rows for rows, _ in self._parts])
        people = CutPeople.joined([some for _, some in self._parts])
        self._parts = [(places[most:], people[most:])] if len(places) > most else []
        self.count = max(self.count - most, 0)
        return places[:most], people[:most]


def _fit_people(how: PeopleFitter, people: CutPeople) -> list[RowPart]:
    parts: list[RowPart] = []
    for own, found in attempt(how.bodies, people):
        some = [error_part(0, one_line(found))] if isinstance(found, Exception) else found
        parts += [part.at(np.arange(own.start, own.stop)) for part in some]
    return parts


def _cut_people(how: PeopleFitter, held: Sequence[_Held]) -> _Cut:
    """Rows of pictures and their people, and the people cut out, for a fit."""
    unknown = [place for place, (_, seen) in enumerate(held) if isinstance(seen, SourcePicture) and seen.people is None]
    found: dict[int, Read] = {}
    for own, some in attempt(how.find, [held[place][1] for place in unknown]):
        found |= zip(unknown[own], [some] if isinstance(some, Exception) else some, strict=True)
    rows: list[Row] = []
    cut: list[tuple[int, CutPerson]] = []
    for place, (name, seen) in enumerate(held):
        known = found.get(place, seen)
        row: Row = {"picture": name}
        if isinstance(seen, SourcePicture):
            row |= {"height": seen.pixels.shape[0], "width": seen.pixels.shape[1]}
        try:
            if isinstance(known, Exception):
                raise known
            camera = how.camera(name, (row["height"], row["width"]))
        except _FAULTS as error:
            rows.append(row | {"error": one_line(error)})
            continue
        assert known.people is not None
        row["people"] = len(known.people)
        if not known.people:
            rows.append(row)
        for number, person in enumerate(known.people):
            rows.append(row | {"person": number} | _describe(person, how.skeleton))
            try:
                if place not in found:
                    check_inside(person.keypoints, (row["height"], row["width"]))
                cut.append((len(rows) - 1, _cut_person(known, number, camera)))
            except _FAULTS as error:
                rows[-1]["error"] = one_line(error)
    numbers = np.array([number for number, _ in cut])
    alike = stack_alike([person for _, person in cut])
    return PeopleRows.of(rows), [(numbers[places], people) for places, people in alike]


def _cut_person(known: SourcePicture, number: int, camera: Perspective | None) -> CutPerson:

    assert known.people is not None
    keypoints = known.people[number].keypoints
    if known.parts is not None:
        others = [each.keypoints for place, each in enumerate(known.people) if place != number]
        evidence = weigh_evidence(keypoints, known.parts, others)[0]
    elif known.owners is None:
        evidence = weigh_evidence(keypoints)[0]
    else:
        evidence = person_evidence(keypoints, known.owners, number)
    observation, crop = crop_evidence(evidence, camera=camera)
    slim = replace(evidence, picture=None, groups=None)  # else each would hold labels of a whole picture
    return CutPerson(slim, observation, crop)


def attempt(work: Callable[[Any], Sequence[Result]], items: Sequence[Any], start: int = 0) -> Attempted[Result]:
    """Results of a batch; if it fails, of its halves, so that in the end only those that are at fault have an error.

    With each, where in the batch it is, whose first item has the number ``start``.
    """
    if not items:
        return []
    own = slice(start, start + len(items))
    try:
        return [(own, work(items))]
    except _FAULTS as error:
        if len(items) == 1:
            return [(own, error)]
    half = len(items) // 2
    return [*attempt(work, items[:half], start), *attempt(work, items[half:], start + half)]


def one_line(error: Exception) -> str:
    """An error as one line of at most 300 characters."""
    text = " ".join(str(error).split()) or type(error).__name__
    return (text if isinstance(error, InputError) else f"{type(error).__name__}: {text}")[:300]


def _describe(person: KnownPerson, form: str) -> dict[str, Any]:
    given = person.keypoints
    keypoints = np.column_stack([given.points, given.confidence])
    if given.format.name != form:
        own = given.format.landmarks
        missing = np.zeros(3, dtype=np.float32)
        order = [own.index(name) if name in own else None for name in skeleton(form).landmarks]
        keypoints = np.stack([missing if place is None else keypoints[place] for place in order])
    return {
        "annotation": person.annotation,
        "score": person.score,
        "box": np.array(person.box),
        "keypoints": keypoints,
        "warnings": [],
    }
