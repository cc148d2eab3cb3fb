"""Bodies in random poses to be timed, each compared with itself in a slightly different pose."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import torch

from ...body.labels import label_set
from ...body.parameters import BodyParameters
from ...body.pose_prior import packaged_prior
from ...body.posing import LandmarkGather, Posed
from ...body.skeletons import skeleton
from ...cameras import WeakPerspective
from ...inputs.observation import Observation
from ...render.ellipsoids import draw_ellipsoids
from ...render.options import Gradient
from ...render.renderers import RendererEllipsoids
from ...solve.ellipsoids.energy import Energy

LABELS = label_set("ellipbody20")
_BEND, _MOVE = 0.2, 0.1  # [rad] of each joint: from the rest pose, and from there to the target
_LOG_SCALE = -0.1  # so that a body covers a tenth of the picture


@dataclass(frozen=True)
class BenchScene:
    """B bodies and B targets."""

    bodies: BodyParameters  # starts of a refinement
    targets: torch.Tensor  # labels wanted of each body, shape (B, size, size), uint8
    points: torch.Tensor  # keypoints wanted of each body (COCO), -1 to 1, shape (B, 17, 2)
    size: int  # side of the picture [px]

    @classmethod
    def random(cls, batch_size: int, size: int, device: str) -> BenchScene:
        """Make random bodies and targets; they are equal for equal arguments, on any device."""
        generator = torch.Generator().manual_seed(0)
        mean = BodyParameters.mean(batch_size, device=device)

        def angles(spread: float) -> torch.Tensor:
            return spread * torch.randn(mean.rotations.shape, generator=generator).to(device)

        bodies = replace(mean, rotations=angles(_BEND), log_scale=torch.full_like(mean.log_scale, _LOG_SCALE))
        wanted = replace(bodies, rotations=bodies.rotations + angles(_MOVE))
        posed = wanted.posed()
        targets = draw_ellipsoids(posed, wanted.camera(size), (size, size)).labels
        gather = LandmarkGather(skeleton("coco17").landmarks, device)
        return cls(bodies, targets, wanted.camera(2).project(gather(posed))[..., :2] - 1, size)

    @property
    def batch_size(self) -> int:
        """Number of bodies, B."""
        return self.bodies.batch_size

    @cached_property
    def posed(self) -> Posed:
        """The bodies as they start."""
        return self.bodies.posed()

    @cached_property
    def camera(self) -> WeakPerspective:
        """Cameras of the bodies."""
        return self.bodies.camera(self.size)

    def energies(self, gradient: Gradient) -> list[Energy]:
        """The energy of each body."""
        names = skeleton("coco17").landmarks
        observation = Observation(names, self.points[0], torch.ones_like(self.points[0, :, 0]), self.targets[0], LABELS)
        first = Energy(
            observation,
            size=self.size,
            prior=packaged_prior(str(self.points.device)),
            renderer=RendererEllipsoids(gradient),
        )
        rest = zip(self.points[1:], self.targets[1:], strict=True)
        return [first, *(replace(first, observation=replace(observation, points=p, labels=t)) for p, t in rest)]
