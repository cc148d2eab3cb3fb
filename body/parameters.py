"""Parameters of a batch of bodies and of their cameras that a fit optimises, as torch tensors."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, fields, replace
from typing import Literal, overload

import torch

from ..cameras import WeakPerspective
from ..errors import check_whole
from ..interop.checks import check_numbers, check_tensor
from ..interop.device_cache import device_cache
from ..interop.movable import Movable
from .posing import Posed, pose_parts
from .rotations import rotation_from_6d
from .template import BODY_SHAPES, BODY_SIZES, LOCKED_PARTS, NUM_PARTS, template

ROW: dict[str, tuple[int, ...]] = {  # shape of one body's parameters, in the order of the fields
    "orientation": (6,),
    "rotations": (NUM_PARTS, 3),
    "lengths": BODY_SHAPES["lengths"],
    "thicknesses": BODY_SHAPES["thicknesses"],
    "log_scale": (),
    "shift": (2,),
}

LOCKED_BITS = sum(1 << part for part in LOCKED_PARTS)


def resized_numbers(
    lengths: torch.Tensor, thicknesses: torch.Tensor, log_scale: torch.Tensor, shares: torch.Tensor
) -> dict[str, torch.Tensor]:
    """Numbers of bodies that are enlarged by factors (B,) and as much farther away, by name of ``BodyParameters``."""
    return {
        "lengths": lengths * shares[:, None],
        "thicknesses": thicknesses * shares[:, None],
        "log_scale": log_scale - shares.log(),
    }


@dataclass(frozen=True)
class BodyParameters(Movable):
    """B bodies, each seen by a weak-perspective camera in a square crop of side 2 (coordinates -1 to 1).

    Attributes:
        orientation: Global orientation, 6D, camera frame, shape (B, 6).
        rotations: Local rotations as axis-angle [rad], shape (B, 20, 3); those of the hips stay 0.
        lengths: Lengths ``LENGTH_NAMES`` [m], shape (B, 12).
        thicknesses: Thicknesses ``THICKNESS_NAMES`` [m], shape (B, 15).
        log_scale: Logarithm of the crop's half-sides a metre, shape (B,).
        shift: Position of the pelvis in the crop, shape (B, 2).

    Raises:
        ValueError: If a shape or dtype is wrong, or they differ in dtype or device.

    Examples:
        >>> from dataclasses import replace
        >>> from warp_partdr import BodyParameters
        >>> body = BodyParameters.mean(1)
        >>> taller = replace(body, lengths=1.1 * body.lengths)
        >>> taller.posed().joints.shape
        torch.Size([1, 21, 3])
        >>> taller.camera(256).project(taller.posed().joints).shape  # u [px], v [px], z [m] in a crop of 256 px
        torch.Size([1, 21, 3])
    """

    orientation: torch.Tensor
    rotations: torch.Tensor
    lengths: torch.Tensor
    thicknesses: torch.Tensor
    log_scale: torch.Tensor
    shift: torch.Tensor

    def __post_init__(self) -> None:
        check_tensor("log_scale", self.log_scale, (None,), dtypes=(torch.float32, torch.float64))
        for name, shape in ROW.items():
            value = getattr(self, name)
            like = ("log_scale", self.log_scale)
            check_tensor(name, value, (self.batch_size, *shape), dtypes=(torch.float32, torch.float64), like=like)

    def check_finite(self) -> None:
        """Raise ValueError for NaN, infinity, numbers too large, sizes or scales of 0 or less; waits for the device."""
        scale = "exp(log_scale)"
        check_numbers({**self.tensors(), scale: self.log_scale.exp()}, positive=("lengths", "thicknesses", scale))

    @classmethod
    def mean(cls, batch_size: int, *, device: torch.device | str = "cpu") -> BodyParameters:
        """Mean adults in the rest pose, upright, facing the camera, 2 m high in the crop.

        Examples:
            >>> from warp_partdr import BodyParameters
            >>> BodyParameters.mean(4).rotations.shape
            torch.Size([4, 20, 3])
        """
        batch_size = check_whole("batch_size", batch_size, 0)
        constants = template()
        facing = torch.tensor([1.0, 0.0, 0.0, 0.0, -1.0, 0.0], device=device)
        lengths, thicknesses = (
            torch.tensor(values, dtype=torch.float32, device=device).repeat(batch_size, 1)
            for values in (constants.mean_lengths, constants.mean_thicknesses)
        )
        return cls(
            orientation=facing.repeat(batch_size, 1),
            rotations=torch.zeros(batch_size, NUM_PARTS, 3, device=device),
            lengths=lengths,
            thicknesses=thicknesses,
            log_scale=torch.zeros(batch_size, device=device),
            shift=torch.zeros(batch_size, 2, device=device),
        )

    @property
    def batch_size(self) -> int:
        """Number of bodies, B."""
        return self.log_scale.shape[0]

    def global_orient(self) -> torch.Tensor:
        """Global orientation as matrices, shape (B, 3, 3)."""
        return rotation_from_6d(self.orientation)

    def free_rotations(self) -> torch.Tensor:
        """Local rotations with the locked ones at zero, shape (B, 20, 3)."""
        return self.rotations * _free_parts(self.rotations.device)

    def posed(self) -> Posed:
        """Posed bodies in the camera frame, pelvis at the origin [m]."""
        origin = self.lengths.new_zeros(self.batch_size, 3)
        return pose_parts(self.orientation, origin, self.rotations, self.lengths, self.thicknesses, locked=LOCKED_BITS)

    def camera(self, size: int) -> WeakPerspective:
        """Cameras for a crop of ``size`` pixels a side."""
        return crop_camera(self.log_scale, self.shift, size)

    def resized(self, shares: torch.Tensor) -> BodyParameters:
        """Bodies that are enlarged by factors (B,) and as much farther away. Cameras see the same."""
        return replace(self, **resized_numbers(self.lengths, self.thicknesses, self.log_scale, shares))

    def select(self, index: torch.Tensor | slice) -> BodyParameters:
        """Select some of the bodies, by an index tensor or a slice."""
        return BodyParameters(**{name: tensor[index] for name, tensor in self.tensors().items()})

    def split(self) -> list[BodyParameters]:
        """Each of the bodies alone, B = 1, which takes less time than to select one after the other."""
        return [BodyParameters(*own) for own in zip(*(each.split(1) for each in self.tensors().values()), strict=True)]

    @classmethod
    def joined(cls, those: Sequence[BodyParameters]) -> BodyParameters:
        """Join the bodies of several batches in one batch."""
        rows = [each.tensors() for each in those]
        return cls(**{name: torch.cat([row[name] for row in rows]) for name in ROW})

    @overload
    def leaves(self, frozen: Collection[str] = ...) -> BodyParameters: ...

    @overload
    def leaves(self, frozen: Collection[str] = ..., *, log_sizes: Literal[False]) -> BodyParameters: ...

    @overload
    def leaves(self, frozen: Collection[str] = ..., *, log_sizes: Literal[True]) -> BodyLeaves: ...

    def leaves(self, frozen: Collection[str] = (), *, log_sizes: bool = False) -> BodyParameters | BodyLeaves:
        """Detached copies that collect gradients, but for the frozen ones.

        Args:
            frozen: Names of parameters that collect none.
            log_sizes: Lengths and thicknesses as logarithms: no step of an optimiser makes them 0 or less. Otherwise
                steps must be checked, or bounded as ``refine`` does: of a size that is 0 or less, an unchecked draw
                and its loss are NaN.

        Raises:
            ValueError: If ``frozen`` names something else, or with ``log_sizes`` a size is NaN, infinite or not
                positive; to know, that waits for the device.

        Examples:
            >>> from warp_partdr import BodyParameters
            >>> leaves = BodyParameters.mean(1).leaves(frozen=("lengths", "thicknesses"))
            >>> leaves.rotations.requires_grad, leaves.lengths.requires_grad
            (True, False)
        """
        _check_frozen(frozen)
        copies = {name: tensor.detach().clone() for name, tensor in self.tensors().items()}
        if not log_sizes:
            return BodyParameters(**{name: copy.requires_grad_(name not in frozen) for name, copy in copies.items()})
        check_numbers({name: copies[name] for name in BODY_SIZES}, positive=BODY_SIZES)
        for name in BODY_SIZES:
            copies[name].log_()
        free = {name: copy.requires_grad_(name not in frozen) for name, copy in copies.items()}
        return BodyLeaves(**{f"log_{name}" if name in BODY_SIZES else name: copy for name, copy in free.items()})

    @staticmethod
    def free(frozen: Collection[str]) -> tuple[str, ...]:
        """Names of the parameters that are not frozen.

        Raises:
            ValueError: If ``frozen`` names something else, or all of them.
        """
        _check_frozen(frozen)
        if not (free := tuple(name for name in ROW if name not in frozen)):
            raise ValueError("frozen: all parameters; expected at least one to be free")
        return free

    def detach(self) -> BodyParameters:
        """Detached copy, sharing memory."""
        return BodyParameters(**{name: tensor.detach() for name, tensor in self.tensors().items()})

    def tensors(self) -> dict[str, torch.Tensor]:
        """Tensors by name."""
        return {name: getattr(self, name) for name in ROW}


@dataclass(frozen=True)
class BodyLeaves(Movable):
    """B bodies as an optimiser may move them: sizes are logarithms, so that they stay positive.

    ``BodyParameters.leaves(log_sizes=True)`` makes them. A step of a logarithm is a share of the size: 0.01 is 1 %.

    Attributes:
        orientation: Global orientation as in ``BodyParameters``, 6D, shape (B, 6).
        rotations: Local rotations as axis-angle [rad], shape (B, 20, 3).
        log_lengths: Logarithms of lengths in metres, shape (B, 12).
        log_thicknesses: Logarithms of thicknesses in metres, shape (B, 15).
        log_scale: Logarithm of the crop's half-sides for each metre, shape (B,).
        shift: Position of the pelvis in the crop, shape (B, 2).

    Examples:
        >>> import torch
        >>> from warp_partdr import BodyLeaves, BodyParameters
        >>> leaves: BodyLeaves = BodyParameters.mean(1).leaves(log_sizes=True)
        >>> optimizer = torch.optim.Adam(leaves.tensors().values(), lr=0.02)
        >>> leaves.bodies().posed().joints.square().sum().backward()
        >>> optimizer.step()
        >>> leaves.log_lengths.grad.shape
        torch.Size([1, 12])
    """

    orientation: torch.Tensor
    rotations: torch.Tensor
    log_lengths: torch.Tensor
    log_thicknesses: torch.Tensor
    log_scale: torch.Tensor
    shift: torch.Tensor

    def bodies(self) -> BodyParameters:
        """Make the bodies of these numbers; gradients flow back through them.

        They must be made anew after each step of the optimiser: bodies of an earlier step keep their old sizes.
        """
        return BodyParameters(
            orientation=self.orientation,
            rotations=self.rotations,
            lengths=self.log_lengths.exp(),
            thicknesses=self.log_thicknesses.exp(),
            log_scale=self.log_scale,
            shift=self.shift,
        )

    def tensors(self) -> dict[str, torch.Tensor]:
        """Tensors by name, for an optimiser."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


def _check_frozen(frozen: Collection[str]) -> None:
    """Raise ValueError unless these are names of parameters."""
    if isinstance(frozen, str) or (unknown := [name for name in frozen if name not in ROW]):
        raise ValueError(f"frozen: {frozen if isinstance(frozen, str) else unknown}; expected some of {tuple(ROW)}")


@device_cache(8)
def _free_parts(device: torch.device) -> torch.Tensor:
    """0 for each locked part, 1 for the others, shape (20, 1)."""
    with torch.inference_mode(False):  # kept for calls outside of it, too
        return torch.tensor([[float(part not in LOCKED_PARTS)] for part in range(NUM_PARTS)], device=device)


def crop_camera(log_scale: torch.Tensor, shift: torch.Tensor, size: int) -> WeakPerspective:
    """Cameras for a crop of ``size`` pixels a side, from ``log_scale`` (B,) and ``shift`` (B, 2)."""
    half = size / 2
    return WeakPerspective(log_scale.exp() * half, (shift + 1) * half)
