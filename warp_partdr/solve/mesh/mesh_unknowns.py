"""Starts of the mesh stage, what is known of B people before it begins, and the numbers that it looks for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import torch

from ...interop.movable import Movable
from ...models.clothes import CLOTHED
from .steps import Tensors

# Of shape values, whose variance is 1, and of thicknesses [m], against radians and half-sides of the crop.
SHAPE_RATE, CLOTHES_RATE = 5.0, 0.3


@dataclass(frozen=True)
class Starts(Tensors):
    """Starts and observations of B people.

    Attributes:
        rotations: Of the drawn model's joints, where the stage starts, shape (B, J, 3, 3).
        translation: Of its root [m], shape (B, 3).
        shape: Shape values, shape (B, S).
        log_scale: As of ``BodyParameters``, like ``shift``, shape (B,).
        shift: Shape (B, 2).
        places: Landmark of the model that each keypoint marks, shape (B, L), int64.
        points: Keypoints in the crop, from -1 to 1, shape (B, L, 2).
        votes: Their weights, 0 of those that a person has not, shape (B, L).
        depths: Of ``JOINT_NAMES`` but the pelvis at the start, relative to it [m], shape (B, 20).
        depth_spreads: How sure these are [m], shape (B, 20).
        turn_spreads: How sure the turn of each free joint is [rad], shape (B, N).
        target: Labels of the crop as it is drawn, shape (B, size, size), uint8; None: without labels.
        borders: Of the labels, their lengths [px], shape (B,); None: without labels.
        lens: As of ``Observation``, shape (B, 3); None: weak perspective.
    """

    rotations: torch.Tensor
    translation: torch.Tensor
    shape: torch.Tensor
    log_scale: torch.Tensor
    shift: torch.Tensor
    places: torch.Tensor
    points: torch.Tensor
    votes: torch.Tensor
    depths: torch.Tensor
    depth_spreads: torch.Tensor
    turn_spreads: torch.Tensor
    target: torch.Tensor | None
    borders: torch.Tensor | None
    lens: torch.Tensor | None


@dataclass(frozen=True, eq=False)
class Unknowns(Movable):
    """Numbers that the stage looks for, of B people.

    Attributes:
        turns: Of the free joints, as rotation vectors [rad], shape (B, N, 3).
        shape: Shape values, shape (B, S).
        clothes: Thicknesses on parts ``CLOTHED``, before bounds [m], shape (B, 8).
        log_scale: As of ``BodyParameters``, like ``shift``, shape (B,).
        shift: Shape (B, 2).
    """

    turns: torch.Tensor
    shape: torch.Tensor
    clothes: torch.Tensor
    log_scale: torch.Tensor
    shift: torch.Tensor

    @classmethod
    def moved(cls, people: Starts, moves: torch.Tensor) -> Unknowns:
        """Numbers of people who moved from where the stage starts, by rows of all numbers, shape (B, R)."""
        batch, joints = people.turn_spreads.shape
        sizes = [3 * joints, people.shape.shape[1], len(CLOTHED), 1, 2]
        turns, shape, clothes, log_scale, shift = moves.split(sizes, dim=1)
        return cls(
            turns.view(batch, joints, 3),
            people.shape + shape,
            clothes,
            people.log_scale + log_scale[:, 0],
            people.shift + shift,
        )

    @staticmethod
    def rates(people: Starts) -> torch.Tensor:
        """Learning rates of their moves, relative to that of angles [rad] and camera [half-sides], shape (B, R)."""
        like, joints = people.shape, people.turn_spreads.shape[1]
        sizes = (3 * joints, 1.0), (like.shape[1], SHAPE_RATE), (len(CLOTHED), CLOTHES_RATE), (3, 1.0)
        return torch.cat([like.new_full((len(like), count), rate) for count, rate in sizes], dim=1)


class Posing(Protocol):
    """Poses from which a stage starts: ``rotations`` and ``translation`` as of ``Starts``."""

    @property
    def rotations(self) -> torch.Tensor:
        """Rotations of the drawn model's joints, shape (B, J, 3, 3)."""

    @property
    def translation(self) -> torch.Tensor:
        """Position of the drawn model's root joint [m], shape (B, 3)."""
