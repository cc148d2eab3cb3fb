"""Given poses from which a mesh stage starts. They pose all joints of a model; the stage turns some of the joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from ...interop.movable import Movable
from ...models.registration import Registered


@dataclass(frozen=True, eq=False)
class GivenPoses(Movable):
    """Poses of the whole model. A mesh stage turns some of the joints, each relative to the next of these joints above.

    Attributes:
        shape: Shape values, shape (B, S).
        rotations: Local rotations of all joints, shape (B, J, 3, 3).
        translation: Position of the root joint [m], shape (B, 3).
        world: Rotations of all joints from the rest pose, in world axes, shape (B, J, 3, 3).
        turning: Joints that the stage turns, the root first, shape (N,), int64.
        above: Next joint of ``turning`` above each of them but the root, shape (N - 1,), int64.
        parents: Parent in the whole model of each of them but the root, shape (N - 1,), int64.
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
        """Collect the poses of B bodies of one model.

        Args:
            bodies: Bodies of the same model.
            turning: Joints that the stage turns, the root first, shape (N,), int64.
        """
        model = bodies[0].model
        kept = turning.tolist()
        parents = [model.parents[joint] for joint in kept[1:]]
        above = list(parents)
        for index in range(len(above)):
            while above[index] not in kept:
                above[index] = model.parents[above[index]]
        return cls(
            shape=torch.cat([each.shape for each in bodies]),
            rotations=torch.cat([each.rotations for each in bodies]),
            translation=torch.cat([each.translation for each in bodies]),
            world=torch.cat([each.detailed.transforms[..., :3, :3] for each in bodies]),
            turning=turning,
            above=torch.tensor(above, device=turning.device),
            parents=torch.tensor(parents, device=turning.device),
        )

    def turning_rotations(self) -> torch.Tensor:
        """Find the local rotations of the joints ``turning`` in a model without other joints, shape (B, N, 3, 3)."""
        local = self.world[:, self.above].mT @ self.world[:, self.turning[1:]]
        return torch.cat([self.rotations[:, :1], local], dim=1)

    def whole(self, turning: torch.Tensor) -> torch.Tensor:
        """Find the local rotations of all joints, shape (B, J, 3, 3); the inverse of ``turning_rotations``.

        Args:
            turning: Local rotations of the joints ``turning`` in a model without the others, shape (B, N, 3, 3).
        """
        between = self.world[:, self.above].mT @ self.world[:, self.parents]
        found = self.rotations.clone()
        found[:, 0] = turning[:, 0]
        found[:, self.turning[1:]] = between.mT @ turning[:, 1:]
        return found
