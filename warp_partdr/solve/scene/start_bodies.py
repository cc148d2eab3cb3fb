"""Bodies from which the fit of a scene starts, each in the crop of one view: its reference crop.

The reference crop comes from the view that shows the person with the highest confidence. A start has the mean of the
rotations that all views give, and its pelvis lies where the views' rays meet.
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

_NEAREST = 0.1  # [m], least depth of a pelvis in front of its camera


@dataclass(frozen=True)
class CameraPoses:
    """Poses of cameras.

    Attributes:
        rotations: Rotations, world to camera, shape (V, 3, 3).
        translations: Translations, world to camera [m], shape (V, 3).
    """

    rotations: torch.Tensor
    translations: torch.Tensor

    @classmethod
    def of(cls, views: Sequence[View], like: torch.Tensor) -> CameraPoses:
        """Collects the poses of views, with the dtype and the device of ``like``."""
        rotations = torch.stack([view.rotation for view in views]).to(like)
        translations = torch.stack([view.translation for view in views]).to(like)
        return cls(rotations, translations)

    def select(self, index: torch.Tensor) -> CameraPoses:
        """Selects some of the cameras by an index tensor."""
        return CameraPoses(self.rotations[index], self.translations[index])


@dataclass(frozen=True)
class StartBodies:
    """Bodies of P people in T frames, N = P T, each in its reference crop.

    Attributes:
        body: Bodies as the cameras of the reference crops see them.
        references: Index of the observed body whose crop is the reference crop, shape (N,), int64.
        cameras: Cameras of the views from which the reference crops come.
        lenses: Lenses of the reference crops, shape (N, 3).
    """

    body: BodyParameters
    references: torch.Tensor
    cameras: CameraPoses
    lenses: torch.Tensor

    def smoothed(self, shares: torch.Tensor) -> StartBodies:
        """Returns a copy in which pelvises move smoothly in the world.

        Args:
            shares: Shares of all frames in the smooth position of each frame, shape (P, T, T).
        """
        body = self.body
        cameras = self.cameras
        world = pelvises_in_world(body.log_scale, body.shift, self.lenses, cameras.rotations, cameras.translations)
        smooth = (shares @ world.unflatten(0, (len(shares), -1))).flatten(0, 1)
        pelvises = (smooth[:, None] @ cameras.rotations.mT)[:, 0] + cameras.translations
        pelvises = torch.cat([pelvises[:, :2], pelvises[:, 2:].clamp_min(_NEAREST)], dim=1)
        log_scale, shift = seen_at(pelvises, self.lenses)
        return replace(self, body=replace(body, log_scale=log_scale, shift=shift))


def find_start_bodies(scene: Scene, observed_bodies: Sequence[ObservedBody], cameras: CameraPoses) -> StartBodies:
    """Joins the predictions from all views about each body, in its reference crop.

    Args:
        scene: The scene.
        observed_bodies: Bodies that ``observe_scene`` returns.
        cameras: Cameras of the scene's views.
    """
    indices = _reference_indices(scene, observed_bodies)
    references = [observed_bodies[index] for index in indices]
    views = torch.tensor([reference.view for reference in references], device=cameras.rotations.device)
    lenses = [reference.observation.lens for reference in references if reference.observation.lens is not None]
    return StartBodies(
        body=_join_bodies(scene, observed_bodies, references, cameras),
        references=torch.tensor(indices, device=views.device),
        cameras=cameras.select(views),
        lenses=torch.stack(lenses),
    )


def _reference_indices(scene: Scene, observed_bodies: Sequence[ObservedBody]) -> list[int]:
    """Index of the observed body in whose crop each body is placed, for all people and frames.

    It comes from the view with the highest confidence over all frames, because smooth motion is smooth in a single view
    alone. Frames without an observation of the person take the one in the nearest frame.
    """
    totals: defaultdict[tuple[int, int], float] = defaultdict(float)
    for observed in observed_bodies:
        totals[observed.person, observed.view] += float(observed.evidence.keypoints.confidence.sum())
    best: dict[tuple[int, int], int] = {}
    for index, observed in enumerate(observed_bodies):
        person = observed.person
        key = (observed.person, observed.frame)
        if key not in best or totals[person, observed.view] > totals[person, observed_bodies[best[key]].view]:
            best[key] = index
    references: list[int] = []
    for person in range(scene.num_people):
        frames = np.array([frame for each, frame in best if each == person])
        for frame in range(scene.num_frames):
            references.append(best[person, int(frames[np.abs(frames - frame).argmin()])])
    return references


def _join_bodies(
    scene: Scene,
    observed_bodies: Sequence[ObservedBody],
    references: Sequence[ObservedBody],
    cameras: CameraPoses,
) -> BodyParameters:
    """Bodies in their reference crops. All bodies of a person have one size."""
    bodies: list[BodyParameters] = []
    groups: dict[tuple[int, int], list[ObservedBody]] = {}
    for observed in observed_bodies:
        groups.setdefault((observed.person, observed.frame), []).append(observed)
    for person in range(scene.num_people):
        own = BodyParameters.joined([observed.body for observed in observed_bodies if observed.person == person])
        lengths = own.lengths.mean(0, keepdim=True)
        thicknesses = own.thicknesses.mean(0, keepdim=True)
        for reference in references[person * scene.num_frames : (person + 1) * scene.num_frames]:
            body = replace(reference.body, lengths=lengths, thicknesses=thicknesses)
            group = groups[reference.person, reference.frame]
            bodies.append(_triangulated(body, reference, group, cameras) if len(group) > 1 else body)
    return BodyParameters.joined(bodies)


def _triangulated(
    body: BodyParameters, reference: ObservedBody, group: Sequence[ObservedBody], cameras: CameraPoses
) -> BodyParameters:
    """Returns a copy of a body that agrees with all views that show it, in its reference crop."""
    rotations = cameras.rotations
    world = [rotations[observed.view].mT @ observed.body.global_orient() for observed in group]
    orientation = rotations[reference.view] @ _mean_rotation(torch.cat(world))
    local = torch.cat([rotation_from_axis_angle(observed.body.rotations) for observed in group])
    pelvis = rotations[reference.view] @ _meeting_point(group, cameras) + cameras.translations[reference.view]
    lens = reference.observation.lens
    assert lens is not None
    if pelvis[2] > _NEAREST:  # otherwise the rays do not meet in front of the camera
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
    """Point that is nearest to the rays through the pelvises, shape (3,) [m]."""
    normal = cameras.rotations.new_zeros(3, 3)
    right = cameras.rotations.new_zeros(3)
    eye = torch.eye(3).to(normal)
    for observed in group:
        _, pelvis = through_lens(observed.body.camera(REFERENCE_SIZE), observed.observation.lens, REFERENCE_SIZE)
        assert pelvis is not None
        rotation = cameras.rotations[observed.view]
        translation = cameras.translations[observed.view]
        ray = rotation.mT @ torch.nn.functional.normalize(pelvis[0], dim=0)
        across = eye - ray[:, None] * ray
        # Rays may be parallel. So the distance that the view alone gives has a small weight.
        along = 1e-3 * eye
        normal = normal + across + along
        right = right - across @ (rotation.mT @ translation) + along @ (rotation.mT @ (pelvis[0] - translation))
    return torch.linalg.solve(normal, right)
