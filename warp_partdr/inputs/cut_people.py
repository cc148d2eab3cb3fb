"""People as they are cut out of pictures for fits side by side: one, and many as arrays of all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, overload

import numpy as np

from ..body.labels import LabelSet
from ..body.skeletons import Skeleton
from ..cameras import Crop
from .evidence import Evidence
from .keypoints import Keypoints2D
from .observation import Observation
from .observations import Observations


class Kind(NamedTuple):
    """Properties in which people must agree to be stacked."""

    skeleton: str | Skeleton
    label_set: LabelSet | None
    with_probabilities: bool
    with_lens: bool
    lens_assumed: bool

    @classmethod
    def of(cls, skeleton: str | Skeleton, observed: Observation | Observations) -> Kind:
        """Kind of people with keypoints of this format."""
        with_lens = observed.lens is not None
        return cls(skeleton, observed.label_set, observed.maps is not None, with_lens, observed.lens_assumed)


@dataclass(frozen=True)
class CutPerson:
    """One person as ``crop_evidence`` cuts them out of a picture.

    Attributes:
        evidence: Keypoints and warnings; its labels aren't looked at and may be left out, to save memory.
        observation: Keypoints and labels in the crop.
        crop: Place of the crop in the picture.
    """

    evidence: Evidence
    observation: Observation
    crop: Crop

    @property
    def kind(self) -> Kind:
        """Key of the person: people with equal keys are alike, and can be stacked."""
        return Kind.of(self.evidence.keypoints.skeleton, self.observation)


@dataclass(frozen=True, eq=False)
class CutPeople(Sequence[CutPerson]):
    """N people who are alike; a person's own object is made when it is asked for, without labels of the picture.

    Attributes:
        skeleton: Format of the keypoints.
        points: Keypoints in the picture [px], shape (N, J, 2).
        confidence: Of these, shape (N, J).
        observations: Observations in the crops.
        crops: Places of the crops.
        windows: Parts of the pictures where the people's labels may be (``Evidence.window``).
        warnings: Faults of each person's input, a sentence each.
    """

    skeleton: str | Skeleton
    points: np.ndarray
    confidence: np.ndarray
    observations: Observations
    crops: tuple[Crop, ...]
    windows: tuple[Crop, ...]
    warnings: tuple[tuple[str, ...], ...]

    @classmethod
    def of(cls, people: Sequence[CutPerson]) -> CutPeople:
        """Stack people who are alike, one at least."""
        keypoints = [person.evidence.keypoints for person in people]
        return cls(
            keypoints[0].skeleton,
            np.stack([each.points for each in keypoints]),
            np.stack([each.confidence for each in keypoints]),
            Observations.of([person.observation for person in people], keypoints[0].format),
            tuple(person.crop for person in people),
            tuple(person.evidence.window for person in people),
            tuple(person.evidence.warnings for person in people),
        )

    @classmethod
    def joined(cls, parts: Sequence[CutPeople]) -> CutPeople:
        """Join people who are alike, one after the other."""
        if len(parts) == 1:
            return parts[0]
        return cls(
            parts[0].skeleton,
            np.concatenate([each.points for each in parts]),
            np.concatenate([each.confidence for each in parts]),
            Observations.joined([each.observations for each in parts]),
            *(tuple(one for each in parts for one in getattr(each, name)) for name in ("crops", "windows", "warnings")),
        )

    @property
    def kind(self) -> Kind:
        """Key of the people, as ``CutPerson.kind``: people with equal keys are alike."""
        return Kind.of(self.skeleton, self.observations)

    def __len__(self) -> int:
        """Number of people, N."""
        return len(self.crops)

    @overload
    def __getitem__(self, index: int) -> CutPerson: ...
    @overload
    def __getitem__(self, index: slice) -> CutPeople: ...
    def __getitem__(self, index: int | slice) -> CutPerson | CutPeople:
        """One person, or some as arrays."""
        if isinstance(index, slice):
            own = (getattr(self, name)[index] for name in ("crops", "windows", "warnings"))
            observations = self.observations.select(index)
            return CutPeople(self.skeleton, self.points[index], self.confidence[index], observations, *own)
        row = range(len(self))[index]
        keypoints = Keypoints2D(self.skeleton, self.points[row], self.confidence[row])
        evidence = Evidence(keypoints, None, self.windows[row], None, self.warnings[row])
        return CutPerson(evidence, self.observations[row], self.crops[row])

    def select(self, rows: Sequence[int]) -> CutPeople:
        """Return some of the people, by their rows."""
        return CutPeople.joined([self[row : row + 1] for row in rows])

    def to(self, device: str) -> CutPeople:
        """Copy the arrays that fits read to a device, one copy each."""
        return replace(self, observations=self.observations.to(device))


def stack_alike(people: Sequence[CutPerson]) -> list[tuple[list[int], CutPeople]]:
    """Stack people, those who are alike together; and their places."""
    alike: list[tuple[Kind, list[int]]] = []  # label sets can't be keys
    for place, person in enumerate(people):
        kind = person.kind
        places = next((those for each, those in alike if each == kind), None)
        if places is None:
            alike.append((kind, places := []))
        places.append(place)
    return [(places, CutPeople.of([people[place] for place in places])) for _, places in alike]
