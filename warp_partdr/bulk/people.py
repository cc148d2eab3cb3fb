"""People of pictures as rows: found, cut out, and fitted in batches. What fails is a row with its error."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import torch

from ..inputs.cut_people import CutPeople, Kind
from ..inputs.observation import LABEL_SIZE
from ..interop.torch_threads import one_torch_thread
from ..kernels.launch import get_num_threads
from ..models.model import DetailedModel
from ..networks.detection import MIN_SCORE
from ..networks.detection.masks import instance_maps
from ..networks.detection.people import find_people_in
from ..networks.regression.label_network import LabelNetwork
from ..solve.ellipsoids.depth_flips import FLIP_SIZE
from ..solve.ellipsoids.fitting import fit_people
from ..solve.ellipsoids.options import FitOptions
from ..solve.ellipsoids.plausibility import JUDGED_SIZE
from ..solve.mesh.mesh_stage import refine_meshes
from .cutting import Cut, Cutter, Held, Read, attempt, one_line
from .outages import is_passing
from .rows import PeopleRows, RowPart, describe_bodies, error_part
from .sources import KnownPerson, SourcePicture

BulkQuality = Literal["network", "fast", "mesh"]

# Pictures in which people are looked for at a time, and their pixels.
_PICTURES = {"cpu": 32, "cuda": 256}
_PIXELS = {"cpu": 2**24, "cuda": 2**26}
_MESHES = threading.Lock()  # a mesh stage keeps the buffers of the last one


def stages_of_quality(quality: BulkQuality) -> FitOptions:
    """Options of the ellipsoids' fit: none, of ``partdr fit --quality fast``, or of what a mesh stage goes on from.

    No search is tried for those who end far from what was seen: it takes seconds a person. Warnings tell of them.
    Keypoints are those of the smaller landmark network: of many people, the larger one would take most of the time.
    """
    if quality == "network":
        return replace(FitOptions.at("fast"), stages=(), search=())
    if quality == "fast":
        return replace(FitOptions.at("fast"), search=())
    return replace(FitOptions.at("balanced").without_outline(), landmarks="full", search=())


def kept_label_size(options: FitOptions, network: LabelNetwork, *, meshes: bool) -> int:
    """Side [px] at which labels of cut out people are kept for ``fit_people``, and for the mesh stage, too.

    ``LABEL_SIZE``; but where all look at one size that these can be thinned to, that one: 128 px take a 25th of the
    memory.
    """
    sizes = {network.config.size, JUDGED_SIZE, FLIP_SIZE, *(stage.size for stage in options.stages)}
    (least, *more) = sorted(sizes | ({options.mesh.size} if meshes else set()))
    return LABEL_SIZE if more or LABEL_SIZE % (2 * least) != least else least


@dataclass(frozen=True)
class PeopleFitter:
    """Fitter of everyone in pictures: it finds people, predicts their bodies and refines them.

    Attributes:
        options: Options of the fits, such as ``stages_of_quality``. With ``half``, people are found in float16 on CUDA.
        network: Network on the device, in evaluation mode.
        model: Detailed model on the device. If there is one, the mesh stage makes the detailed body, too.
        device: Device, "cpu" or a CUDA device.
        batch: Number of people that are fitted at a time.
        min_score: Least confidence that there is a person, for people who are found.
        cutter: Object that cuts people out of pictures.
    """

    options: FitOptions
    network: LabelNetwork
    model: DetailedModel | None = None
    device: str = "cpu"
    batch: int = 16
    min_score: float = MIN_SCORE
    cutter: Cutter = field(default_factory=Cutter)

    def begin(
        self, pool: ThreadPoolExecutor, pictures: Iterable[Held | Cut], tell: Callable[[str], None] | None = None
    ) -> Callable[[], PeopleRows]:
        """Take pictures, and return what waits until all are fitted and gives their rows, in their order.

        Rows are the same whatever is fitted beside them.

        Args:
            pool: Pool with ``workers`` threads, which find and fit people.
            pictures: Names with pictures, or with the reason why they can't be read, or people cut out of some
                pictures.
            tell: Function that is called with each picture's name.
        """
        taken = _Taken(self, pool)
        for given in pictures:
            taken.add(given)
            for name in given.pictures if isinstance(given, Cut) else given[:1]:
                if tell is not None:
                    tell(name)
        taken.end()
        return taken.finish

    @property
    def workers(self) -> int:
        """Threads that find and fit people: on the CPU each takes one core, on CUDA one keeps the device busy."""
        return get_num_threads() if self.device == "cpu" else 1

    def find(self, pictures: Sequence[SourcePicture]) -> list[SourcePicture]:
        """Pictures with their people, found in one batch."""
        with one_torch_thread():
            pixels = [each.pixels for each in pictures]
            score, half = self.min_score, self.options.half
            everyone = find_people_in(
                pixels, device=self.device, min_score=score, half=half, landmarks=self.options.landmarks
            )
            owners = instance_maps(everyone, [(each.shape[0], each.shape[1]) for each in pixels])
        return [
            replace(
                picture,
                people=tuple(KnownPerson(each.keypoints, each.score, each.box) for each in people),
                owners=shown,
            )
            for picture, people, shown in zip(pictures, everyone, owners, strict=True)
        ]

    def bodies(self, people: CutPeople) -> list[RowPart]:
        """Bodies of people, in one batch."""
        fits = fit_people(people, self.options, self.network)
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

    fitter: PeopleFitter
    pool: ThreadPoolExecutor
    rows: PeopleRows = field(default_factory=PeopleRows)
    _held: list[Held] = field(default_factory=list)
    _cutting: deque[Future[Cut]] = field(default_factory=deque)
    _waiting: list[_Waiting] = field(default_factory=list)
    _fitting: deque[tuple[np.ndarray, Future[list[RowPart]]]] = field(default_factory=deque)

    def add(self, given: Held | Cut) -> None:
        """Take a picture, and find people when there are some; or people who are cut out already."""
        if isinstance(given, Cut):
            self._cut()
            done: Future[Cut] = Future()
            done.set_result(given)
            self._cutting.append(done)
            self._collect_cut(self.fitter.workers)
            return
        self._held.append(given)
        there = [math.prod(each.size) for _, each in self._held if isinstance(each, SourcePicture)]
        kind = torch.device(self.fitter.device).type
        if len(there) >= _PICTURES[kind] or sum(there) >= _PIXELS[kind]:
            self._cut()

    def end(self) -> None:
        """Give the last ones to the threads, too."""
        self._cut()
        self._collect_cut(0)
        self._fit(1)

    def finish(self) -> PeopleRows:
        """Wait for all, and give the rows in order."""
        self._collect_fitted(0)
        return self.rows

    def _cut(self) -> None:
        held, self._held = self._held, []
        if held:
            self._cutting.append(self.pool.submit(_cut_people, self.fitter, held))
        self._collect_cut(self.fitter.workers)

    def _collect_cut(self, ahead: int) -> None:
        """Take what was cut out, except for ``ahead`` groups that may still be in work."""
        while len(self._cutting) > ahead:
            cut = self._cutting.popleft().result()
            numbers = self.rows.extend(cut.rows)
            for indices, people in cut.people:
                self._queue(people).add(numbers[indices], people)
            self._fit(self.fitter.batch)

    def _queue(self, people: CutPeople) -> _Waiting:
        """Waiting people of the same kind, who are fitted together; a new group if there are none."""
        for waiting in self._waiting:
            if waiting.kind == people.kind:
                return waiting
        self._waiting.append(_Waiting(people.kind))
        return self._waiting[-1]

    def _fit(self, least: int) -> None:
        """Fit those who wait, in batches of ``least`` people at least."""
        for waiting in self._waiting:
            while waiting.count >= least:
                indices, people = waiting.take(self.fitter.batch)
                self._fitting.append((indices, self.pool.submit(_fit_people, self.fitter, people)))
        self._collect_fitted(2 * self.fitter.workers)

    def _collect_fitted(self, ahead: int) -> None:
        while len(self._fitting) > ahead:
            indices, work = self._fitting.popleft()
            self.rows.parts += [part.at(indices) for part in work.result()]


@dataclass
class _Waiting:
    """People of one kind who wait for a batch, and their rows."""

    kind: Kind
    count: int = 0
    _parts: list[tuple[np.ndarray, CutPeople]] = field(default_factory=list)

    def add(self, indices: np.ndarray, people: CutPeople) -> None:
        self._parts.append((indices, people))
        self.count += len(people)

    def take(self, most: int) -> tuple[np.ndarray, list[CutPeople]]:
        """Returns the first people, at most as many as asked for."""
        taken: list[tuple[np.ndarray, CutPeople]] = []
        room = most
        while room and self._parts:
            indices, people = self._parts.pop(0)
            if len(people) > room:
                self._parts.insert(0, (indices[room:], people[room:]))
                indices, people = indices[:room], people[:room]
            taken.append((indices, people))
            room -= len(people)
        self.count -= most - room
        return np.concatenate([indices for indices, _ in taken]), [people for _, people in taken]


def _fit_people(fitter: PeopleFitter, given: Sequence[CutPeople]) -> list[RowPart]:
    people = CutPeople.joined([each.to(fitter.device) for each in given])
    parts: list[RowPart] = []
    for own, found in attempt(fitter.bodies, people):
        if isinstance(found, Exception):
            some: Sequence[RowPart] = [error_part(0, one_line(found), passing=is_passing(found))]
        else:
            some = found
        parts += [part.at(np.arange(own.start, own.stop)) for part in some]
    return parts


def _cut_people(fitter: PeopleFitter, held: Sequence[Held]) -> Cut:
    """Rows of pictures and their people, and the people cut out, for a fit."""
    unknown = [index for index, (_, seen) in enumerate(held) if isinstance(seen, SourcePicture) and seen.people is None]
    found: dict[int, Read] = {}
    for own, some in attempt(fitter.find, [held[index][1] for index in unknown]):
        found |= zip(unknown[own], [some] if isinstance(some, Exception) else some, strict=True)
    return fitter.cutter.cut(held, found)
