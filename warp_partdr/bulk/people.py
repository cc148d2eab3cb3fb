"""People of pictures as rows: found, cut out, and fitted in batches. What fails is a row with its error."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal, TypeVar

import numpy as np

from ..body.skeletons import skeleton
from ..cameras import Perspective
from ..clothing.model import DetailedModel
from ..detection import MIN_SCORE
from ..detection.masks import instance_maps
from ..detection.people import find_people_in
from ..detection.person import SKELETON
from ..errors import InputError
from ..fit.mesh_stage import refine_meshes
from ..fit.options import FitOptions
from ..fit.together import CutPerson, fit_together
from ..inputs.evidence import weigh_evidence
from ..inputs.masked_people import MaskedPerson, cut_masks
from ..inputs.observation import crop_evidence
from ..inputs.person import check_inside
from ..interop.torch_threads import one_torch_thread
from ..kernels.launch import get_num_threads
from ..network.label_network import LabelNetwork
from .rows import Row, describe_bodies
from .sources import KnownPerson, SourcePicture

BulkQuality = Literal["network", "fast", "mesh"]
CameraOf = Callable[[str, tuple[int, int]], Perspective | None]


def no_camera(name: str, size: tuple[int, int]) -> None:
    """None: the camera of no picture is known."""


Key = tuple[int, int]  # place of a picture, and number of a person
_Held = tuple[int, str, SourcePicture]
_Cut = tuple[dict[Key, Row], list[tuple[Key, CutPerson]]]

Item = TypeVar("Item")
Result = TypeVar("Result")

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

    def rows(
        self, pictures: Iterable[tuple[str, SourcePicture | Exception]], tell: Callable[[str], None] | None = None
    ) -> list[Row]:
        """Rows of pictures, in their order; the same whatever was fitted before.

        Args:
            pictures: Names, and pictures, or why they can't be read.
            tell: Called with each picture's name.
        """
        with ThreadPoolExecutor(self.workers, thread_name_prefix="people") as pool:
            taken = _Taken(self, pool)
            try:
                for index, (name, seen) in enumerate(pictures):
                    taken.add(index, name, seen)
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
            pixels = [each.pixels for each in pictures]
            everyone = find_people_in(pixels, device=self.device, min_score=self.min_score)
            owners = instance_maps(everyone, [(each.shape[0], each.shape[1]) for each in pixels])
        return [
            replace(
                picture,
                people=tuple(KnownPerson(each.keypoints, each.score, each.box) for each in people),
                owners=shown,
            )
            for picture, people, shown in zip(pictures, everyone, owners, strict=True)
        ]

    def bodies(self, people: Sequence[CutPerson]) -> list[Row]:
        """Bodies of people, in one batch of each keypoints' format."""
        forms = list(dict.fromkeys(person.evidence.keypoints.format.name for person in people))
        if len(forms) > 1:
            rows: dict[int, Row] = {}
            for form in forms:
                places = [place for place, each in enumerate(people) if each.evidence.keypoints.format.name == form]
                rows |= zip(places, self.bodies([people[place] for place in places]), strict=True)
            return [rows[place] for place in range(len(people))]
        fits = fit_together(people, self.options, self.network)
        if self.model is None:
            return describe_bodies(fits)
        with _MESHES:
            meshes = refine_meshes(fits, self.model, options=self.options.mesh)
        return describe_bodies(meshes)


@dataclass
class _Taken:
    """Pictures that were taken so far, and rows by the place of the picture and the number of the person.

    Groups of pictures, and batches of people, are worked on by threads and come back in order, so that rows depend on
    the pictures alone.
    """

    how: PeopleFitter
    pool: ThreadPoolExecutor
    rows: dict[Key, Row] = field(default_factory=dict)
    _held: list[_Held] = field(default_factory=list)
    _cutting: deque[Future[_Cut]] = field(default_factory=deque)
    _waiting: list[tuple[Key, CutPerson]] = field(default_factory=list)
    _fitting: deque[tuple[list[Key], Future[list[Row | Exception]]]] = field(default_factory=deque)

    def add(self, index: int, name: str, seen: SourcePicture | Exception) -> None:
        """Take a picture, and find people when there are some."""
        if isinstance(seen, Exception):
            self.rows[index, 0] = {"picture": name, "error": one_line(seen)}
            return
        self._held.append((index, name, seen))
        if len(self._held) >= _PICTURES or sum(each.pixels.size for _, _, each in self._held) >= 3 * _PIXELS:
            self._cut()

    def finish(self) -> list[Row]:
        """Wait for all, and give the rows in order."""
        self._cut()
        self._collect_cut(0)
        self._fit(1)
        self._collect_fitted(0)
        return [self.rows[key] for key in sorted(self.rows)]

    def _cut(self) -> None:
        held, self._held = self._held, []
        if held:
            self._cutting.append(self.pool.submit(_cut_people, self.how, held))
        self._collect_cut(self.how.workers)

    def _collect_cut(self, ahead: int) -> None:
        """Take what was cut out, but for so many groups that may still be in work."""
        while len(self._cutting) > ahead:
            rows, people = self._cutting.popleft().result()
            self.rows |= rows
            self._waiting += people
            self._fit(self.how.batch)

    def _fit(self, least: int) -> None:
        """Fit those who wait, in batches of ``least`` people at least."""
        while len(self._waiting) >= least:
            some, self._waiting = self._waiting[: self.how.batch], self._waiting[self.how.batch :]
            work = self.pool.submit(attempt, self.how.bodies, [person for _, person in some])
            self._fitting.append(([key for key, _ in some], work))
        self._collect_fitted(2 * self.how.workers)

    def _collect_fitted(self, ahead: int) -> None:
        while len(self._fitting) > ahead:
            keys, work = self._fitting.popleft()
            for key, body in zip(keys, work.result(), strict=True):
                if isinstance(body, Exception):
                    self.rows[key]["error"] = one_line(body)
                else:
                    self.rows[key] |= body


def _cut_people(how: PeopleFitter, held: Sequence[_Held]) -> _Cut:
    """Rows of pictures and their people, and the people cut out, for a fit."""
    rows: dict[Key, Row] = {}
    people: list[tuple[Key, CutPerson]] = []
    masked: list[tuple[Key, MaskedPerson]] = []
    unknown = [place for place, (_, _, seen) in enumerate(held) if seen.people is None]
    found = dict(zip(unknown, attempt(how.find, [held[place][2] for place in unknown]), strict=True))
    for place, (index, name, seen) in enumerate(held):
        known = found.get(place, seen)
        row: Row = {"picture": name, "height": seen.pixels.shape[0], "width": seen.pixels.shape[1]}
        try:
            if isinstance(known, Exception):
                raise known
            camera = how.camera(name, (row["height"], row["width"]))
        except _FAULTS as error:
            rows[index, 0] = row | {"error": one_line(error)}
            continue
        assert known.people is not None
        row["people"] = len(known.people)
        if not known.people:
            rows[index, 0] = row
        for number, person in enumerate(known.people):
            key = index, number
            rows[key] = row | {"person": number} | _describe(person, how.skeleton)
            try:
                if seen.people is not None:
                    check_inside(person.keypoints, (row["height"], row["width"]))
                if known.parts is None and known.owners is not None:
                    masked.append((key, MaskedPerson(person.keypoints, known.owners, number + 1, camera)))
                else:
                    people.append((key, _cut_person(known, number, camera, how.device)))
            except _FAULTS as error:
                rows[key]["error"] = one_line(error)
    cut = attempt(partial(cut_masks, device=how.device), [person for _, person in masked])
    for (key, _), each in zip(masked, cut, strict=True):
        if isinstance(each, Exception):
            rows[key]["error"] = one_line(each)
        else:
            people.append((key, CutPerson(*each)))
    return rows, sorted(people, key=lambda each: each[0])


def _cut_person(known: SourcePicture, number: int, camera: Perspective | None, device: str) -> CutPerson:
    assert known.people is not None
    keypoints = known.people[number].keypoints
    if known.parts is not None:
        others = [each.keypoints for place, each in enumerate(known.people) if place != number]
        evidence = weigh_evidence(keypoints, known.parts, others)[0]
    else:
        evidence = weigh_evidence(keypoints)[0]
    observation, crop = crop_evidence(evidence, device=device, camera=camera)
    slim = replace(evidence, picture=None, groups=None)  # else each would hold labels of a whole picture
    return CutPerson(slim, observation, crop)


def attempt(work: Callable[[Sequence[Item]], Sequence[Result]], items: Sequence[Item]) -> list[Result | Exception]:
    """Results of a batch; if it fails, of its halves, so that in the end only those that are at fault have an error."""
    if not items:
        return []
    try:
        return list(work(items))
    except _FAULTS as error:
        if len(items) == 1:
            return [error]
    half = len(items) // 2
    return attempt(work, items[:half]) + attempt(work, items[half:])


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
