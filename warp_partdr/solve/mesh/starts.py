"""Starts and observations of a fit of detailed bodies, and the unknown numbers that it finds.

There are P people in T frames before V cameras: N = P T bodies, where the frames of a person follow one another, and
M = N V pictures of bodies, where the views of a body follow one another. Each person has one shape, and a pose in each
frame. The people are those of one scene; or, as in the mesh stage, each is alone in a scene of one view and one frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from ...models.clothes import CLOTHED
from .landmark_costs import LandmarkAims
from .tensors import NamedTensors
from .unknown_noise import border_lengths

# Learning rates of shape values, whose variance is 1, and of thicknesses of clothes [m], relative to that of angles
# [rad] and of the camera [half-sides of the crop].
_SHAPE_RATE = 5.0
_CLOTHES_RATE = 0.3


@dataclass(frozen=True)
class WorldViews(NamedTensors):
    """V cameras that share a world, and the crops in which they see bodies.

    Attributes:
        rotations: World to camera, shape (V, 3, 3).
        translations: World to camera [m], shape (V, 3).
        crop_rotations: World to the camera in whose crop a body is placed, shape (N, 3, 3).
        crop_translations: World to that camera [m], shape (N, 3).
        focals: Focal lengths of the crops of ``REFERENCE_SIZE`` [px], shape (M, 2).
        centres: Principal points of these crops [px], shape (M, 2).
        observed: True if a view shows a body, shape (N, V), bool.
    """

    rotations: torch.Tensor
    translations: torch.Tensor
    crop_rotations: torch.Tensor
    crop_translations: torch.Tensor
    focals: torch.Tensor
    centres: torch.Tensor
    observed: torch.Tensor


@dataclass(frozen=True)
class Slots(NamedTensors):
    """Slots of people in the pictures of K clusters, at most C people in one.

    Attributes:
        lenses: Lenses of the pictures' crops, shape (K T V, 3).
        slots: Person in each slot of each cluster, -1 for an empty slot, shape (K, C), int32.
        person_slots: Cluster and slot of each person, -1 for people in no cluster, shape (P, 2), int32.
    """

    lenses: torch.Tensor
    slots: torch.Tensor
    person_slots: torch.Tensor


@dataclass(frozen=True)
class LabelPictures(NamedTensors):
    """Label pictures that the drawn people are compared with: one of each cluster in each frame and view.

    Attributes:
        target: Labels, shape (K T V, size, size), uint8. A label of slot s is s G + group, for a label set of G groups.
        borders: Lengths of the labels' borders [px], shape (K T V,).
        slots: Slots of people in the pictures; None: picture b shows body b in its own crop.
    """

    target: torch.Tensor
    borders: torch.Tensor
    slots: Slots | None = None

    @classmethod
    def of(cls, target: torch.Tensor, slots: Slots | None = None) -> LabelPictures:
        """Make label pictures from labels, whose borders are measured."""
        return cls(target, border_lengths(target), slots)

    @property
    def size(self) -> int:
        """Side of the crops [px]."""
        return self.target.shape[-1]


@dataclass(frozen=True)
class StandingFeet(NamedTensors):
    """Ground that feet are held to.

    Attributes:
        plane: Normal and offset [m] of the ground in the world, shape (4,).
        standing: Confidence that each body stands on the ground, shape (N,).
    """

    plane: torch.Tensor
    standing: torch.Tensor


@dataclass(frozen=True)
class Starts(NamedTensors):
    """Starts and observations of people.

    Attributes:
        rotations: Local rotations of the drawn model's joints where the fit starts; the root's is in the world, shape
            (N, J, 3, 3).
        translation: Vector from the pelvis to the root, in the world [m], shape (N, 3).
        shape: Shape values, shape (P, S).
        clothes: Thicknesses on parts ``CLOTHED``, before bounds [m], shape (P, 8).
        unknown: Number 1 for people whose shape and clothes are to be found, 0 for people with a known shape, shape
            (P, 1).
        log_scale: Logarithms of the scale at the pelvises in the crops in which the bodies are placed, as in
            ``BodyParameters``, shape (N,).
        shift: Positions of the pelvises in these crops, as in ``BodyParameters`` [half-sides of the crop], shape
            (N, 2).
        lens: Lenses of these crops, as in ``Observation``, shape (N, 3); None: weak perspective.
        turn_variances: Squared uncertainty of the turn of each free joint [rad^2], shape (N, F, 1).
        aims: Keypoints, and depths of ``JOINT_NAMES``, in the M pictures of bodies.
        views: Cameras of one scene; None: each body is in a scene of its own, whose world is its crop's camera.
        alone: Pictures of people who overlap nobody; None if there are no labels, or no people of this kind.
        overlapping: Pictures of people who overlap; None if there are no labels, or no people of this kind.
        smooth: Share of each frame in the moves of each frame, shape (T, T); None: the frames move independently.
        rates: Inverse of the time from each frame to the next [1/s], shape (T - 1,). It is 0 if nothing is known of
            feet between the two frames; None if that holds for all frames.
        feet: Ground that feet are held to; None: no feet are held.
    """

    rotations: torch.Tensor
    translation: torch.Tensor
    shape: torch.Tensor
    clothes: torch.Tensor
    unknown: torch.Tensor
    log_scale: torch.Tensor
    shift: torch.Tensor
    lens: torch.Tensor | None
    turn_variances: torch.Tensor
    aims: LandmarkAims
    views: WorldViews | None = None
    alone: LabelPictures | None = None
    overlapping: LabelPictures | None = None
    smooth: torch.Tensor | None = None
    rates: torch.Tensor | None = None
    feet: StandingFeet | None = None

    @property
    def num_frames(self) -> int:
        """Number of frames, T."""
        return len(self.shift) // len(self.shape)

    @property
    def num_views(self) -> int:
        """Number of cameras, V, which is 1 in a batch of people."""
        return 1 if self.views is None else len(self.views.rotations)

    @property
    def people_in_scene(self) -> int:
        """Number of people who share a world, which is 1 in a batch of people."""
        return 1 if self.views is None else len(self.shape)

    def of_frames(self, values: torch.Tensor) -> torch.Tensor:
        """Repeat the values of people (P, ...) for their frames, shape (N, ...)."""
        return values if self.num_frames == 1 else values.repeat_interleave(self.num_frames, 0)

    def by_person(self, values: torch.Tensor) -> torch.Tensor:
        """Reshape the values of bodies (N, ...) to (P, T, ...)."""
        return values.unflatten(0, (len(self.shape), -1))

    def learning_rates(self) -> torch.Tensor:
        """List the learning rates of all moves, relative to that of angles and of the camera, shape (R,)."""
        rates = 1.0, _SHAPE_RATE, _CLOTHES_RATE
        return torch.cat(
            [self.shape.new_full((count,), rate) for count, rate in zip(self._sizes(), rates, strict=True)]
        )

    def moved(self, moves: torch.Tensor) -> Unknowns:
        """Apply moves to the numbers where the fit starts.

        Args:
            moves: Changes of turns, ``log_scale`` and ``shift`` of N bodies, then of shapes and clothes of P people,
                shape (R,).
        """
        bodies, shape, clothes = moves.split(self._sizes())
        rows = bodies.view(len(self.shift), -1)
        if self.smooth is not None:
            rows = (self.smooth @ self.by_person(rows)).flatten(0, 1)
        turns, log_scale, shift = rows.split([rows.shape[1] - 3, 1, 2], dim=1)
        return Unknowns(
            turns.unflatten(1, (-1, 3)),
            torch.addcmul(self.shape, self.unknown, shape.view_as(self.shape)),
            torch.addcmul(self.clothes, self.unknown, clothes.view_as(self.clothes)),
            self.log_scale + log_scale.squeeze(1),
            self.shift + shift,
        )

    def at_rest(self) -> Unknowns:
        """Unknowns where the fit starts."""
        return self.moved(torch.zeros_like(self.learning_rates()))

    def _sizes(self) -> list[int]:
        """Count the moves: those of bodies, of shapes and of clothes."""
        bodies, joints = self.turn_variances.shape[:2]
        return [bodies * (3 * joints + 3), self.shape.numel(), len(self.shape) * len(CLOTHED)]


@dataclass(frozen=True, eq=False)
class Unknowns(NamedTensors):
    """Numbers that a fit finds.

    Attributes:
        turns: Turns of the free joints from their start, as rotation vectors [rad], shape (N, F, 3).
        shape: Shape values, shape (P, S).
        clothes: Thicknesses on parts ``CLOTHED``, before bounds [m], shape (P, 8).
        log_scale: Logarithms of the scale at the pelvises, as in ``BodyParameters``, shape (N,).
        shift: Positions of the pelvises in the crops, as in ``BodyParameters`` [half-sides of the crop], shape (N, 2).
    """

    turns: torch.Tensor
    shape: torch.Tensor
    clothes: torch.Tensor
    log_scale: torch.Tensor
    shift: torch.Tensor
