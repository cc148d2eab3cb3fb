"""Observations of many people as arrays of all, so that what looks at them side by side need not ask one by one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
import torch

from ..body.labels import LabelSet
from ..interop.movable import Movable
from .keypoints import Keypoints2D
from .observation import Observation, resize_nearest


@dataclass(frozen=True, eq=False)
class StackedObservations(Movable):
    """Observations of N people with keypoints of one format, and labels of one set, or none.

    Attributes:
        landmarks: Names of the format's J keypoints.
        marks: Point of the body that each marks.
        visible: True for those that are there, shape (N, J), bool; on the host.
        points: Their positions in crops of side 2, 0 where missing, shape (N, J, 2).
        confidence: Their weights, 0 where missing, shape (N, J).
        labels: Group ids in the crops, shape (N, size, size), uint8; None without labels.
        label_set: What these mean.
        lens: As of ``Observation``, of all or of none, shape (N, 3).
        lens_assumed: As of ``Observation``, of all.
    """

    landmarks: tuple[str, ...]
    marks: tuple[str, ...]
    visible: np.ndarray
    points: torch.Tensor
    confidence: torch.Tensor
    labels: torch.Tensor | None
    label_set: LabelSet | None
    lens: torch.Tensor | None
    lens_assumed: bool = False

    @classmethod
    def of(cls, seen: Sequence[Observation], keypoints: Sequence[Keypoints2D]) -> StackedObservations:
        """Stack observations of people who are alike, of whose visible keypoints they are; without probabilities."""
        form, device = keypoints[0].format, seen[0].points.device
        visible = np.stack([each.visible for each in keypoints])
        person, column = (torch.from_numpy(index).to(device) for index in visible.nonzero())
        points = torch.zeros(*visible.shape, 2, device=device)
        points[person, column] = torch.cat([each.points for each in seen])
        confidence = torch.zeros(visible.shape, device=device)
        confidence[person, column] = torch.cat([each.confidence for each in seen])
        labels = [each.labels for each in seen if each.labels is not None]
        side = max((each.shape[-1] for each in labels), default=0)
        lenses = [each.lens for each in seen if each.lens is not None]
        return cls(
            form.landmarks,
            form.marks,
            visible,
            points,
            confidence,
            torch.stack([_at_side(each, side) for each in labels]) if labels else None,
            seen[0].label_set,
            torch.stack(lenses) if lenses else None,
            seen[0].lens_assumed,
        )

    @classmethod
    def joined(cls, parts: Sequence[StackedObservations]) -> StackedObservations:
        """Join observations that are alike, one after the other."""
        if len(parts) == 1:
            return parts[0]
        first = parts[0]
        labels = [each.labels for each in parts if each.labels is not None]
        side = max((each.shape[-1] for each in labels), default=0)
        lenses = [each.lens for each in parts if each.lens is not None]
        return replace(
            first,
            visible=np.concatenate([each.visible for each in parts]),
            points=torch.cat([each.points for each in parts]),
            confidence=torch.cat([each.confidence for each in parts]),
            labels=torch.cat([_at_side(each, side) for each in labels]) if labels else None,
            lens=torch.cat(lenses) if lenses else None,
        )

    def __len__(self) -> int:
        """Number of people, N."""
        return len(self.visible)

    def __getitem__(self, row: int) -> Observation:
        """One person's."""
        there = self.visible[row].nonzero()[0]
        columns: slice | torch.Tensor = slice(None)  # no copy, and nothing goes to the device, where all are there
        if len(there) < len(self.landmarks):
            columns = torch.from_numpy(there).to(self.points.device)
        return Observation(
            landmarks=tuple(self.landmarks[column] for column in there),
            marks=tuple(self.marks[column] for column in there),
            points=self.points[row, columns],
            confidence=self.confidence[row, columns],
            labels=None if self.labels is None else self.labels[row],
            label_set=self.label_set,
            lens=None if self.lens is None else self.lens[row],
            lens_assumed=self.lens_assumed,
        )

    def select(self, rows: slice | torch.Tensor) -> StackedObservations:
        """Some of the people's."""
        return replace(
            self,
            visible=self.visible[rows.cpu().numpy() if isinstance(rows, torch.Tensor) else rows],
            points=self.points[rows],
            confidence=self.confidence[rows],
            labels=None if self.labels is None else self.labels[rows],
            lens=None if self.lens is None else self.lens[rows],
        )


# One person as a fit sees them, or many: what a function is given, it returns.
Seen = TypeVar("Seen", Observation, StackedObservations)


def _at_side(labels: torch.Tensor, side: int) -> torch.Tensor:
    return labels if labels.shape[-1] == side else resize_nearest(labels, side)
