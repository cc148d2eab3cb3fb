"""Poses of cameras that nobody calibrated, found from the people in their pictures.

Two pictures that were taken at the same time show a person in one pose. The joints that the label network predicts from
both give the rotation between the cameras (Procrustes), and the pelvises give the translation. Then the poses are
refined until the rays through the same keypoint meet as well as the keypoints are known (Sampson's distance; Hartley
and Zisserman, Multiple View Geometry, 2nd ed., section 11.4.3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import torch

from ..body.landmarks import annotated
from ..body.lens import placed_at
from ..body.rotations import nearest_rotation, rotation_from_axis_angle, skew
from ..body.stature import check_stature
from ..body.template import MEAN_STATURE
from ..errors import InputError
from ..inputs.scene import Scene, View
from ..interop.gradient_mode import with_gradients
from ..interop.torch_threads import one_torch_thread
from ..networks.regression.landmarks import LANDMARKS, network_keypoints
from ..networks.regression.predicted import posed_landmarks
from ..solve.mesh.observed_body import ObservedBody
from ..solve.scene.clip_sizes import with_common_size
from ..solve.scene.observations import observe_scene

# Chosen on PartBench's people 0 to 39 and clips 0 to 7 in front of two cameras, by
# ``python -m warp_partdr.lab camera-places``.
_KEYPOINT_DEVIATION = 0.02  # standard deviation of keypoints [person's height]
_FAR = 3.0  # standard deviations, from which on a keypoint counts less and less (Geman and McClure, 1987)
_JOINT_DEVIATION = 0.05  # standard deviation between the network's joints in two views [m]
_PELVIS_DEVIATION = 0.1  # standard deviation of the positions of pelvises, as a share of their depth
_ENOUGH = 8  # instants; with more, the mean error of the network is not smaller, because its errors last for a while
_STEPS = 60  # largest number of L-BFGS steps


def place_cameras(
    scene: Scene,
    *,
    observed_bodies: Sequence[ObservedBody] | None = None,
    stature: float | None = None,
    device: torch.device | str = "cpu",
) -> Scene:
    """Finds the poses of a scene's cameras from the people in it.

    Rotations and translations of all views but the first are replaced. The scale of the world follows from the sizes
    that the network predicts for people, or from the known stature.

    Args:
        scene: People in several views. At least one person must be visible in two views at once.
        observed_bodies: Bodies that ``observe_scene`` returned on the same device. They do not depend on the poses of
            the cameras. If it is None, ``observe_scene`` is called.
        stature: Height of the only person, standing [m].
        device: Device to run on, "cpu" or a CUDA device.

    Returns:
        The scene with new views, in the world of its first view.

    Raises:
        InputError: If views share no person in a frame, or a stature is given for several people.

    Examples:
        With ``seen_left`` and ``seen_right``, ``Keypoints2D`` of one person in two pictures of one moment:

        >>> from warp_partdr import Perspective, Scene, SceneObservation, View, place_cameras
        >>> view = View(Perspective.of_picture((480, 640), focal=560.0))
        >>> scene = Scene([view, view], [SceneObservation(seen_left, view=0), SceneObservation(seen_right, view=1)])
        >>> placed = place_cameras(scene, stature=1.75)
        >>> placed.views[1].rotation.shape, placed.views[1].eye.shape  # where the second camera stands
        (torch.Size([3, 3]), torch.Size([3]))
    """
    stature = check_stature(stature)
    if stature is not None and scene.num_people > 1:
        raise InputError(f"stature: {stature:g} m, for {scene.num_people} people; expected one person")
    if len(scene.views) == 1:
        return scene
    if observed_bodies is None:
        observed_bodies = observe_scene(scene, device)
    people = PeopleInViews.of(scene, observed_bodies, stature)
    poses = people.refined(people.chained())
    return replace(scene, views=poses.applied_to(scene.views))


@dataclass(frozen=True)
class RelativePoses:
    """Poses of V cameras relative to the first one: X_camera = R X_first + t.

    Attributes:
        rotations: Rotations R, shape (V, 3, 3), float64.
        translations: Translations t [m], shape (V, 3), float64.
        energy: Energy that is left, half of the mean squared deviation of a pair of rays, in standard deviations.
    """

    rotations: torch.Tensor
    translations: torch.Tensor
    energy: float = 0.0

    def applied_to(self, views: Sequence[View]) -> list[View]:
        """Returns copies of views that have these poses relative to the first view, which keeps its pose."""
        rotation = views[0].rotation.double()
        translation = views[0].translation.double()
        placed: list[View] = []
        for view, relative, offset in zip(views, self.rotations, self.translations, strict=True):
            moved = (relative @ translation + offset).float()
            placed.append(replace(view, rotation=(relative @ rotation).float(), translation=moved))
        return placed


@dataclass(frozen=True)
class PeopleInViews:
    """People in V views, float64. Each of M instants is one person in one frame.

    Attributes:
        rays: Directions of keypoints, as points at depth 1, shape (V, M, L, 2).
        confidence: Confidence of the keypoints, 0 for missing ones, shape (V, M, L).
        landmarks: Landmarks that the network predicts, relative to the pelvis, in camera coordinates [m], shape
            (V, M, L, 3).
        pelvises: Positions of the pelvis in camera coordinates [m], shape (V, M, 3).
        visible: True if a view shows the person in the frame, shape (V, M).
    """

    rays: torch.Tensor
    confidence: torch.Tensor
    landmarks: torch.Tensor
    pelvises: torch.Tensor
    visible: torch.Tensor

    @classmethod
    def of(cls, scene: Scene, observed_bodies: Sequence[ObservedBody], stature: float | None = None) -> PeopleInViews:
        """Collects the observed bodies of a scene, and gives each person one size."""
        observed_bodies = with_common_size(scene, observed_bodies, stature)
        instants = sorted({(observed.person, observed.frame) for observed in observed_bodies})
        columns = {instant: column for column, instant in enumerate(instants)}
        num_views = len(scene.views)
        num_instants = len(columns)
        rays = torch.zeros(num_views, num_instants, len(LANDMARKS), 2, dtype=torch.float64)
        confidence = torch.zeros(num_views, num_instants, len(LANDMARKS), dtype=torch.float64)
        landmarks = torch.zeros(num_views, num_instants, len(LANDMARKS), 3, dtype=torch.float64)
        pelvises = torch.zeros(num_views, num_instants, 3, dtype=torch.float64)
        visible = torch.zeros(num_views, num_instants, dtype=torch.bool)
        for observed in observed_bodies:
            cell = observed.view, columns[observed.person, observed.frame]
            crop = observed.observation
            lens = observed.observation.lens
            assert lens is not None
            keypoints = network_keypoints(crop.landmarks, crop.points, crop.confidence)
            rays[cell] = ((keypoints[:, :2] - lens[1:].to(keypoints)) / lens[0].to(keypoints)).double().cpu()
            confidence[cell] = keypoints[:, 2].double().cpu()
            landmarks[cell] = posed_landmarks(observed.body.posed(), annotated(LANDMARKS))[0].double().cpu()
            pelvises[cell] = placed_at(observed.body.log_scale, observed.body.shift, lens[None])[0].double().cpu()
            visible[cell] = True
        return cls(rays, confidence, landmarks, pelvises, visible)

    @property
    def num_views(self) -> int:
        """Number of views, V."""
        return len(self.visible)

    @property
    def num_common(self) -> int:
        """Number of instants that at least two views share."""
        return int((self.visible.sum(0) > 1).sum())

    def pose_difference(self, poses: RelativePoses) -> float:
        """Mean squared distance between the network's joints in two views of an instant [m^2]."""
        pairs = self._pairs
        rotations = poses.rotations[pairs.second] @ poses.rotations[pairs.first].mT
        return float(self._distances(rotations)[pairs.visible].mean())

    def chained(self) -> RelativePoses:
        """Poses from the network's bodies alone. Each view is placed by the placed view that shares most instants.

        Raises:
            InputError: If a view shares no instant with another one.
        """
        common = (self.visible[:, None] & self.visible).sum(-1)
        placed = {0: (torch.eye(3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64))}
        while len(placed) < self.num_views:
            pairs = [(one, other) for one in placed for other in range(self.num_views) if other not in placed]
            one, other = max(pairs, key=lambda pair: int(common[pair]))
            if not common[one, other]:
                raise InputError(
                    f"views[{other}]: shows nobody when others do; expected views that were taken at the same time"
                )
            placed[other] = self._pose_beside(one, other, *placed[one])
        rotations = torch.stack([placed[view][0] for view in range(self.num_views)])
        translations = torch.stack([placed[view][1] for view in range(self.num_views)])
        return RelativePoses(rotations, translations)

    def _pose_beside(
        self, one: int, other: int, rotation: torch.Tensor, translation: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Rotation and translation of the other view, from those of a view that is placed already."""
        both = self.visible[one] & self.visible[other]
        correlation = torch.einsum("mli,mlj->ij", self.landmarks[other, both], self.landmarks[one, both])
        relative = nearest_rotation(correlation)
        offsets = self.pelvises[other, both] - self.pelvises[one, both] @ relative.mT
        return relative @ rotation, relative @ translation + offsets.median(0).values

    @one_torch_thread()
    @with_gradients()
    def refined(self, start: RelativePoses) -> RelativePoses:
        """Poses for which rays of keypoints meet and the network's bodies agree, near a start."""
        numbers = torch.zeros(self.num_views - 1, 6, dtype=torch.float64, requires_grad=True)

        def poses() -> tuple[torch.Tensor, torch.Tensor]:
            rotations = rotation_from_axis_angle(numbers[:, :3]) @ start.rotations[1:]
            translations = start.translations[1:] + numbers[:, 3:]
            return torch.cat([start.rotations[:1], rotations]), torch.cat([start.translations[:1], translations])

        def step() -> torch.Tensor:
            optimizer.zero_grad()
            energy = self.energy(*poses())
            energy.backward()
            return energy

        optimizer = torch.optim.LBFGS([numbers], max_iter=_STEPS, line_search_fn="strong_wolfe")
        optimizer.step(step)
        with torch.no_grad():
            rotations, translations = poses()
            energy = float(self.energy(rotations, translations) / self._pairs.confidence.sum().clamp_min(1e-9))
        return RelativePoses(rotations, translations, energy)

    def energy(self, rotations: torch.Tensor, translations: torch.Tensor) -> torch.Tensor:
        """Half of the squared deviations, in standard deviations, summed over pairs of views.

        Args:
            rotations: Rotations of the cameras relative to the first one, shape (V, 3, 3).
            translations: Translations of the cameras [m], shape (V, 3).
        """
        one = self._pairs.first
        other = self._pairs.second
        turns = rotations[other] @ rotations[one].mT
        moves = translations[other] - (turns @ translations[one][..., None])[..., 0]
        rays = torch.cat([self.rays, torch.ones_like(self.rays[..., :1])], dim=-1)
        essential = skew(moves) @ turns
        across = torch.einsum("pij,pmlj->pmli", essential, rays[one])
        back = torch.einsum("pji,pmlj->pmli", essential, rays[other])
        variances = (_KEYPOINT_DEVIATION * MEAN_STATURE / self.pelvises[..., 2].clamp_min(1e-3)).square()[..., None]
        variance = across[..., :2].square().sum(-1) * variances[other] + back[..., :2].square().sum(-1) * variances[one]
        meeting = (rays[other] * across).sum(-1).square() / variance.clamp_min(1e-12)
        meeting = self._pairs.confidence * meeting / (1 + meeting / _FAR**2)
        bodies = self._distances(turns) / _JOINT_DEVIATION**2
        apart = self.pelvises[one] @ turns.mT + moves[:, None] - self.pelvises[other]
        apart = (apart / (_PELVIS_DEVIATION * self.pelvises[other][..., 2:]).clamp_min(1e-3)).square().sum(-1)
        weights = (_ENOUGH / self._pairs.visible.sum(1).clamp_min(1)).clamp_max(1.0)
        agreement = weights[:, None] * torch.where(self._pairs.visible, bodies + apart, 0.0)
        return 0.5 * (meeting.sum() + agreement.sum())

    def _distances(self, turns: torch.Tensor) -> torch.Tensor:
        """Mean squared distances of landmarks in pairs of views after a rotation (P, 3, 3), shape (P, M) [m^2]."""
        one = self._pairs.first
        other = self._pairs.second
        return (self.landmarks[other] - self.landmarks[one] @ turns.mT[:, None]).square().sum(-1).mean(-1)

    @cached_property
    def _pairs(self) -> _ViewPairs:
        """All pairs of views."""
        one, other = torch.tensor(list(combinations(range(self.num_views), 2))).T
        visible = self.visible[one] & self.visible[other]
        confidence = torch.where(visible[..., None], self.confidence[one] * self.confidence[other], 0.0)
        return _ViewPairs(one, other, visible, confidence)


@dataclass(frozen=True)
class _ViewPairs:
    """P pairs of views.

    Attributes:
        first: Index of the first view of each pair, shape (P,).
        second: Index of the second view, shape (P,).
        visible: True if both views show the person at an instant, shape (P, M).
        confidence: Confidence of each keypoint in both views, shape (P, M, L).
    """

    first: torch.Tensor
    second: torch.Tensor
    visible: torch.Tensor
    confidence: torch.Tensor
