"""Keypoints of data sets whose joints lie elsewhere (``CONVENTIONS``), moved to the landmarks that networks know.

A network that sees a joint of Human3.6M's "neck" takes it for its own neck, 50 mm lower. How far the two lie apart in
the picture depends on the body's pose. So a first look gives the body, and the keypoints are moved by what lies between
both points of that body as they are seen. Networks learn from COCO's own points, which stay.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch

from ...body.landmarks import CONVENTIONS
from ...inputs.observation import Observation
from ...inputs.stacked import StackedObservations
from .predicted import Predicted, landmarks_in_crop


def lies_elsewhere(marks: Sequence[str]) -> bool:
    """True if some of the points are joints of a data set whose place networks did not learn."""
    return any(mark.startswith(tuple(f"{convention}_" for convention in CONVENTIONS)) for mark in marks)


def keypoints_at_landmarks(
    observations: Sequence[Observation] | StackedObservations, predicted: Predicted
) -> Sequence[Observation] | StackedObservations | None:
    """Observations whose keypoints lie at the landmarks; None if all do already.

    Args:
        observations: N people.
        predicted: The bodies of a first look, as a camera along its axis would see them.
    """
    if isinstance(observations, StackedObservations):
        if not lies_elsewhere(observations.marks):
            return None
        moves = _moves(observations.landmarks, observations.marks, predicted, observations.lens)
        return replace(observations, points=observations.points - moves)
    rows = [row for row, each in enumerate(observations) if lies_elsewhere(each.body_points)]
    if not rows:
        return None
    moved = list(observations)
    for row in rows:
        observation = observations[row]
        lens = None if observation.lens is None else observation.lens[None]
        moves = _moves(observation.landmarks, observation.body_points, predicted.select(slice(row, row + 1)), lens)
        moved[row] = replace(observation, points=observation.points - moves[0])
    return moved


def _moves(
    landmarks: tuple[str, ...], marks: tuple[str, ...], predicted: Predicted, lenses: torch.Tensor | None
) -> torch.Tensor:
    """Ways from landmarks to marks as bodies are seen, shape (N, L, 2)."""
    return landmarks_in_crop(predicted, marks, lenses) - landmarks_in_crop(predicted, landmarks, lenses)
