"""People that are cut out of pictures for fits: one person, and a batch of people as arrays."""

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


class BatchKey(NamedTuple):
    """Properties in which people must agree to be in one batch."""

    skeleton: str | Skeleton
    label_set: LabelSet | None
    with_probabilities: bool
    with_lens: bool
    lens_assumed: bool

    @classmethod
    def of(cls, skeleton: str | Skeleton, observed: Observation | Observations) -> BatchKey:
        """Key for people with keypoints of this format."""
        with_lens = observed.lens is not None
        return cls(skeleton, observed.label_set, observed.maps is not None, with_lens, observed.lens_assumed)


@dataclass(frozen=True)
class CutPerson:
    """One person as ``crop_evidence`` cuts them out of a picture.

    Attributes:
        evidence: Keypoints and warnings. Nothing reads its labels, which may be left out to save memory.
        observation: Keypoints and labels in the crop.
        crop: Position of the crop in the picture.
    """

    evidence: Evidence
    observation: Observation
    crop: Crop

    @property
    def batch_key(self) -> BatchKey:
        """Key of the person: people with equal keys can be in one batch."""
        return BatchKey.of(self.evidence.keypoints.skeleton, self.observation)


@dataclass(frozen=True, eq=False)
class CutPeople(Sequence[CutPerson]):
    """Batch of N people with one ``batch_key``. An index gives one person, without labels of the picture.

    Attributes:
        skeleton: Format of the keypoints.
        points: Keypoints in the picture [px], shape (N, J, 2).
        confidence: Confidences of the keypoints, 0 where missing, shape (N, J).
        observations: Observations in the crops.
        crops: Positions of the crops in the pictures.
        windows: Parts of the pictures where the people's labels may be (``Evidence.window``).
        warnings: Sentences about faults of each person's input.
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
        """Build a batch of people, at least one. All must have the same ``batch_key``."""
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
        """Join batches, one after the other. All must have the same ``batch_key``."""
        if len(parts) == 1:
            return parts[0]
        return cls(
            parts[0].skeleton,
            np.concatenate([each.points for each in parts]),
            np.concatenate([each.confidence for each in parts]),
            Observations.joined([each.observations for each in parts]),
            tuple(crop for each in parts for crop in each.crops),
            tuple(window for each in parts for window in each.windows),
            tuple(warnings for each in parts for warnings in each.warnings),
        )

    @property
    def batch_key(self) -> BatchKey:
        """Key of the people, equal to ``CutPerson.batch_key`` of each."""
        return BatchKey.of(self.skeleton, self.observations)

    def __len__(self) -> int:
        """Number of people, N."""
        return len(self.crops)

    @overload
    def __getitem__(self, index: int) -> CutPerson: ...
    @overload
    def __getitem__(self, index: slice) -> CutPeople: ...
    def __getitem__(self, index: int | slice) -> CutPerson | CutPeople:
        """Return one person, or a batch of the people in a slice."""
        if isinstance(index, slice):
            return CutPeople(
                self.skeleton,
                self.points[index],
                self.confidence[index],
                self.observations.select(index),
                self.crops[index],
                self.windows[index],
                self.warnings[index],
            )
        row = range(len(self))[index]
        keypoints = Keypoints2D(self.skeleton, self.points[row], self.confidence[row])
        evidence = Evidence(keypoints, None, self.windows[row], None, self.warnings[row])
        return CutPerson(evidence, self.observations[row], self.crops[row])

    def select(self, rows: Sequence[int]) -> CutPeople:
        """Return a batch of some of the people, by their rows."""
        return CutPeople.joined([self[row : row + 1] for row in rows])

    def to(self, device: str) -> CutPeople:
        """Copy the arrays that fits read to a device, one copy each."""
        return replace(self, observations=self.observations.to(device))


def batch_people(people: Sequence[CutPerson]) -> list[tuple[list[int], CutPeople]]:
    """Build a batch for each ``batch_key`` among the people, and return the people's indices beside it."""
    batches: list[tuple[BatchKey, list[int]]] = []  # label sets can't be keys of a dictionary
    for index, person in enumerate(people):
        key = person.batch_key
        indices = next((own for each, own in batches if each == key), None)
        if indices is None:
            batches.append((key, indices := []))
        indices.append(index)
    return [(indices, CutPeople.of([people[index] for index in indices])) for _, indices in batches]
