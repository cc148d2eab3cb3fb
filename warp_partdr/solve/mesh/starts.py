"""Starts of a fit of detailed bodies, what was observed of them, and the numbers that it looks for.

There are P people in T frames before V cameras: N = P T bodies, frames of a person in a row, and M = N V pictures of
bodies, views of a body in a row. Everybody has one shape, and a pose in each frame. The people are those of one scene,
or each is alone in a scene of one view and one frame, as in the mesh stage.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from ...models.clothes import CLOTHED
from .landmark_costs import LandmarkAims
from .tensors import NamedTensors
from .unknown_noise import border_lengths

# Of shape values, whose variance is 1, and of thicknesses [m], against radians and half-sides of the crop.
_SHAPE_RATE, _CLOTHES_RATE = 5.0, 0.3


@dataclass(frozen=True)
class WorldViews(NamedTensors):
    """V cameras that share a world, and the crops in which they see bodies.

    Attributes:
        rotations: World to camera, shape (V, 3, 3).
        translations: World to camera [m], shape (V, 3).
        crop_rotations: World to the camera in whose crop a body is placed, shape (N, 3, 3).
        crop_translations: World to that camera [m], shape (N, 3).
        focals: Focal lengths of the crops of ``REFERENCE_SIZE`` [px], shape (M, 2).
        centres: Their principal points [px], shape (M, 2).
        shown: Who is seen in each view, shape (N, V), bool.
    """

    rotations: torch.Tensor
    translations: torch.Tensor
    crop_rotations: torch.Tensor
    crop_translations: torch.Tensor
    focals: torch.Tensor
    centres: torch.Tensor
    shown: torch.Tensor


@dataclass(frozen=True)
class Slots(NamedTensors):
    """Places of people in the pictures of K clusters, C people at most in one.

    Attributes:
        lenses: Lenses of the pictures' crops, shape (K T V, 3).
        slots: As of ``PictureViews``, like ``places``, shape (K, C), int32.
        places: Shape (P, 2), int32.
    """

    lenses: torch.Tensor
    slots: torch.Tensor
    places: torch.Tensor


@dataclass(frozen=True)
class LabelPictures(NamedTensors):
    """Label pictures in which people are to be seen: one of each cluster of people in each frame and view.

    Attributes:
        target: Labels, shape (K T V, size, size), uint8; of a cluster's slots, slot G + group.
        borders: Lengths of the labels' borders [px], shape (K T V,).
        slots: Who is where; None: picture b shows body b in its own crop.
    """

    target: torch.Tensor
    borders: torch.Tensor
    slots: Slots | None = None

    @classmethod
    def of(cls, target: torch.Tensor, slots: Slots | None = None) -> LabelPictures:
        """Measure the borders of label pictures."""
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
        standing: How surely each body stands on it, shape (N,).
    """

    plane: torch.Tensor
    standing: torch.Tensor


@dataclass(frozen=True)
class Starts(NamedTensors):
    """Starts and observations of people.

    Attributes:
        rotations: Of the drawn model's joints where the fit starts, the root's in the world, shape (N, J, 3, 3).
        translation: From the pelvis to the root, in the world [m], shape (N, 3).
        shape: Shape values, shape (P, S).
        clothes: Thicknesses on parts ``CLOTHED``, before bounds [m], shape (P, 8).
        unknown: 1 for people whose shape and clothes are to be found, 0 for known ones, shape (P, 1).
        log_scale: Of the pelvis in the crop in which a body is placed, like ``shift`` as of ``BodyParameters``, (N,).
        shift: Shape (N, 2).
        lens: Of that crop as of ``Observation``, shape (N, 3); None: weak perspective.
        turn_variances: Squares of how sure the turn of each free joint is [rad^2], shape (N, F, 1).
        aims: Keypoints, and depths of ``JOINT_NAMES``, in the M pictures of bodies.
        views: Cameras of one scene; None: each body is in a scene of its own, whose world is its crop's camera.
        alone: Pictures of people who overlap nobody; None: without labels, or there are no such people.
        together: Pictures of people who overlap; None: without labels, or nobody does.
        smooth: Share of each frame in each frame's moves, shape (T, T); None: frames move for themselves.
        rates: 1 over the time from each frame to the next [1/s], 0 where nothing is known of feet between them, shape
            (T - 1,); None: it nowhere is.
        feet: The ground; None: no feet are held to any.
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
    together: LabelPictures | None = None
    smooth: torch.Tensor | None = None
    rates: torch.Tensor | None = None
    feet: StandingFeet | None = None

    @property
    def num_frames(self) -> int:
        """Number of frames, T."""
        return len(self.shift) // len(self.shape)

    @property
    def num_views(self) -> int:
        """Number of cameras, V."""
        return 1 if self.views is None else len(self.views.rotations)

    @property
    def people_in_scene(self) -> int:
        """Number of people who share a world."""
        return 1 if self.views is None else len(self.shape)

    def of_frames(self, values: torch.Tensor) -> torch.Tensor:
        """Values of people, each as often as there are frames."""
        return values if self.num_frames == 1 else values.repeat_interleave(self.num_frames, 0)

    def by_person(self, values: torch.Tensor) -> torch.Tensor:
        """Values of bodies (N, ...) as (P, T, ...)."""
        return values.unflatten(0, (len(self.shape), -1))

    def learning_rates(self) -> torch.Tensor:
        """Learning rates of all moves, relative to that of angles [rad] and camera [half-sides], shape (R,)."""
        bodies, shapes, clothes = self._sizes()
        sizes = (bodies, 1.0), (shapes, _SHAPE_RATE), (clothes, _CLOTHES_RATE)
        return torch.cat([self.shape.new_full((count,), rate) for count, rate in sizes])

    def moved(self, moves: torch.Tensor) -> Unknowns:
        """Numbers after these moves, (R,): turns, ``log_scale`` and ``shift`` of N bodies, the others of P people."""
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
        """Numbers where the fit starts."""
        return self.moved(torch.zeros_like(self.learning_rates()))

    def _sizes(self) -> list[int]:
        """Numbers of moves: of bodies, shapes and clothes."""
        bodies, joints = self.turn_variances.shape[:2]
        return [bodies * (3 * joints + 3), self.shape.numel(), len(self.shape) * len(CLOTHED)]


@dataclass(frozen=True, eq=False)
class Unknowns(NamedTensors):
    """Numbers that a fit looks for.

    Attributes:
        turns: Of the free joints, as rotation vectors [rad], shape (N, F, 3).
        shape: Shape values, shape (P, S).
        clothes: Thicknesses on parts ``CLOTHED``, before bounds [m], shape (P, 8).
        log_scale: As of ``BodyParameters``, like ``shift``, shape (N,).
        shift: Shape (N, 2).
    """

    turns: torch.Tensor
    shape: torch.Tensor
    clothes: torch.Tensor
    log_scale: torch.Tensor
    shift: torch.Tensor
