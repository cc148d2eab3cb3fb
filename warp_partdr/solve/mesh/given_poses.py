"""Poses from which a mesh stage starts, where they are given: of the whole model, whose joints it turns but some of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from ...interop.movable import Movable
from ...models.registration import Registered


@dataclass(frozen=True, eq=False)
class GivenPoses(Movable):
    """Poses of the whole model, of which a stage turns some joints against the next such joint above.

    Attributes:
        shape: Shape values, shape (B, S).
        rotations: Local rotations of all joints, shape (B, J, 3, 3).
        translation: Position of the root joint [m], shape (B, 3).
        world: Rotations of all joints from rest, shape (B, J, 3, 3).
        turning: Joints that the stage turns, the root first, shape (N,), int64.
        above: Of these but the root, the next one above, shape (N - 1,), int64.
        parents: Of these but the root, the joint above, shape (N - 1,), int64.
    """

    shape: torch.Tensor
    rotations: torch.Tensor
    translation: torch.Tensor
    world: torch.Tensor
    turning: torch.Tensor
    above: torch.Tensor
    parents: torch.Tensor

    @classmethod
    def of(cls, bodies: Sequence[Registered], turning: torch.Tensor) -> GivenPoses:
        """Collect the poses of bodies of one model, whose joints ``turning`` the stage turns."""
        model, kept = bodies[0].model, turning.tolist()
        parents = [model.parents[joint] for joint in kept[1:]]
        above = list(parents)
        for place in range(len(above)):
            while above[place] not in kept:
                above[place] = model.parents[above[place]]
        poses = ("shape", "rotations", "translation")
        shape, rotations, translation = (torch.cat([getattr(each, name) for each in bodies]) for name in poses)
        world = torch.cat([each.detailed.transforms[..., :3, :3] for each in bodies])
        indices = (torch.tensor(each, device=turning.device) for each in (above, parents))
        return cls(shape, rotations, translation, world, turning, *indices)

    def turning_rotations(self) -> torch.Tensor:
        """Rotations of the joints that turn, of the model without the others, shape (B, N, 3, 3)."""
        local = self.world[:, self.above].mT @ self.world[:, self.turning[1:]]
        return torch.cat([self.rotations[:, :1], local], dim=1)

    def whole(self, turning: torch.Tensor) -> torch.Tensor:
        """Local rotations of all joints, shape (B, J, 3, 3), of those that turn, as ``turning_rotations`` has them."""
        between = self.world[:, self.above].mT @ self.world[:, self.parents]
        found = self.rotations.clone()
        found[:, 0] = turning[:, 0]
        found[:, self.turning[1:]] = between.mT @ turning[:, 1:]
        return found
