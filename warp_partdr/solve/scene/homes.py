"""Bodies of a scene where a fit starts, each in the crop of the view that sees the person surest.

Their turns are means of what all views say, and their pelvises lie where the views' rays meet.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from ...body.lens import seen_at, through_lens
from ...body.parameters import BodyParameters
from ...body.rotations import nearest_rotation, rotation_from_axis_angle, rotation_to_6d, rotation_to_axis_angle
from ...inputs.observation import REFERENCE_SIZE
from ...inputs.scene import Scene, View
from ..mesh.observed_body import ObservedBody
from ..mesh.placed_people import pelvises_in_world

_NEAREST = 0.1  # [m], of a pelvis before its camera


@dataclass(frozen=True)
class CameraPoses:
    """Poses of cameras.

    Attributes:
        rotations: World to camera, shape (V, 3, 3).
        translations: World to camera [m], shape (V, 3).
    """

    rotations: torch.Tensor
    translations: torch.Tensor

    @classmethod
    def of(cls, views: Sequence[View], like: torch.Tensor) -> CameraPoses:
        """Collect the poses of views, of the dtype and on the device of ``like``."""
        rotations, translations = (
            torch.stack([getattr(view, name) for view in views]).to(like) for name in ("rotation", "translation")
        )
        return cls(rotations, translations)

    def select(self, index: torch.Tensor) -> CameraPoses:
        """Select some of the cameras, by an index tensor."""
        return CameraPoses(self.rotations[index], self.translations[index])


@dataclass(frozen=True)
class HomeBodies:
    """Bodies of P people in T frames, N = P T, each in the crop of its home.

    Attributes:
        body: The bodies, as the crops' cameras see them.
        looks: Index of the look whose crop is the home, shape (N,), int64.
        cameras: Cameras of the homes.
        lenses: Lenses of the crops, shape (N, 3).
    """

    body: BodyParameters
    looks: torch.Tensor
    cameras: CameraPoses
    lenses: torch.Tensor

    def smoothed(self, shares: torch.Tensor) -> HomeBodies:
        """Bodies whose pelvises move smoothly in the world, by the shares of frames in each frame, (P, T, T)."""
        body, cameras = self.body, self.cameras
        world = pelvises_in_world(body.log_scale, body.shift, self.lenses, cameras.rotations, cameras.translations)
        smooth = (shares @ world.unflatten(0, (len(shares), -1))).flatten(0, 1)
        there = (smooth[:, None] @ cameras.rotations.mT)[:, 0] + cameras.translations
        there = torch.cat([there[:, :2], there[:, 2:].clamp_min(_NEAREST)], dim=1)
        log_scale, shift = seen_at(there, self.lenses)
        return replace(self, body=replace(body, log_scale=log_scale, shift=shift))


def find_homes(scene: Scene, looks: Sequence[ObservedBody], cameras: CameraPoses) -> HomeBodies:
    """Put together what all views say of each body, in the crop of its home.

    Args:
        scene: The scene.
        looks: Of ``look_at``.
        cameras: Cameras of the scene's views.
    """
    index = _home_looks(scene, looks)
    homes = [looks[each] for each in index]
    views = torch.tensor([home.sight.view for home in homes], device=cameras.rotations.device)
    lenses = torch.stack([home.observation.lens for home in homes if home.observation.lens is not None])
    body = _join_bodies(scene, looks, homes, cameras)
    return HomeBodies(body, torch.tensor(index, device=views.device), cameras.select(views), lenses)


def _home_looks(scene: Scene, looks: Sequence[ObservedBody]) -> list[int]:
    """Index of the look in whose crop each body is placed: of the view that sees the person surest in all frames.

    Smooth moves are smooth in one view alone. Where nobody sees a person, the look is of the nearest frame.
    """
    sure: defaultdict[tuple[int, int], float] = defaultdict(float)
    for look in looks:
        sure[look.sight.person, look.sight.view] += float(look.evidence.keypoints.confidence.sum())
    best: dict[tuple[int, int], int] = {}
    for index, look in enumerate(looks):
        person, key = look.sight.person, (look.sight.person, look.sight.frame)
        if key not in best or sure[person, look.sight.view] > sure[person, looks[best[key]].sight.view]:
            best[key] = index
    homes: list[int] = []
    for person in range(scene.num_people):
        seen = np.array([frame for each, frame in best if each == person])
        for frame in range(scene.num_frames):
            homes.append(best[person, int(seen[np.abs(seen - frame).argmin()])])
    return homes


def _join_bodies(
    scene: Scene, looks: Sequence[ObservedBody], homes: Sequence[ObservedBody], cameras: CameraPoses
) -> BodyParameters:
    """Bodies in their home crops; those of a person have one size."""
    bodies: list[BodyParameters] = []
    of_body: dict[tuple[int, int], list[ObservedBody]] = {}
    for look in looks:
        of_body.setdefault((look.sight.person, look.sight.frame), []).append(look)
    for person in range(scene.num_people):
        mine = BodyParameters.joined([look.body for look in looks if look.sight.person == person])
        lengths, thicknesses = mine.lengths.mean(0, keepdim=True), mine.thicknesses.mean(0, keepdim=True)
        for home in homes[person * scene.num_frames : (person + 1) * scene.num_frames]:
            body = replace(home.body, lengths=lengths, thicknesses=thicknesses)
            group = of_body[home.sight.person, home.sight.frame]
            bodies.append(_met(body, home, group, cameras) if len(group) > 1 else body)
    return BodyParameters.joined(bodies)


def _met(
    body: BodyParameters, home: ObservedBody, group: Sequence[ObservedBody], cameras: CameraPoses
) -> BodyParameters:
    """A body that several views see, in its home crop."""
    here, rotations = home.sight.view, cameras.rotations
    world = [rotations[look.sight.view].mT @ look.body.global_orient() for look in group]
    orientation = rotations[here] @ _mean_rotation(torch.cat(world))
    local = torch.cat([rotation_from_axis_angle(look.body.rotations) for look in group])
    pelvis = rotations[here] @ _meeting_point(group, cameras) + cameras.translations[here]
    lens = home.observation.lens
    assert lens is not None
    if pelvis[2] > _NEAREST:  # else rays do not meet before the camera
        log_scale, shift = seen_at(pelvis[None], lens[None])
        body = replace(body, log_scale=log_scale, shift=shift)
    return replace(
        body,
        orientation=rotation_to_6d(orientation)[None],
        rotations=rotation_to_axis_angle(_mean_rotation(local.transpose(0, 1)))[None],
    )


def _mean_rotation(rotations: torch.Tensor) -> torch.Tensor:
    """Chordal mean of rotations (..., N, 3, 3), shape (..., 3, 3)."""
    return nearest_rotation(rotations.mean(-3))


def _meeting_point(group: Sequence[ObservedBody], cameras: CameraPoses) -> torch.Tensor:
    """The point that is nearest to the rays through the pelvises, shape (3,) [m]."""
    normal, right = cameras.rotations.new_zeros(3, 3), cameras.rotations.new_zeros(3)
    eye = torch.eye(3).to(normal)
    for look in group:
        _, pelvis = through_lens(look.body.camera(REFERENCE_SIZE), look.observation.lens, REFERENCE_SIZE)
        assert pelvis is not None
        turn, move = cameras.rotations[look.sight.view], cameras.translations[look.sight.view]
        ray = turn.mT @ torch.nn.functional.normalize(pelvis[0], dim=0)
        across = eye - ray[:, None] * ray
        # A little of the distance that the view alone gives, for rays may be parallel.
        along = 1e-3 * eye
        normal = normal + across + along
        right = right - across @ (turn.mT @ move) + along @ (turn.mT @ (pelvis[0] - move))
    return torch.linalg.solve(normal, right)
