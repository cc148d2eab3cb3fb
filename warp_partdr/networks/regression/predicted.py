"""Output of the networks: the numbers of EllipBody and of its camera, rotations as matrices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch

from ...body.lens import place_bodies, turn_to_rays
from ...body.parameters import BodyParameters, crop_camera, resized_numbers
from ...body.posing import LandmarkGather, Posed, pose
from ...body.rotations import replayed_axis_angles, rotation_to_6d
from ...cameras import WeakPerspective
from ...interop.device_cache import device_cache
from ...render.ellipsoids import draw_ellipsoids
from .uncertainty import Uncertainty

_SIDE = 2  # of a crop from -1 to 1


@dataclass(frozen=True)
class Predicted:
    """B bodies in crops of side 2, as ``BodyParameters`` has them, seen by a camera that looks at their pelvis."""

    orientation: torch.Tensor  # global orientation, camera frame, shape (B, 3, 3)
    rotations: torch.Tensor  # local rotations; those of the hips are the identity, shape (B, 20, 3, 3)
    lengths: torch.Tensor  # ``LENGTH_NAMES`` [m], shape (B, 12)
    thicknesses: torch.Tensor  # ``THICKNESS_NAMES`` [m], shape (B, 15)
    log_scale: torch.Tensor  # logarithm of the crop's half-sides a metre, shape (B,)
    shift: torch.Tensor  # position of the pelvis in the crop, shape (B, 2)
    uncertainty: Uncertainty | None = None  # of the label network

    def posed(self) -> Posed:
        """Posed bodies in the camera frame, pelvis at the origin [m], differentiable."""
        pelvis = self.lengths.new_zeros(len(self.lengths), 3)
        return pose(self.orientation, pelvis, self.rotations, self.lengths, self.thicknesses, validate=False)

    def camera(self, size: int) -> WeakPerspective:
        """Cameras for a crop of ``size`` pixels a side."""
        return crop_camera(self.log_scale, self.shift, size)

    def resized(self, shares: torch.Tensor) -> Predicted:
        """Bodies that are enlarged by factors (B,) and as much farther away. Cameras see the same."""
        said = None if self.uncertainty is None else self.uncertainty.resized(shares)
        numbers = resized_numbers(self.lengths, self.thicknesses, self.log_scale, shares)
        return replace(self, uncertainty=said, **numbers)

    def select(self, index: torch.Tensor | slice) -> Predicted:
        """Some of the bodies."""
        chosen = {name: value[index] for name, value in vars(self).items() if isinstance(value, torch.Tensor)}
        said = self.uncertainty
        return Predicted(**chosen, uncertainty=None if said is None else said.select(index))

    @classmethod
    def joined(cls, parts: Sequence[Predicted]) -> Predicted:
        """Join the bodies of several batches, of one network, in one batch."""
        names = [name for name, value in vars(parts[0]).items() if isinstance(value, torch.Tensor)]
        numbers = {name: torch.cat([getattr(each, name) for each in parts]) for name in names}
        said = [each.uncertainty for each in parts if each.uncertainty is not None]
        return cls(**numbers, uncertainty=Uncertainty.joined(said) if said else None)

    def with_rows(self, rows: torch.Tensor, other: Predicted) -> Predicted:
        """Bodies of which those at ``rows``, shape (N,), are N others."""
        chosen = {
            name: value.index_copy(0, rows, getattr(other, name))
            for name, value in vars(self).items()
            if isinstance(value, torch.Tensor)
        }
        said, again = self.uncertainty, other.uncertainty
        both = None if said is None or again is None else said.with_rows(rows, again)
        return replace(self, **chosen, uncertainty=both)

    def drawn(self, size: int) -> torch.Tensor:
        """Part labels of the bodies in their crops, shape (B, size, size), uint8."""
        return draw_ellipsoids(self.posed(), self.camera(size), (size, size), validate=False).labels

    def parameters(self) -> BodyParameters:
        """Parameters for a fit, detached."""
        return BodyParameters(
            orientation=rotation_to_6d(self.orientation),
            rotations=replayed_axis_angles(self.rotations),
            lengths=self.lengths,
            thicknesses=self.thicknesses,
            log_scale=self.log_scale,
            shift=self.shift,
        ).detach()


def posed_landmarks(posed: Posed, names: tuple[str, ...]) -> torch.Tensor:
    """Landmarks of posed bodies, shape (B, L, 3) [m]."""
    return _gather(names, posed.joints.device)(posed)


def landmarks_in_crop(predicted: Predicted, names: tuple[str, ...], lenses: torch.Tensor | None) -> torch.Tensor:
    """Landmarks of predicted bodies as their crops' lenses (B, 3) show them, from -1 to 1, shape (B, L, 2)."""
    bodies = predicted.parameters()
    if lenses is not None:
        bodies = turn_to_rays(bodies, lenses)
    posed, camera = place_bodies(bodies, bodies.posed(), lenses, _SIDE)
    return camera.project(posed_landmarks(posed, names))[..., :2] - _SIDE / 2


@device_cache(8)
def _gather(names: tuple[str, ...], device: torch.device) -> LandmarkGather:
    with torch.inference_mode(False):  # kept for calls outside of it, too
        return LandmarkGather(names, device)
