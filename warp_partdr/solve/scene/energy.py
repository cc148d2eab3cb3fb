"""Energy of a scene: P people in T frames before V cameras, each with one shape, posed in the world.

Tables are dense, (P, T, V), so that the forces on a body are summed over its pictures in a fixed order.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch

from ...cameras import Perspective, ScreenCamera
from ...models.capsules import Capsules
from ...models.clothes import CLOTHED, clothes_costs
from ...models.model import DetailedModel
from ...models.point_sums import sum_points
from ...render.mesh import mesh_label_loss
from ...render.part_mesh import PartMesh
from ..mesh.landmark_costs import LandmarkAims, landmark_costs
from ..mesh.mesh_energy import MeshEnergy
from ..mesh.mesh_unknowns import CLOTHES_RATE, SHAPE_RATE, Unknowns
from ..mesh.steps import Tensors
from ..mesh.unknown_noise import keypoint_costs, label_costs
from .clusters import Clusters
from .feet import POINTS, slides
from .options import SceneOptions
from .pictures import PictureViews, pelvises_in_world, place_people

_SEVERAL_CAMERAS = 2.0  # factor of keypoints and labels: rays that meet tell more than the network's guesses do
_STILL = 0.1  # [m/s], speed of a foot that costs 1


@dataclass(frozen=True)
class Sheet(Tensors):
    """Pictures of K clusters of people, C at most in one, in all frames and views.

    Attributes:
        target: Labels: slot G + group, shape (K T V, size, size), uint8.
        borders: Of the labels, their lengths [px], shape (K T V,).
        lenses: Of the crops, shape (K T V, 3).
        slots: As of ``PictureViews``, like ``places``, shape (K, C), int32.
        places: Shape (P, 2), int32.
    """

    target: torch.Tensor
    borders: torch.Tensor
    lenses: torch.Tensor
    slots: torch.Tensor
    places: torch.Tensor

    @property
    def size(self) -> int:
        """Side of the crops [px]."""
        return self.target.shape[-1]


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
        first_rotations: World to camera, of that view, shape (N, 3, 3).
        first_translations: The same [m], shape (N, 3).
        turn_weights: Of the squares of turns of each free joint [1/rad^2], shape (N, F, 1).
        view_rotations: World to camera, shape (V, 3, 3).
        view_translations: The same [m], shape (V, 3).
        places: Landmark of the model that each keypoint marks, shape (N, V, L), int64.
        points: Keypoints in their crops, from -1 to 1, shape (N, V, L, 2).
        votes: Their weights; 0 where somebody is not seen, shape (N, V, L).
        focals: Of the crops of ``REFERENCE_SIZE`` [px], shape (N, V, 2).
        centres: Their principal points [px], shape (N, V, 2).
        depths: Of joints relative to the pelvis, as the network saw them in each view [m], shape (N, V, 20).
        depth_weights: Of their squares, 0 where somebody is not seen [1/m^2], shape (N, V, 20).
        shown: Who is seen in each view, shape (N, V), bool.
        smooth: Share of each frame in each frame's moves, shape (T, T); None: frames move for themselves.
        rates: 1 over the time from each frame to the next [1/s], 0 where nothing is known of feet between them, shape
            (T - 1,); None: it nowhere is.
        ground: Normal and offset [m] of the ground in the world, shape (4,); None: no feet are held to any.
        standing: How surely each body stands on it, shape (N,).
        together: Pictures of people who overlap; None: without labels, or nobody does.
        alone: Pictures of each of the others; None: without labels, or there are none.
    """

    rotations: torch.Tensor
    translation: torch.Tensor
    shape: torch.Tensor
    clothes: torch.Tensor
    unknown: torch.Tensor
    log_scale: torch.Tensor
    shift: torch.Tensor
    lens: torch.Tensor
    first_rotations: torch.Tensor
    first_translations: torch.Tensor
    turn_weights: torch.Tensor
    view_rotations: torch.Tensor
    view_translations: torch.Tensor
    places: torch.Tensor
    points: torch.Tensor
    votes: torch.Tensor
    focals: torch.Tensor
    centres: torch.Tensor
    depths: torch.Tensor
    depth_weights: torch.Tensor
    shown: torch.Tensor
    smooth: torch.Tensor | None
    rates: torch.Tensor | None
    together: Sheet | None
    alone: Sheet | None
    ground: torch.Tensor | None = None
    standing: torch.Tensor | None = None


@dataclass(frozen=True, eq=False)
class SceneEnergy:
    """Terms of a scene.

    Attributes:
        one: Model, landmarks and terms of a person.
        clusters: People who are drawn together.
        mesh: Of people who overlap, as many as a cluster has, with their labels; None: without labels, or nobody does.
        capsules: Of each person; None: nothing keeps parts and people apart.
        feet: Points ``FEET`` among the model's landmarks, shape (6,), int64.
        options: Weights.
    """

    one: MeshEnergy
    clusters: Clusters
    mesh: PartMesh | None
    capsules: Capsules | None
    feet: torch.Tensor
    options: SceneOptions

    def factors(self, people: SceneStarts) -> dict[str, float]:
        """Weights of all costs, by name."""
        apart = self.options.apart if len(people.shape) > 1 else self.options.mesh.apart
        feet = {"ground": self.options.ground, "sliding": self.options.sliding}
        factors = self.options.mesh.factors(apart, self.options.mesh.size) | feet
        seen = _SEVERAL_CAMERAS if len(people.view_rotations) > 1 else 1.0
        return factors | {name: seen * factors[name] for name in ("proj", "seg")}

    def __call__(self, people: SceneStarts, unknowns: Unknowns) -> dict[str, torch.Tensor]:
        """Costs by name, of any shape each."""
        options, one = self.options.mesh, self.one
        posed = one.pose(people, unknowns)
        pelvises = self.pelvises(people, unknowns)
        drawn, marked = one.split(posed)
        points = sum_points(one.weights, marked, posed.joints) + pelvises[:, None]
        aims = (people.places, people.points, people.votes, people.depths, people.depth_weights)
        places, at, votes, depths, weights = (each.flatten(0, 1) for each in aims)
        seen_points = self._seen(people, points)
        seen, deep = landmark_costs(
            seen_points.flatten(0, 1),
            Perspective(people.focals.flatten(0, 1), people.centres.flatten(0, 1)),
            LandmarkAims(places, at, votes, one.ends, depths, weights),
        )
        costs = {
            "proj": keypoint_costs(seen, votes) if self._of_unknown_noise(people) else seen,
            "depth": deep,
            "turns": unknowns.turns.square() * people.turn_weights,
            "shape": (unknowns.shape - people.shape).square(),
        }
        if options.clothes is not None:
            costs["clothes"] = clothes_costs(unknowns.clothes)
        if self.capsules is not None:
            placed = self.capsules.of(posed, self._of_frames(people, unknowns.shape), by=pelvises)
            costs["apart"] = self.capsules.overlap(placed, people=len(people.shape))
        if people.ground is not None and people.standing is not None:
            lowest = self.lowest_feet(points, people.ground)
            costs["ground"] = people.standing * (100 * lowest).square()
        if people.rates is not None:
            by_frame = [each.unflatten(0, (len(people.shape), -1)) for each in (self._feet(seen_points), people.shown)]
            costs["sliding"] = slides(by_frame[0], by_frame[1], people.rates) / (POINTS * _STILL**2)
        seg = [
            self._label_loss(people, sheet, mesh, drawn, pelvises)
            for sheet, mesh in ((people.together, self.mesh), (people.alone, one.mesh))
            if sheet is not None and mesh is not None
        ]
        if seg:
            costs["seg"] = torch.cat(seg) if len(seg) > 1 else seg[0]
        return costs

    def _label_loss(
        self, people: SceneStarts, sheet: Sheet, mesh: PartMesh, drawn: torch.Tensor, pelvises: torch.Tensor
    ) -> torch.Tensor:
        """Label loss of each picture of a sheet, in pixels of a person's crop."""
        options = self.options.mesh
        loss, _ = mesh_label_loss(
            place_people(drawn, pelvises, self._views(people, sheet), sheet.size),
            mesh,
            ScreenCamera(perspective=True),
            sheet.target,
            gradient=options.gradient,
            max_distance=options.max_distance,
            depth_weight=options.depth_weight,
            validate=False,
        )
        if self._of_unknown_noise(people):
            loss = label_costs(loss, sheet.borders, sheet.size)
        return loss if sheet.size == options.size else loss * (options.size / sheet.size) ** 2

    def _of_unknown_noise(self, people: SceneStarts) -> bool:
        """True if one camera sees one frame: costs are the mesh stage's, of noise that nobody knows.

        With several pictures of a body they gained nothing where inputs are noisy: noise is not all that keeps the body
        from agreeing with all of them.
        """
        one = len(people.view_rotations) == 1 and len(people.shift) == len(people.shape)
        return one and self.options.mesh.noise == "unknown"

    def pictured(self, people: SceneStarts, unknowns: Unknowns, sheet: Sheet) -> torch.Tensor:
        """Vertices of people in each picture of a sheet, as of ``place_people``."""
        posed = self.one.pose(people, unknowns)
        views = self._views(people, sheet)
        return place_people(self.one.split(posed)[0], self.pelvises(people, unknowns), views, sheet.size)

    def landmarks(self, people: SceneStarts, unknowns: Unknowns) -> torch.Tensor:
        """All of the drawn model's, in the world [m], shape (N, L, 3)."""
        posed = self.one.pose(people, unknowns)
        return self.one.landmarks(posed) + self.pelvises(people, unknowns)[:, None]

    def lowest_feet(self, points: torch.Tensor, ground: torch.Tensor) -> torch.Tensor:
        """Heights of the lowest of each body's feet over the ground [m], of landmarks (N, L, 3), shape (N,)."""
        return (self._feet(points) @ ground[:3]).amin(1) - ground[3]

    def _feet(self, points: torch.Tensor) -> torch.Tensor:
        """Points ``FEET`` of landmarks (..., L, 3), shape (..., 6, 3)."""
        return points.index_select(-2, self.feet)

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
            torch.addcmul(people.shape, people.unknown, shape.view_as(people.shape)),
            torch.addcmul(people.clothes, people.unknown, clothes.view_as(people.clothes)),
            people.log_scale + log_scale.squeeze(1),
            people.shift + shift,
        )

    def whole_pose(
        self, model: DetailedModel, people: SceneStarts, unknowns: Unknowns
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Shape values, local rotations and translation of N bodies in the world, for the whole model's ``pose``."""
        every = replace(unknowns, shape=self._of_frames(people, unknowns.shape))
        shape, rotations, translation = self.one.whole_pose(model, people, every)
        return shape, rotations, translation + self.pelvises(people, unknowns)

    @staticmethod
    def pelvises(people: SceneStarts, unknowns: Unknowns) -> torch.Tensor:
        """Pelvises in the world [m], shape (N, 3)."""
        views = people.first_rotations, people.first_translations
        return pelvises_in_world(unknowns.log_scale, unknowns.shift, people.lens, *views)

    def _sizes(self, people: SceneStarts) -> list[int]:
        """Numbers of moves: of bodies, shapes and clothes."""
        bodies, joints = people.turn_weights.shape[:2]
        return [bodies * (3 * joints + 3), people.shape.numel(), len(people.shape) * len(CLOTHED)]

    @staticmethod
    def _of_frames(people: SceneStarts, values: torch.Tensor) -> torch.Tensor:
        """Values of people, each as often as there are frames."""
        return values.repeat_interleave(len(people.shift) // len(people.shape), 0)

    @staticmethod
    def _seen(people: SceneStarts, points: torch.Tensor) -> torch.Tensor:
        """Points (N, L, 3) in each camera's frame, shape (N, V, L, 3)."""
        views = people.view_rotations.flatten(0, 1), people.view_translations.flatten()
        return torch.nn.functional.linear(points, *views).unflatten(2, (-1, 3)).transpose(1, 2)

    @staticmethod
    def _views(people: SceneStarts, sheet: Sheet) -> PictureViews:
        views = people.view_rotations, people.view_translations
        return PictureViews(*views, sheet.lenses, people.shown, sheet.slots, sheet.places)
