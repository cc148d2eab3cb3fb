"""Driver of people in pictures: they are found in groups of pictures, cut out, and worked on in batches.

What is done with a batch is said by ``PeopleWork``: fits of a data set, or bodies that the network says. Groups and
batches are worked on by threads and come back in order as rows. What fails is a row with its error.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Protocol, TypeVar

import numpy as np
import torch

from ..inputs.cut_people import BatchKey, CutPeople
from ..interop.torch_threads import one_torch_thread
from ..kernels.launch import get_num_threads
from ..networks.detection import MIN_SCORE, LandmarkNetwork
from ..networks.detection.masks import instance_maps
from ..networks.detection.people import find_people_in
from ..networks.detection.person import FoundPerson
from .cutting import Cut, Cutter, Held, Read, attempt, one_line
from .outages import is_passing
from .rows import PeopleRows, RowPart, error_part
from .sources import KnownPerson, SourcePicture

# Pictures in which people are looked for at a time, and their pixels.
PICTURES = {"cpu": 32, "cuda": 256}
_PIXELS = {"cpu": 2**24, "cuda": 2**26}

Item = TypeVar("Item")


class PeopleWork(Protocol):
    """Work on people: how they are found, how they are cut out, and what is done with a batch of them."""

    @property
    def device(self) -> str:
        """Device of the work: "cpu" or a CUDA device."""

    @property
    def batch(self) -> int:
        """Number of people in a batch."""

    @property
    def workers(self) -> int:
        """Number of threads, such as ``people_threads``."""

    @property
    def cutter(self) -> Cutter:
        """Cutter of people out of pictures."""

    def find(self, pictures: Sequence[SourcePicture]) -> list[SourcePicture]:
        """Pictures with their people, found in one batch."""

    def bodies(self, people: CutPeople) -> list[RowPart]:
        """Columns of rows for the bodies of people, in one batch."""


@dataclass(frozen=True)
class FindRule:
    """Options of looking for people.

    Attributes:
        min_score: Least confidence that there is a person, 0 to 1.
        landmarks: Network whose keypoints are taken.
        half: True asks the networks in float16 on CUDA.
    """

    min_score: float = MIN_SCORE
    landmarks: LandmarkNetwork = "full"
    half: bool = False


def with_found_people(pictures: Sequence[SourcePicture], rule: FindRule, device: str) -> list[SourcePicture]:
    """Pictures with the people who were found in them, in one batch."""
    with one_torch_thread():
        pixels = [each.pixels for each in pictures]
        everyone = find_people_in(
            pixels, device=device, min_score=rule.min_score, half=rule.half, landmarks=rule.landmarks
        )
        owners = instance_maps(everyone, [(each.shape[0], each.shape[1]) for each in pixels])
    return [
        replace(picture, people=tuple(map(known_person, people)), owners=shown)
        for picture, people, shown in zip(pictures, everyone, owners, strict=True)
    ]


def known_person(person: FoundPerson) -> KnownPerson:
    """Keypoints, score and box of a person who was found."""
    return KnownPerson(person.keypoints, person.score, person.box)


def people_threads(device: str) -> int:
    """Threads that find and fit people: on the CPU each takes one core, on CUDA one keeps the device busy."""
    return get_num_threads() if device == "cpu" else 1


def pictures_at_a_time(device: str) -> int:
    """Pictures in which people are looked for at a time, if they are small."""
    return PICTURES[torch.device(device).type]


@contextmanager
def people_pool(work: PeopleWork) -> Iterator[ThreadPoolExecutor]:
    """Threads of the work; what still waits when the block ends is not begun."""
    pool = ThreadPoolExecutor(work.workers, thread_name_prefix="people")
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)


def group_rows(
    work: PeopleWork,
    pool: ThreadPoolExecutor,
    groups: Iterable[Iterable[Held | Cut]],
    tell: Callable[[str], None] | None = None,
) -> Iterator[PeopleRows]:
    """Rows of each group of pictures, in their order; while a group's last people are worked on, the next is taken.

    Rows are the same whatever is worked on beside them.

    Args:
        work: Object that finds, cuts out and fits the people.
        pool: Threads of ``people_pool``.
        groups: Names, and pictures, or why they can't be read; or people cut out of some.
        tell: Called with each picture's name.
    """
    begun: deque[_Taken] = deque()
    for pictures in groups:
        taken = _Taken(work, pool)
        for given in pictures:
            taken.add(given)
            for name in given.pictures if isinstance(given, Cut) else given[:1]:
                if tell is not None:
                    tell(name)
        taken.end()
        begun.append(taken)
        if len(begun) > 1:
            yield begun.popleft().finish()
    while begun:
        yield begun.popleft().finish()


def made_by(pool: ThreadPoolExecutor, items: Iterator[Item]) -> Iterator[Item]:
    """Items, none of them None, that a pool makes one by one, so that on CUDA one thread makes all launches."""
    while (item := pool.submit(next, items, None).result()) is not None:
        yield item


@dataclass
class _Taken:
    """Pictures that were taken so far, and their rows.

    Groups of pictures, and batches of people, are worked on by threads and come back in order, so that rows depend on
    the pictures alone.
    """

    work: PeopleWork
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
            self._collect_cut(self.work.workers)
            return
        self._held.append(given)
        there = [math.prod(each.size) for _, each in self._held if isinstance(each, SourcePicture)]
        device = self.work.device
        if len(there) >= pictures_at_a_time(device) or sum(there) >= _PIXELS[torch.device(device).type]:
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
            self._cutting.append(self.pool.submit(_cut_people, self.work, held))
        self._collect_cut(self.work.workers)

    def _collect_cut(self, ahead: int) -> None:
        """Take what was cut out, but for so many groups that may still be in work."""
        while len(self._cutting) > ahead:
            cut = self._cutting.popleft().result()
            numbers = self.rows.extend(cut.rows)
            for places, people in cut.people:
                self._queue(people).add(numbers[places], people)
            self._fit(self.work.batch)

    def _queue(self, people: CutPeople) -> _Waiting:
        """Find the waiting people with the same key, who are fitted as a batch; begin a group if there are none."""
        for waiting in self._waiting:
            if waiting.key == people.batch_key:
                return waiting
        self._waiting.append(_Waiting(people.batch_key))
        return self._waiting[-1]

    def _fit(self, least: int) -> None:
        """Fit those who wait, in batches of ``least`` people at least."""
        for waiting in self._waiting:
            while waiting.count >= least:
                places, people = waiting.take(self.work.batch)
                self._fitting.append((places, self.pool.submit(_fit_people, self.work, people)))
        self._collect_fitted(2 * self.work.workers)

    def _collect_fitted(self, ahead: int) -> None:
        while len(self._fitting) > ahead:
            places, fitted = self._fitting.popleft()
            self.rows.parts += [part.at(places) for part in fitted.result()]


@dataclass
class _Waiting:
    """People with one key who wait for a batch, and their rows."""

    key: BatchKey
    count: int = 0
    _parts: list[tuple[np.ndarray, CutPeople]] = field(default_factory=list)

    def add(self, places: np.ndarray, people: CutPeople) -> None:
        self._parts.append((places, people))
        self.count += len(people)

    def take(self, most: int) -> tuple[np.ndarray, list[CutPeople]]:
        """The first ones, so many at most."""
        taken: list[tuple[np.ndarray, CutPeople]] = []
        room = most
        while room and self._parts:
            places, people = self._parts.pop(0)
            if len(people) > room:
                self._parts.insert(0, (places[room:], people[room:]))
                places, people = places[:room], people[:room]
            taken.append((places, people))
            room -= len(people)
        self.count -= most - room
        return np.concatenate([places for places, _ in taken]), [people for _, people in taken]


def _fit_people(work: PeopleWork, given: Sequence[CutPeople]) -> list[RowPart]:
    """Columns of rows for the bodies of people, in one batch; who is at fault has an error instead."""
    people = CutPeople.joined([each.to(work.device) for each in given])
    parts: list[RowPart] = []
    for own, found in attempt(work.bodies, people):
        if isinstance(found, Exception):
            some: Sequence[RowPart] = [error_part(0, one_line(found), passing=is_passing(found))]
        else:
            some = found
        parts += [part.at(np.arange(own.start, own.stop)) for part in some]
    return parts


def _cut_people(work: PeopleWork, held: Sequence[Held]) -> Cut:
    """Rows of pictures and their people, and the people cut out, for a fit."""
    unknown = [place for place, (_, seen) in enumerate(held) if isinstance(seen, SourcePicture) and seen.people is None]
    found: dict[int, Read] = {}
    for own, some in attempt(work.find, [held[place][1] for place in unknown]):
        found |= zip(unknown[own], [some] if isinstance(some, Exception) else some, strict=True)
    return work.cutter.cut(held, found)
