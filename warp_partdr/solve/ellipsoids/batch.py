"""Observations of N people side by side, as the captured refinement reads them."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import torch

from ...body.landmarks import landmark_points
from ...body.template import NUM_PARTS
from ...inputs.observation import Observation, resize_nearest
from ...inputs.stacked import StackedObservations
from .energy import Energy, split_votes, stack_depth_scales
from .tables import LANDMARK_NAMES


@dataclass(frozen=True)
class Batch:
    """Observations of N people.

    Attributes:
        points: Of ``LANDMARK_NAMES``, in crops of side 2, 0 where they are not seen, shape (N, L, 2).
        votes: Their weights, shape (N, L).
        lengths: Expected ones [m], shape (N, 12).
        thicknesses: The same, shape (N, 15).
        depths: Of the parts' centres [m], shape (N, 20); 0 where they may be anywhere.
        depth_scales: 1 / how sure these are [1/m], shape (N, 20).
        lenses: Focal lengths and principal points, shape (N, 3); 0 without.
        targets: Label images, shape (N, size, size), uint8; None if nothing is drawn.
        seen: Names of the landmarks that anybody has.
        labels: Label images as they were given, of one size; None without, and of some of the people.
    """

    points: torch.Tensor
    votes: torch.Tensor
    lengths: torch.Tensor
    thicknesses: torch.Tensor
    depths: torch.Tensor
    depth_scales: torch.Tensor
    lenses: torch.Tensor
    targets: torch.Tensor | None
    seen: frozenset[str]
    labels: torch.Tensor | None = None

    @classmethod
    def of(cls, people: Sequence[Observation], energy: Energy) -> Batch:
        """Stack the observations of people.

        What an observation leaves open is as in ``energy``, which is that of one of them. All must be of its kind.
        """
        device = people[0].points.device
        counts = [len(each.landmarks) for each in people]
        person = torch.from_numpy(np.repeat(np.arange(len(people)), counts)).to(device)
        columns, parts = (
            torch.from_numpy(np.concatenate(rows)).to(device)
            for rows in zip(*(_places(each.landmarks, each.body_points) for each in people), strict=True)
        )
        sure = torch.zeros(len(people), len(LANDMARK_NAMES), device=device)
        sure[person, columns] = torch.cat([each.confidence for each in people])
        on_parts = torch.zeros_like(sure, dtype=torch.int64)
        on_parts[person, columns] = parts
        points = sure.new_zeros(*sure.shape, 2)
        points[person, columns] = torch.cat([each.points for each in people])

        def stacked(name: str, usual: torch.Tensor) -> torch.Tensor:
            own = [getattr(each, name) for each in people]
            return torch.stack([usual if each is None else each for each in own])

        labels = None if energy.target is None else _stack_labels(people)
        return cls(
            points=points,
            votes=split_votes(sure, on_parts),
            lengths=stacked("lengths", energy.usual_lengths),
            thicknesses=stacked("thicknesses", energy.usual_thicknesses),
            depths=stacked("depths", sure.new_zeros(NUM_PARTS)),
            depth_scales=stack_depth_scales([each.depth_spreads for each in people], device),
            lenses=stacked("lens", sure.new_zeros(3)),
            targets=None if labels is None else resize_nearest(labels, energy.size),
            seen=frozenset(name for names in {each.body_points for each in people} for name in names),
            labels=labels,
        )

    @classmethod
    def of_stacked(cls, people: StackedObservations, energy: Energy) -> Batch:
        """Make a batch of people who are stacked already; sizes and depths are the energy's usual ones."""
        votes, columns = _stacked_votes(people)
        points = votes.new_zeros(*votes.shape, 2)
        points[:, columns] = people.points
        labels = None if energy.target is None else people.labels
        return cls(
            points=points,
            votes=votes,
            lengths=energy.usual_lengths.repeat(len(people), 1),
            thicknesses=energy.usual_thicknesses.repeat(len(people), 1),
            depths=votes.new_zeros(len(people), NUM_PARTS),
            depth_scales=energy.depth_scales.repeat(len(people), 1),
            lenses=votes.new_zeros(len(people), 3) if people.lens is None else people.lens,
            targets=None if labels is None else resize_nearest(labels, energy.size),
            seen=frozenset(np.array(people.marks)[people.visible.any(axis=0)].tolist()),
            labels=labels,
        )

    def believing(self, people: StackedObservations) -> Batch:
        """Batch of the same people with the confidence in keypoints that these observations of them have."""
        return replace(self, votes=_stacked_votes(people)[0])

    def __len__(self) -> int:
        """Number of people, N."""
        return len(self.votes)

    @property
    def kind(self) -> Hashable:
        """Numbers, pictures and landmarks: batches that agree in it can take one another's place in a graph."""
        return self.seen, tuple((name, tuple(each.shape)) for name, each in self._named().items())

    def tensors(self) -> list[torch.Tensor]:
        """All that a refinement reads."""
        return list(self._named().values())

    def copied(self) -> Batch:
        """Copies of these, which nobody else changes."""
        return replace(self, labels=None, **{name: each.clone() for name, each in self._named().items()})

    def _named(self) -> dict[str, Any]:
        return {name: each for name, each in vars(self).items() if torch.is_tensor(each) and name != "labels"}

    def drawn_at(self, size: int) -> Batch:
        """Batch with label images of ``size`` pixels a side; with size 0, nothing is drawn."""
        if self.labels is None or size == 0:
            return replace(self, targets=None)
        return replace(self, targets=resize_nearest(self.labels, size))

    def select(self, rows: torch.Tensor | slice) -> Batch:
        """Some of the people; one may come several times."""
        chosen: dict[str, Any] = {name: each[rows] for name, each in self._named().items()}
        return replace(self, labels=None, **chosen)  # large, and drawn already


def _stack_labels(people: Sequence[Observation]) -> torch.Tensor:
    """Label images (N, size, size), as large as the largest."""
    labels = [each.labels for each in people if each.labels is not None]
    sides = {each.shape[-1] for each in labels}
    if len(sides) > 1:
        labels = [resize_nearest(each, max(sides)) for each in labels]
    return torch.stack(labels)


@lru_cache(maxsize=256)
def _stacked_votes(people: StackedObservations) -> tuple[torch.Tensor, torch.Tensor]:
    """Votes of all landmarks, shape (N, ``LANDMARK_NAMES``), and the landmarks that the keypoints mark."""
    columns, parts = (
        torch.from_numpy(rows).to(people.points.device) for rows in _places(people.landmarks, people.marks)
    )
    sure = people.confidence.new_zeros(len(people), len(LANDMARK_NAMES))
    sure[:, columns] = people.confidence
    on_parts = torch.zeros_like(sure, dtype=torch.int64)
    on_parts[:, columns] = parts
    return split_votes(sure, on_parts), columns


def _places(landmarks: tuple[str, ...], body_points: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Place of each keypoint in ``LANDMARK_NAMES``, and its part, shape (L,) each."""
    columns = np.array([LANDMARK_NAMES.index(name) for name in body_points], dtype=np.int64)
    return columns, landmark_points(landmarks).parts[:, 0].astype(np.int64)
