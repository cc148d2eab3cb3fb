"""Observations of N people as arrays, which networks and fits read; one person is a batch of one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import torch

from ..body.labels import LabelSet
from ..body.skeletons import Skeleton
from ..interop.movable import Movable
from .observation import Observation, resize_nearest

# Tensors of an ``Observation`` that all people of a batch have or all lack, apart from keypoints and pictures.
_EXPECTED = ("lens", "lengths", "thicknesses", "depths", "depth_uncertainties")
_PICTURES = ("labels", "maps", "known")
_KEYPOINTS = ("points", "confidence")


@dataclass(frozen=True, eq=False)
class Observations(Movable):
    """Observations of N people with keypoints of one format, and labels of one set, or none.

    Every optional field is given for all people or for none.

    Attributes:
        landmarks: Names of the format's J keypoints.
        marks: Point of the body that each keypoint marks.
        visible: True for visible keypoints, shape (N, J), bool; on the host.
        points: Positions of keypoints in crops of side 2, 0 where missing, shape (N, J, 2).
        confidence: Weights of keypoints, 0 where missing, shape (N, J).
        labels: Group ids in the crops, shape (N, size, size), uint8; None without labels.
        label_set: Meaning of the group ids.
        maps: Probability of each group, shape (N, G, size, size); None without probabilities.
        known: Weight of each pixel of ``maps``, shape (N, size, size).
        lens: Focal lengths and principal points of the cameras, shape (N, 3); None if they are unknown.
        lens_assumed: True if the lenses are usual ones, because the pictures' own are not known.
        lengths: Expected lengths [m], shape (N, 12); None: the mean adult's.
        thicknesses: Expected thicknesses [m], shape (N, 15); None: the mean adult's.
        depths: Expected depths of the parts' centres, pelvis at 0 [m], shape (N, 20); None: unknown.
        depth_uncertainties: Uncertainty of these depths [m], shape (N, 20); None: 1 mm.
        statures: Heights of the people [m], 0 where one is not known, shape (N,); None if none is known.
    """

    landmarks: tuple[str, ...]
    marks: tuple[str, ...]
    visible: np.ndarray
    points: torch.Tensor
    confidence: torch.Tensor
    labels: torch.Tensor | None = None
    label_set: LabelSet | None = None
    maps: torch.Tensor | None = None
    known: torch.Tensor | None = None
    lens: torch.Tensor | None = None
    lens_assumed: bool = False
    lengths: torch.Tensor | None = None
    thicknesses: torch.Tensor | None = None
    depths: torch.Tensor | None = None
    depth_uncertainties: torch.Tensor | None = None
    statures: torch.Tensor | None = None

    @classmethod
    def of(cls, observations: Sequence[Observation], form: Skeleton | None = None) -> Observations:
        """Build a batch. All observations must have the same optional fields.

        Args:
            observations: List of N observations.
            form: Format of the keypoints. None: the landmarks are all those that occur in these observations.

        Raises:
            ValueError: If the observations differ in their label set, or in which optional fields they have.
        """
        _check_same_fields(observations)
        first, device = observations[0], observations[0].points.device
        marks = _marks_of(observations) if form is None else dict(zip(form.landmarks, form.marks, strict=True))
        landmarks = tuple(marks)
        columns = [_indices(each.landmarks, landmarks) for each in observations]
        visible = np.zeros((len(observations), len(landmarks)), dtype=bool)
        for row, own in enumerate(columns):
            visible[row, own] = True
        people = torch.from_numpy(np.repeat(np.arange(len(observations)), [len(own) for own in columns])).to(device)
        joints = torch.from_numpy(np.concatenate(columns)).to(device)
        points = torch.zeros(*visible.shape, 2, device=device)
        points[people, joints] = torch.cat([each.points for each in observations])
        confidence = torch.zeros(visible.shape, device=device)
        confidence[people, joints] = torch.cat([each.confidence for each in observations])
        return cls(
            landmarks,
            tuple(marks.values()),
            visible,
            points,
            confidence,
            label_set=first.label_set,
            lens_assumed=first.lens_assumed,
            statures=_statures(observations),
            **{name: _stacked(_at_one_side([getattr(each, name) for each in observations])) for name in _PICTURES},
            **{name: _stacked([getattr(each, name) for each in observations]) for name in _EXPECTED},
        )

    @classmethod
    def joined(cls, parts: Sequence[Observations]) -> Observations:
        """Join batches, one after the other. All must have the same optional fields."""
        if len(parts) == 1:
            return parts[0]
        statures = None
        if any(each.statures is not None for each in parts):
            statures = torch.cat([each._all_statures() for each in parts])
        return replace(
            parts[0],
            visible=np.concatenate([each.visible for each in parts]),
            statures=statures,
            **{name: _joined([getattr(each, name) for each in parts]) for name in _KEYPOINTS},
            **{name: _joined(_at_one_side([getattr(each, name) for each in parts])) for name in _PICTURES},
            **{name: _joined([getattr(each, name) for each in parts]) for name in _EXPECTED},
        )

    def __len__(self) -> int:
        """Number of people, N."""
        return len(self.visible)

    def __getitem__(self, row: int) -> Observation:
        """Return one person's observation."""
        visible = self.visible[row].nonzero()[0]
        columns: slice | torch.Tensor = slice(None)  # if all are visible: no copy, and no transfer to the device
        if len(visible) < len(self.landmarks):
            columns = torch.from_numpy(visible).to(self.points.device)
        return Observation(
            landmarks=tuple(self.landmarks[column] for column in visible),
            marks=tuple(self.marks[column] for column in visible),
            points=self.points[row, columns],
            confidence=self.confidence[row, columns],
            label_set=self.label_set,
            lens_assumed=self.lens_assumed,
            stature=None if self.statures is None else float(self.statures[row]) or None,
            **self._each_at(row, (*_PICTURES, *_EXPECTED)),
        )

    def select(self, rows: slice | torch.Tensor) -> Observations:
        """Return the observations of some of the people; a person may be chosen several times."""
        visible = self.visible[rows.cpu().numpy() if torch.is_tensor(rows) else rows]
        return replace(self, visible=visible, **self._each_at(rows, _ROWS))

    def without_pictures(self) -> Observations:
        """Return a copy without labels and probabilities, which are large; their label set stays."""
        return replace(self, labels=None, maps=None, known=None)

    def _each_at(self, rows: int | slice | torch.Tensor, names: Sequence[str]) -> dict[str, Any]:
        """Rows of the tensors with these names; None for a tensor that the batch lacks."""
        return {name: None if (each := getattr(self, name)) is None else each[rows] for name in names}

    def _all_statures(self) -> torch.Tensor:
        return self.confidence.new_zeros(len(self)) if self.statures is None else self.statures


_ROWS = (*_KEYPOINTS, *_PICTURES, *_EXPECTED, "statures")  # all tensors, a row a person


def _statures(observations: Sequence[Observation]) -> torch.Tensor | None:
    if all(each.stature is None for each in observations):
        return None
    return torch.tensor([each.stature or 0.0 for each in observations], device=observations[0].points.device)


def _stacked(rows: Sequence[torch.Tensor | None]) -> torch.Tensor | None:
    known = [each for each in rows if each is not None]
    if len(known) == 1:
        return known[0][None]  # no copy
    return torch.stack(known) if known else None


def _joined(parts: Sequence[torch.Tensor | None]) -> Any:
    known = [each for each in parts if each is not None]
    return torch.cat(known) if known else None


def _at_one_side(pictures: Sequence[torch.Tensor | None]) -> list[torch.Tensor | None]:
    """Pictures (..., size, size), all resized to the largest one's side."""
    side = max((each.shape[-1] for each in pictures if each is not None), default=0)
    return [each if each is None or each.shape[-1] == side else resize_nearest(each, side) for each in pictures]


def _marks_of(observations: Sequence[Observation]) -> dict[str, str]:
    """All landmarks that occur in the observations, with their marks."""
    return {name: mark for each in observations for name, mark in zip(each.landmarks, each.body_points, strict=True)}


@lru_cache(maxsize=1024)
def _indices(names: tuple[str, ...], landmarks: tuple[str, ...]) -> np.ndarray:
    """Indices of names among landmarks, shape (L,)."""
    return np.array([landmarks.index(name) for name in names], dtype=np.int64)


def _check_same_fields(observations: Sequence[Observation]) -> None:
    """Raise ValueError unless observations can be in one batch."""
    first = observations[0]
    for each in observations[1:]:
        for name in (*_PICTURES, *_EXPECTED):
            if (getattr(each, name) is None) != (getattr(first, name) is None):
                raise ValueError(f"observations: some with {name}, some without; expected the same of all")
        if each.label_set is not first.label_set and each.label_set != first.label_set:
            raise ValueError("observations: of two label sets; expected one")
        if each.lens_assumed != first.lens_assumed:
            raise ValueError("observations: some lenses are assumed, others known; expected the same of all")


def batch_observations(observations: Sequence[Observation]) -> list[tuple[list[int], Observations]]:
    """Build batches of observations that can be in one batch, and return the indices of each beside it.

    In a batch, landmarks have the same marks, labels have one set and one size, and all observations have the same
    optional fields.
    """
    groups: list[list[int]] = []
    for index, each in enumerate(observations):
        own = next((rows for rows in groups if _fit_in_batch(observations[rows[0]], each)), None)
        if own is None:
            groups.append([index])
        else:
            own.append(index)
    return [(rows, Observations.of([observations[row] for row in rows])) for rows in groups]


def _shapes(observations: Observation) -> list[torch.Size | None]:
    tensors = [getattr(observations, name) for name in (*_PICTURES, *_EXPECTED)]
    return [None if each is None else each.shape for each in tensors]


def _fit_in_batch(one: Observation, other: Observation) -> bool:
    marks, others = _marks_of([one]), _marks_of([other])
    return (
        _shapes(one) == _shapes(other)
        and one.lens_assumed == other.lens_assumed
        and all(marks.get(name, mark) == mark for name, mark in others.items())
        and (one.label_set is other.label_set or one.label_set == other.label_set)
    )
