"""Energy of a scene: P people in T frames before V cameras, each with one shape, posed in the world.

Tables are dense, (P, T, V), so that the forces on a body are summed over its pictures in a fixed order.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch

from ..body.lens import lens_camera, placed_at
from ..cameras import ScreenCamera
from ..clothing.capsules import Capsules
from ..clothing.clothes import CLOTHED, SPREAD
from ..clothing.model import DetailedModel
from ..fit.landmark_costs import LandmarkAims, landmark_costs
from ..fit.mesh_energy import CLOTHES_RATE, SHAPE_RATE, MeshEnergy, Unknowns
from ..fit.steps import Tensors
from ..inputs.observation import REFERENCE_SIZE
from ..render.mesh import mesh_label_loss
from ..render.part_mesh import PartMesh
from .options import SceneOptions
from .pictures import PictureViews, place_people

FEET = ("left_heel", "left_big_toe", "left_small_toe", "right_heel", "right_big_toe", "right_small_toe")


@dataclass(frozen=True)
class SceneStarts(Tensors):
    """Starts and observations of P people in T frames, seen by V views; N = P T bodies, frames of a person in a row.

    Attributes:
        rotations: Of the drawn model's joints where the fit starts, the root's in the world, shape (N, J, 3, 3).
        translation: From the pelvis to the root, in the world [m], shape (N, 3).
        shape: Shape values, shape (P, S).
        clothes: Thicknesses on parts ``CLOTHED`` [m], shape (P, 8).
        unknown: 1 for people whose shape and clothes are to be found, 0 for known ones, shape (P, 1).
        log_scale: Of the pelvis in the crop of the body's first view, like ``shift`` as of ``BodyParameters``, (N,).
        shift: Shape (N, 2).
        lens: Of that crop, shape (N, 3).
        first: That view, shape (N,), int64.
        turn_spreads: How sure the turn of each free joint is [rad], shape (N, F).
        view_rotations: World to camera, shape (V, 3, 3).
        view_translations: The same [m], shape (V, 3).
        places: Landmark of the model that each keypoint marks, shape (N, V, L), int64.
        points: Keypoints in their crops, from -1 to 1, shape (N, V, L, 2).
        votes: Their weights; 0 where somebody is not seen, shape (N, V, L).
        lenses: Of the crops, shape (N, V, 3).
        depths: Of joints relative to the pelvis, as the network saw them in each view [m], shape (N, V, 20).
        depth_weights: Of their squares, 0 where somebody is not seen [1/m^2], shape (N, V, 20).
        shown: Who is seen in each view, shape (N, V), bool.
        smooth: Share of each frame in each frame's moves, shape (T, T); None: frames move for themselves.
        ground: Normal and offset [m] of the ground in the world, shape (4,); None: no feet are held to any.
        standing: How surely each body stands on it, shape (N,).
        target: Labels of pictures: person G + group, shape (T V, size, size), uint8; None: without labels.
        target_lens: Of the pictures' crops, shape (T V, 3).
    """

    rotations: torch.Tensor
    translation: torch.Tensor
    shape: torch.Tensor
    clothes: torch.Tensor
    unknown: torch.Tensor
    log_scale: torch.Tensor
    shift: torch.Tensor
    lens: torch.Tensor
    first: torch.Tensor
    turn_spreads: torch.Tensor
    view_rotations: torch.Tensor
    view_translations: torch.Tensor
    places: torch.Tensor
    points: torch.Tensor
    votes: torch.Tensor
    lenses: torch.Tensor
    depths: torch.Tensor
    depth_weights: torch.Tensor
    shown: torch.Tensor
    smooth: torch.Tensor | None
    target: torch.Tensor | None
    target_lens: torch.Tensor | None
    ground: torch.Tensor | None = None
    standing: torch.Tensor | None = None


@dataclass(frozen=True, eq=False)
class SceneEnergy:
    """Terms of a scene.

    Attributes:
        one: Model, landmarks and terms of a person.
        mesh: Of all people together, with their labels; None: without labels.
        capsules: Of each person; None: nothing keeps parts and people apart.
        options: Weights.
    """

    one: MeshEnergy
    mesh: PartMesh | None
    capsules: Capsules | None
    options: SceneOptions

    def __call__(self, people: SceneStarts, unknowns: Unknowns) -> dict[str, torch.Tensor]:
        """Weighted terms by name, shape () each."""
        options, one = self.options.mesh, self.one
        numbers = self._of_frames(people, unknowns)
        posed = one.pose(people, numbers)
        pelvises = self.pelvises(people, unknowns)
        points = one.landmarks(posed) + pelvises[:, None]
        aims = (people.places, people.points, people.votes, people.depths, people.depth_weights)
        places, marked, votes, depths, weights = (each.flatten(0, 1) for each in aims)
        seen, deep = landmark_costs(
            self._seen(people, points).flatten(0, 1),
            lens_camera(people.lenses.flatten(0, 1), REFERENCE_SIZE),
            LandmarkAims(places, marked, votes, one.ends, depths, weights),
        )
        spread = people.turn_spreads.square()
        terms = {
            "proj": options.proj * seen.sum(),
            "depth": options.depth * deep.sum(),
            "turns": options.turns * (unknowns.turns.square().sum(-1) / spread).sum(),
            "shape": options.shape / 2 * (unknowns.shape - people.shape).square().sum(),
        }
        if options.clothes is not None:
            terms["clothes"] = options.clothes / 2 * (unknowns.clothes / SPREAD).square().sum()
        if self.capsules is not None:
            weight = self.options.apart if len(people.shape) > 1 else options.apart
            placed = self.capsules.of(posed, numbers.shape, by=pelvises[:, None])
            terms["apart"] = weight * self.capsules.overlap(placed, people=len(people.shape)).sum()
        if people.ground is not None and people.standing is not None:
            lowest = self.lowest_feet(points, people.ground)
            terms["ground"] = self.options.ground * (people.standing * (100 * lowest).square()).sum()
        if people.target is not None and people.target_lens is not None and self.mesh is not None:
            views = self._views(people, people.target_lens)
            loss, _ = mesh_label_loss(
                place_people(posed.vertices, pelvises, views, people.target.shape[-1]),
                self.mesh,
                ScreenCamera(perspective=True),
                people.target,
                gradient=options.gradient,
                max_distance=options.max_distance,
                depth_weight=options.depth_weight,
                validate=False,
            )
            terms["seg"] = options.seg * (REFERENCE_SIZE / people.target.shape[-1]) ** 2 * loss.sum()
        return terms

    def pictured(self, people: SceneStarts, unknowns: Unknowns, lenses: torch.Tensor, size: int) -> torch.Tensor:
        """Vertices of all people in each picture, as of ``place_people``, by the pictures' lenses, (T V, 3)."""
        posed = self.one.pose(people, self._of_frames(people, unknowns))
        views = self._views(people, lenses)
        return place_people(posed.vertices, self.pelvises(people, unknowns), views, size)

    def landmarks(self, people: SceneStarts, unknowns: Unknowns) -> torch.Tensor:
        """All of the drawn model's, in the world [m], shape (N, L, 3)."""
        posed = self.one.pose(people, self._of_frames(people, unknowns))
        return self.one.landmarks(posed) + self.pelvises(people, unknowns)[:, None]

    def lowest_feet(self, points: torch.Tensor, ground: torch.Tensor) -> torch.Tensor:
        """Heights of the lowest of each body's feet over the ground [m], of landmarks (N, L, 3), shape (N,)."""
        names = self.one.model.landmark_names
        feet = torch.stack([points[:, names.index(name)] for name in FEET], dim=1)
        return (feet @ ground[:3]).amin(1) - ground[3]

    def at_rest(self, people: SceneStarts) -> Unknowns:
        """Numbers where the fit starts."""
        return self.moved(people, torch.zeros_like(self.rates(people)))

    def rates(self, people: SceneStarts) -> torch.Tensor:
        """Learning rates of all moves in a row: of bodies, then of people, shape (R,)."""
        like = people.shape
        sizes = (self._sizes(people)[0], 1.0), (like.numel(), SHAPE_RATE), (len(like) * len(CLOTHED), CLOTHES_RATE)
        return torch.cat([like.new_full((count,), rate) for count, rate in sizes])

    def moved(self, people: SceneStarts, moves: torch.Tensor) -> Unknowns:
        """Numbers after these moves, (R,): turns, ``log_scale`` and ``shift`` of N bodies, the others of P people."""
        bodies, shape, clothes = moves.split(self._sizes(people))
        rows = bodies.view(len(people.shift), -1)
        if people.smooth is not None:
            rows = (people.smooth @ rows.unflatten(0, (len(people.shape), -1))).flatten(0, 1)
        turns, log_scale, shift = rows.split([rows.shape[1] - 3, 1, 2], dim=1)
        return Unknowns(
            turns.unflatten(1, (-1, 3)),
            people.shape + people.unknown * shape.view_as(people.shape),
            people.clothes + people.unknown * clothes.view_as(people.clothes),
            people.log_scale + log_scale[:, 0],
            people.shift + shift,
        )

    def whole_pose(
        self, model: DetailedModel, people: SceneStarts, unknowns: Unknowns
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Shape values, local rotations and translation of N bodies in the world, for the whole model's ``pose``."""
        shape, rotations, translation = self.one.whole_pose(model, people, self._of_frames(people, unknowns))
        return shape, rotations, translation + self.pelvises(people, unknowns)

    @staticmethod
    def pelvises(people: SceneStarts, unknowns: Unknowns) -> torch.Tensor:
        """Pelvises in the world [m], shape (N, 3)."""
        views = people.view_rotations[people.first], people.view_translations[people.first]
        return pelvises_in_world(unknowns.log_scale, unknowns.shift, people.lens, *views)

    def _sizes(self, people: SceneStarts) -> list[int]:
        """Numbers of moves: of bodies, shapes and clothes."""
        bodies, joints = people.turn_spreads.shape
        return [bodies * (3 * joints + 3), people.shape.numel(), len(people.shape) * len(CLOTHED)]

    @staticmethod
    def _of_frames(people: SceneStarts, unknowns: Unknowns) -> Unknowns:
        """Numbers of N bodies: of people, each as often as there are frames."""
        frames = len(people.shift) // len(people.shape)
        shape, clothes = (each.repeat_interleave(frames, 0) for each in (unknowns.shape, unknowns.clothes))
        return replace(unknowns, shape=shape, clothes=clothes)

    @staticmethod
    def _seen(people: SceneStarts, points: torch.Tensor) -> torch.Tensor:
        """Points (N, L, 3) in each camera's frame, shape (N, V, L, 3)."""
        return points[:, None] @ people.view_rotations.mT + people.view_translations[:, None]

    @staticmethod
    def _views(people: SceneStarts, lenses: torch.Tensor) -> PictureViews:
        return PictureViews(people.view_rotations, people.view_translations, lenses, people.shown)


def pelvises_in_world(
    log_scale: torch.Tensor,
    shift: torch.Tensor,
    lens: torch.Tensor,
    rotations: torch.Tensor,
    translations: torch.Tensor,
) -> torch.Tensor:
    """Pelvises in the world [m], shape (N, 3), of bodies in crops of cameras that stand so, (N, 3, 3) and (N, 3)."""
    return ((placed_at(log_scale, shift, lens) - translations)[:, None] @ rotations)[:, 0]
