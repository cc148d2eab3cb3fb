"""People of pictures as rows: found, cut out, and fitted in batches. What fails is a row with its error."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, TypeVar

import numpy as np

from ..cameras import Perspective
from ..clothing.model import DetailedModel
from ..detection.masks import instance_map
from ..detection.people import find_people_in
from ..errors import InputError
from ..fit.mesh_stage import refine_meshes
from ..fit.options import FitOptions
from ..fit.photo import person_evidence
from ..fit.together import CutPerson, fit_together
from ..inputs.evidence import weigh_evidence
from ..inputs.observation import crop_evidence
from ..network.label_network import LabelNetwork
from .rows import Row, describe_bodies, finite
from .sources import KnownPerson, SourcePicture

BulkQuality = Literal["network", "fast", "mesh"]
CameraOf = Callable[[str, tuple[int, int]], Perspective | None]

Item = TypeVar("Item")
Result = TypeVar("Result")

_PIXELS = 2**24  # of pictures in which people are looked for at a time
_PICTURES = 32  # the same in number
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
        quality: "network": the label network's bodies; "fast": refined; "mesh": the detailed body, too.
        network: On the device, in evaluation mode.
        model: On the device, of quality "mesh".
        device: "cpu" or a CUDA device.
        batch: People that are fitted at a time.
        min_score: Least confidence that there is a person, of those who are found.
        camera: The camera of a picture by its name and (H, W), if it is known; of all pictures or of none.
    """

    quality: BulkQuality
    network: LabelNetwork
    model: DetailedModel | None
    device: str
    batch: int
    min_score: float = 0.5
    camera: CameraOf = lambda name, size: None

    def rows(
        self, pictures: Iterable[tuple[str, SourcePicture | Exception]], tell: Callable[[str], None] | None = None
    ) -> list[Row]:
        """Rows of pictures, in their order; the same whatever was fitted before.

        Args:
            pictures: Names, and pictures, or why they can't be read.
            tell: Called with each picture's name.
        """
        taken = _Taken(self)
        for index, (name, seen) in enumerate(pictures):
            if isinstance(seen, Exception):
                taken.rows[index, 0] = {"picture": name, "error": one_line(seen)}
            else:
                taken.hold(index, name, seen)
            if tell is not None:
                tell(name)
        taken.find()
        taken.fit()
        return [taken.rows[key] for key in sorted(taken.rows)]

    def bodies(self, people: Sequence[CutPerson]) -> list[Row]:
        """Bodies of people, in one batch."""
        fits = fit_together(people, stages_of_quality(self.quality), self.network)
        return describe_bodies(refine_meshes(fits, self.model) if self.quality == "mesh" else fits)


@dataclass
class _Taken:
    """Pictures that were taken so far, and rows by the place of the picture and the number of the person."""

    how: PeopleFitter
    rows: dict[tuple[int, int], Row] = field(default_factory=dict)
    _held: list[tuple[int, str, SourcePicture]] = field(default_factory=list)
    _waiting: list[tuple[tuple[int, int], CutPerson]] = field(default_factory=list)

    def hold(self, index: int, name: str, seen: SourcePicture) -> None:
        """Hold a picture until there are some."""
        self._held.append((index, name, seen))
        if len(self._held) >= _PICTURES or sum(each.pixels.size for _, _, each in self._held) >= 3 * _PIXELS:
            self.find()

    def find(self) -> None:
        """Find the people of the pictures that are held."""
        held, self._held = self._held, []
        unknown = [place for place, (_, _, seen) in enumerate(held) if seen.people is None]
        found = dict(zip(unknown, attempt(self._find, [held[place][2] for place in unknown]), strict=True))
        for place, (index, name, seen) in enumerate(held):
            known = found.get(place, seen)
            row: Row = {"picture": name, "height": seen.pixels.shape[0], "width": seen.pixels.shape[1]}
            try:
                if isinstance(known, Exception):
                    raise known
                camera = self.how.camera(name, (row["height"], row["width"]))
            except _FAULTS as error:
                self.rows[index, 0] = row | {"error": one_line(error)}
                continue
            assert known.people is not None
            row["people"] = len(known.people)
            if not known.people:
                self.rows[index, 0] = row
            for number, person in enumerate(known.people):
                self.rows[index, number] = row | {"person": number} | _describe(person)
                self._cut(index, number, known, camera)

    def _find(self, pictures: Sequence[SourcePicture]) -> list[SourcePicture]:
        how = self.how
        everyone = find_people_in([each.pixels for each in pictures], device=how.device, min_score=how.min_score)
        return [
            replace(
                picture,
                people=tuple(KnownPerson(each.keypoints, each.score, each.box) for each in people),
                owners=instance_map(people, picture.pixels.shape[:2]) if people else None,
            )
            for picture, people in zip(pictures, everyone, strict=True)
        ]

    def _cut(self, index: int, number: int, known: SourcePicture, camera: Perspective | None) -> None:
        """Cut a person out, who then waits to be fitted."""
        assert known.people is not None
        keypoints = known.people[number].keypoints
        try:
            if known.owners is None:
                evidence = weigh_evidence(keypoints)[0]
            else:
                evidence = person_evidence(keypoints, known.owners, number)
            observation, crop = crop_evidence(evidence, device=self.how.device, camera=camera)
        except _FAULTS as error:
            self.rows[index, number]["error"] = one_line(error)
            return
        slim = replace(evidence, picture=None, groups=None)  # else each would hold labels of a whole picture
        self._waiting.append(((index, number), CutPerson(slim, observation, crop)))
        if len(self._waiting) >= self.how.batch:
            self.fit()

    def fit(self) -> None:
        """Fit those who wait."""
        waiting, self._waiting = self._waiting, []
        bodies = attempt(self.how.bodies, [person for _, person in waiting])
        for (key, _), body in zip(waiting, bodies, strict=True):
            if isinstance(body, Exception):
                self.rows[key]["error"] = one_line(body)
            elif not finite(body):
                self.rows[key]["error"] = "the body holds NaN or infinity; expected finite numbers"
            else:
                self.rows[key] |= body


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


def _describe(person: KnownPerson) -> dict[str, Any]:
    keypoints = np.column_stack([person.keypoints.points, person.keypoints.confidence])
    return {
        "annotation": person.annotation,
        "score": person.score,
        "box": np.array(person.box),
        "keypoints": keypoints,
        "warnings": [],
    }
