"""Observations of N people in the arrays that the captured refinement reads."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from ...body.template import NUM_PARTS
from ...interop.device_cache import device_cache
from .energy import Energy
from .tables import LANDMARK_NAMES


@dataclass(frozen=True)
class Batch:
    """Observations of N people.

    Attributes:
        points: Positions of ``LANDMARK_NAMES`` in crops of side 2, 0 where they are not observed, shape (N, L, 2).
        weights: Weights of the landmarks, 0 where they are not observed, shape (N, L).
        lengths: Expected lengths [m], shape (N, 12).
        thicknesses: Expected thicknesses [m], shape (N, 15).
        depths: Expected depths of the parts' centres [m], shape (N, 20); 0 if none are expected.
        depth_scales: Inverse of the uncertainty of the expected depths [1/m], shape (N, 20).
        lenses: Focal lengths and principal points in the crops' coordinates, shape (N, 3); 0 if there are no lenses.
        targets: Label images, shape (N, size, size), uint8; None if nothing is drawn.
        visible: Names of the landmarks that at least one person has.
    """

    points: torch.Tensor
    weights: torch.Tensor
    lengths: torch.Tensor
    thicknesses: torch.Tensor
    depths: torch.Tensor
    depth_scales: torch.Tensor
    lenses: torch.Tensor
    targets: torch.Tensor | None
    visible: frozenset[str]

    @classmethod
    def of(cls, energy: Energy) -> Batch:
        """Make the arrays from the observations of an energy."""
        people = energy.observations
        columns = _landmark_indices(people.marks, people.points.device)
        weights = people.points.new_zeros(len(people), len(LANDMARK_NAMES))
        weights[:, columns] = energy.landmark_weights
        points = weights.new_zeros(*weights.shape, 2)
        points[:, columns] = people.points
        return cls(
            points=points,
            weights=weights,
            lengths=energy.usual_lengths,
            thicknesses=energy.usual_thicknesses,
            depths=weights.new_zeros(len(people), NUM_PARTS) if energy.depths is None else energy.depths,
            depth_scales=energy.depth_scales,
            lenses=weights.new_zeros(len(people), 3) if people.lens is None else people.lens,
            targets=energy.target,
            visible=frozenset(np.array(people.marks)[people.visible.any(axis=0)].tolist()),
        )

    def __len__(self) -> int:
        """Number of people, N."""
        return len(self.weights)

    @property
    def graph_key(self) -> Hashable:
        """Key of a captured graph: one graph serves all batches with the same landmarks, arrays and shapes."""
        return self.visible, tuple((name, tuple(each.shape)) for name, each in self._named().items())

    def tensors(self) -> list[torch.Tensor]:
        """List all tensors of the batch."""
        return list(self._named().values())

    def copied(self) -> Batch:
        """Copy the batch with all its tensors."""
        return replace(self, **{name: each.clone() for name, each in self._named().items()})

    def _named(self) -> dict[str, Any]:
        return {name: each for name, each in vars(self).items() if torch.is_tensor(each)}

    def select(self, rows: torch.Tensor | slice) -> Batch:
        """Select some of the people; a person may come several times."""
        return replace(self, **{name: each[rows] for name, each in self._named().items()})


@device_cache(256)
def _landmark_indices(marks: tuple[str, ...], device: torch.device) -> torch.Tensor:
    """Index of each mark in ``LANDMARK_NAMES``, shape (L,)."""
    with torch.inference_mode(False):  # the cached tensor also serves calls outside of inference mode
        return torch.tensor([LANDMARK_NAMES.index(mark) for mark in marks], device=device)
