"""What was seen of N people side by side, as the captured refinement reads it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import torch

from ..body.landmarks import landmark_points
from ..body.template import NUM_PARTS
from ..inputs.observation import Observation, resize_nearest
from .energy import Energy, stack_depth_scales
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

    @classmethod
    def of(cls, people: Sequence[Observation], energy: Energy) -> Batch:
        """Of people; what an observation leaves open is as in an energy of one of them, of whose kind all are."""
        device = people[0].points.device
        counts = [len(each.landmarks) for each in people]
        person = torch.from_numpy(np.repeat(np.arange(len(people)), counts)).to(device)
        columns, parts = (
            torch.from_numpy(np.concatenate(rows)).to(device)
            for rows in zip(*(_places(each.landmarks, each.body_points) for each in people), strict=True)
        )
        confidence = torch.cat([each.confidence for each in people])
        # Those of a part share its vote, for ten of a face say little more than one.
        shared = confidence.new_zeros(len(people), NUM_PARTS)
        shared.view(-1).scatter_add_(0, person * NUM_PARTS + parts, confidence)
        votes = confidence.new_zeros(len(people), len(LANDMARK_NAMES))
        votes[person, columns] = confidence / shared.clamp_min(1.0)[person, parts]
        points = confidence.new_zeros(*votes.shape, 2)
        points[person, columns] = torch.cat([each.points for each in people])

        def stacked(name: str, usual: torch.Tensor) -> torch.Tensor:
            own = [getattr(each, name) for each in people]
            return torch.stack([usual if each is None else each for each in own])

        return cls(
            points=points,
            votes=votes,
            lengths=stacked("lengths", energy.usual_lengths),
            thicknesses=stacked("thicknesses", energy.usual_thicknesses),
            depths=stacked("depths", confidence.new_zeros(NUM_PARTS)),
            depth_scales=stack_depth_scales([each.depth_spreads for each in people], device),
            lenses=stacked("lens", confidence.new_zeros(3)),
            targets=None if energy.target is None else _targets(people, energy.size),
            seen=frozenset(name for each in people for name in each.body_points),
        )

    def __len__(self) -> int:
        """N."""
        return len(self.votes)

    def select(self, rows: torch.Tensor | slice) -> Batch:
        """Some of the people; one may come several times."""
        return replace(self, **{name: each[rows] for name, each in vars(self).items() if torch.is_tensor(each)})


def _targets(people: Sequence[Observation], size: int) -> torch.Tensor:
    labels = [each.labels for each in people if each.labels is not None]
    if len({each.shape for each in labels}) > 1:
        return torch.stack([resize_nearest(each, size) for each in labels])
    return resize_nearest(torch.stack(labels), size)


@lru_cache(maxsize=256)
def _places(landmarks: tuple[str, ...], body_points: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Place of each keypoint in ``LANDMARK_NAMES``, and its part, shape (L,) each."""
    columns = np.array([LANDMARK_NAMES.index(name) for name in body_points], dtype=np.int64)
    return columns, landmark_points(landmarks).parts[:, 0].astype(np.int64)
