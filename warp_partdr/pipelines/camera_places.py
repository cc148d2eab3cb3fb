"""Places of cameras that nobody calibrated, found from the people whom they see.

Two pictures of one moment show a person in one pose. The joints that the label network sees in them say how the cameras
are turned to each other (Procrustes), pelvises where they stand; rays through one keypoint then meet, as near as
keypoints are known (Sampson's distance; Hartley and Zisserman, Multiple View Geometry, 2nd ed., section 11.4.3).
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

# Chosen on PartBench's people 0 to 39 and clips 0 to 7 before two cameras, by
# ``python -m warp_partdr.lab camera-places``.
_OFF = 0.02  # standard deviation of keypoints [person's height]
_FAR = 3.0  # standard deviations, from which on a keypoint says less and less (Geman and McClure, 1987)
_APART = 0.05  # of the network's joints in two views [m]
_DEPTH = 0.1  # of pelvises' places [distance]
_TOLD = 8  # moments after which the network's errors, which last, are no smaller in the mean
_STEPS = 60  # of L-BFGS, at most


def place_cameras(
    scene: Scene,
    *,
    observed_bodies: Sequence[ObservedBody] | None = None,
    stature: float | None = None,
    device: torch.device | str = "cpu",
) -> Scene:
    """Place the cameras of a scene by what they see: the same scene, in the world of its first view.

    Rotations and translations of all views but the first are replaced. Distances are as large as people seem to the
    network, or as the known stature says.

    Args:
        scene: People in several views; somebody is to be seen by two at once.
        looks: Of ``observe_scene`` on the same device, where somebody looked already; they do not depend on places.
        stature: Height of the one person, standing [m].
        device: "cpu" or a CUDA device.

    Raises:
        InputError: If views have no moment in common, or the stature is of several people.
    """
    stature = check_stature(stature)
    if stature is not None and scene.num_people > 1:
        raise InputError(f"stature: {stature:g} m, of {scene.num_people} people; expected one")
    if len(scene.views) == 1:
        return scene
    moments = PeopleInViews.of(
        scene, observe_scene(scene, device) if observed_bodies is None else observed_bodies, stature
    )
    places = moments.refined(moments.chained())
    return replace(scene, views=places.views_of(scene.views))


@dataclass(frozen=True)
class RelativePoses:
    """Places of V cameras in the frame of the first: X_camera = R X_first + t.

    Attributes:
        rotations: R, shape (V, 3, 3), float64.
        translations: t [m], shape (V, 3), float64.
        energy: Half of the squared deviations that they leave, a visible pair of rays.
    """

    rotations: torch.Tensor
    translations: torch.Tensor
    energy: float = 0.0

    def views_of(self, views: Sequence[View]) -> list[View]:
        """Views that stand there, the first one where it is."""
        first = views[0]
        turn, move = first.rotation.double(), first.translation.double()
        return [
            replace(view, rotation=(own @ turn).float(), translation=(own @ move + at).float())
            for view, own, at in zip(views, self.rotations, self.translations, strict=True)
        ]


@dataclass(frozen=True)
class PeopleInViews:
    """People at M moments as V views see them, float64.

    Attributes:
        rays: Directions of keypoints as places at depth 1, shape (V, M, L, 2).
        votes: Their confidence, 0 where there is none, shape (V, M, L).
        marks: The same landmarks as the network sees them, about the pelvis, in the camera's frame [m], (V, M, L, 3).
        pelvises: In the camera's frame [m], shape (V, M, 3).
        there: Who is seen when, shape (V, M), bool.
    """

    rays: torch.Tensor
    votes: torch.Tensor
    marks: torch.Tensor
    pelvises: torch.Tensor
    there: torch.Tensor

    @classmethod
    def of(cls, scene: Scene, observed_bodies: Sequence[ObservedBody], stature: float | None = None) -> PeopleInViews:
        """Collect looks at a scene, in which everybody has one size; a moment is a person in a frame."""
        observed_bodies = with_common_size(scene, observed_bodies, stature)
        places = {key: place for place, key in enumerate(sorted({_moment(observed) for observed in observed_bodies}))}
        shape = len(scene.views), len(places), len(LANDMARKS)
        rays, votes, marks = (torch.zeros(*shape, *more, dtype=torch.float64) for more in ((2,), (), (3,)))
        pelvises, there = torch.zeros(*shape[:2], 3, dtype=torch.float64), torch.zeros(shape[:2], dtype=torch.bool)
        for observed in observed_bodies:
            at, seen, lens = (observed.view, places[_moment(observed)]), observed.observation, observed.observation.lens
            assert lens is not None
            known = network_keypoints(seen.landmarks, seen.points, seen.confidence)
            rays[at] = ((known[:, :2] - lens[1:].to(known)) / lens[0].to(known)).double().cpu()
            votes[at] = known[:, 2].double().cpu()
            marks[at] = posed_landmarks(observed.body.posed(), annotated(LANDMARKS))[0].double().cpu()
            pelvises[at] = placed_at(observed.body.log_scale, observed.body.shift, lens[None])[0].double().cpu()
            there[at] = True
        return cls(rays, votes, marks, pelvises, there)

    @property
    def num_views(self) -> int:
        """Number of views, V."""
        return len(self.there)

    @property
    def num_common(self) -> int:
        """Number of moments that some two views share."""
        return int((self.there.sum(0) > 1).sum())

    def unlike(self, places: RelativePoses) -> float:
        """Mean squared distance of the network's joints in two views of a moment [m^2]."""
        (one, other), both, _ = self._common
        return float(self._distances(places.rotations[other] @ places.rotations[one].mT)[both].mean())

    def chained(self) -> RelativePoses:
        """Places by the network's bodies alone, one view after another by the one that shares most moments with it.

        Raises:
            InputError: If a view shares none.
        """
        common = (self.there[:, None] & self.there).sum(-1)
        placed = {0: (torch.eye(3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64))}
        while len(placed) < self.num_views:
            pairs = [(one, other) for one in placed for other in range(self.num_views) if other not in placed]
            one, other = max(pairs, key=lambda pair: int(common[pair]))
            if not common[one, other]:
                raise InputError(f"views[{other}]: sees nobody when others do; expected views of the same moments")
            placed[other] = self._beside(one, other, *placed[one])
        turns, moves = zip(*(placed[view] for view in range(self.num_views)), strict=True)
        return RelativePoses(torch.stack(turns), torch.stack(moves))

    def _beside(
        self, one: int, other: int, turn: torch.Tensor, move: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Place of a view by one that stands there."""
        both = self.there[one] & self.there[other]
        own = nearest_rotation(torch.einsum("mli,mlj->ij", self.marks[other, both], self.marks[one, both]))
        between = self.pelvises[other, both] - self.pelvises[one, both] @ own.mT
        return own @ turn, own @ move + between.median(0).values

    @one_torch_thread()
    @with_gradients()
    def refined(self, start: RelativePoses) -> RelativePoses:
        """Places where rays of keypoints meet, not far from where the network's bodies are one."""
        numbers = torch.zeros(self.num_views - 1, 6, dtype=torch.float64, requires_grad=True)
        first = start.rotations[:1], start.translations[:1]

        def places() -> tuple[torch.Tensor, torch.Tensor]:
            turned = rotation_from_axis_angle(numbers[:, :3]) @ start.rotations[1:]
            moved = start.translations[1:] + numbers[:, 3:]
            return torch.cat([first[0], turned]), torch.cat([first[1], moved])

        def step() -> torch.Tensor:
            optimizer.zero_grad()
            energy = self.energy(*places())
            energy.backward()
            return energy

        optimizer = torch.optim.LBFGS([numbers], max_iter=_STEPS, line_search_fn="strong_wolfe")
        optimizer.step(step)
        with torch.no_grad():
            rotations, translations = places()
            left = float(self.energy(rotations, translations) / self._common[2].sum().clamp_min(1e-9))
        return RelativePoses(rotations, translations, left)

    def energy(self, rotations: torch.Tensor, translations: torch.Tensor) -> torch.Tensor:
        """Half of the squared deviations, in standard ones, summed over pairs of views."""
        (one, other), both, votes = self._common
        turns = rotations[other] @ rotations[one].mT
        moves = translations[other] - (turns @ translations[one][..., None])[..., 0]
        rays = torch.cat([self.rays, torch.ones_like(self.rays[..., :1])], dim=-1)
        essential = skew(moves) @ turns
        across = torch.einsum("pij,pmlj->pmli", essential, rays[one])
        back = torch.einsum("pji,pmlj->pmli", essential, rays[other])
        spreads = (_OFF * MEAN_STATURE / self.pelvises[..., 2].clamp_min(1e-3)).square()[..., None]
        variance = across[..., :2].square().sum(-1) * spreads[other] + back[..., :2].square().sum(-1) * spreads[one]
        meeting = (rays[other] * across).sum(-1).square() / variance.clamp_min(1e-12)
        meeting = votes * meeting / (1 + meeting / _FAR**2)
        bodies = self._distances(turns) / _APART**2
        apart = self.pelvises[one] @ turns.mT + moves[:, None] - self.pelvises[other]
        apart = (apart / (_DEPTH * self.pelvises[other][..., 2:]).clamp_min(1e-3)).square().sum(-1)
        told = (_TOLD / both.sum(1).clamp_min(1)).clamp_max(1.0)
        return 0.5 * (meeting.sum() + (told[:, None] * torch.where(both, bodies + apart, 0.0)).sum())

    def _distances(self, turns: torch.Tensor) -> torch.Tensor:
        """Mean squared distances of joints about the pelvis, of pairs turned so to each other, (P, M) [m^2]."""
        one, other = self._common[0]
        return (self.marks[other] - self.marks[one] @ turns.mT[:, None]).square().sum(-1).mean(-1)

    @cached_property
    def _common(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Pairs of views, (2, P), moments at which both see somebody, (P, M), and votes for keypoints, (P, M, L)."""
        one, other = pairs = torch.tensor(list(combinations(range(self.num_views), 2))).T
        both = self.there[one] & self.there[other]
        return pairs, both, torch.where(both[..., None], self.votes[one] * self.votes[other], 0.0)


def _moment(observed: ObservedBody) -> tuple[int, int]:
    return observed.person, observed.frame
