"""Energy of detailed bodies against labels and keypoints: one for people side by side, and for scenes.

``TERMS`` is the table of its terms. A person alone, in one frame of one view, is drawn before an own camera, and its
frame is the world. People of a scene stand in a world that all its views share. All else is common to both.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import torch

from ...body.labels import LabelSet
from ...body.lens import through_lens
from ...body.parameters import crop_camera
from ...cameras import Camera, Perspective, ScreenCamera
from ...inputs.observation import REFERENCE_SIZE
from ...models.capsules import Capsules, measure_capsules
from ...models.clothes import clothes_costs
from ...models.model import Detailed, DetailedModel
from ...models.point_sums import sum_points
from ...render.mesh import mesh_label_loss
from ...render.part_mesh import PartMesh
from .drawn_model import DrawnModel, draw_model
from .feet import POINTS, slides
from .landmark_costs import landmark_costs
from .mesh_options import MeshOptions
from .placed_people import PictureViews, pelvises_in_world, place_people
from .starts import LabelPictures, Starts, Unknowns, WorldViews
from .unknown_noise import keypoint_costs, label_costs

_SEVERAL_CAMERAS = 2.0  # factor of keypoints and labels: rays that meet tell more than the network's guesses do
_STILL = 0.1  # [m/s], speed of a foot that costs 1


@dataclass(frozen=True, eq=False)
class MeshEnergy:
    """Energy of people whose labels are of one set.

    Attributes:
        drawn: Model that is drawn.
        options: Weights of the mesh stage's terms, and how labels are drawn.
        together: Mesh of people who overlap, as many as a cluster has, with their labels; None: nobody overlaps.
        capsules: Capsules of each person; None: nothing keeps parts and people apart.
        feet: Points ``FEET`` among the model's landmarks, shape (6,), int64; None: no feet are held.
        apart: Weight of the squares of depths by which parts, and people, stand in one another [1/cm^2].
        ground: Weight of the squared heights of standing feet [1/cm^2].
        sliding: Weight of the squared speeds of standing feet [1/(0.1 m/s)^2].
    """

    drawn: DrawnModel
    options: MeshOptions
    together: PartMesh | None = None
    capsules: Capsules | None = None
    feet: torch.Tensor | None = None
    apart: float = 0.0
    ground: float = 0.0
    sliding: float = 0.0

    def __call__(self, people: Starts, unknowns: Unknowns) -> dict[str, torch.Tensor]:
        """Costs by name: of people in scenes of their own of shape (P, ...), else of any shape each.

        Sums that nobody needs at each step are left out.
        """
        bodies = self.place(people, unknowns)
        return {term.name: term.cost(self, bodies) for term in TERMS if term.applies(self, people)}

    def factors(self, people: Starts) -> dict[str, float]:
        """Weights of all costs, by name."""
        return {term.name: term.weight(self, people) for term in TERMS}

    def place(self, people: Starts, unknowns: Unknowns) -> PlacedBodies:
        """Pose bodies with these numbers, and place them before their cameras."""
        posed, views = self.drawn.pose(people, unknowns), people.views
        vertices, marked = self.drawn.split(posed)
        points = sum_points(self.drawn.weights, marked, posed.joints)
        if views is None:
            cameras, pelvises = crop_cameras(people, unknowns, REFERENCE_SIZE)
            points = points if pelvises is None else points + pelvises[:, None]
            return PlacedBodies(people, unknowns, posed, vertices, pelvises, points, points[:, None], cameras)
        assert people.lens is not None
        pelvises = pelvises_in_world(
            unknowns.log_scale, unknowns.shift, people.lens, views.crop_rotations, views.crop_translations
        )
        points = points + pelvises[:, None]
        before_views = _before_views(points, views)
        crops = Perspective(views.focals, views.centres)
        return PlacedBodies(people, unknowns, posed, vertices, pelvises, points, before_views, crops)

    def of_unknown_noise(self, people: Starts) -> bool:
        """True if one camera sees one frame: costs are then of noise that nobody knows, if options say so.

        With several pictures of a body they gained nothing where inputs are noisy: noise is not all that keeps the body
        from agreeing with all of them.
        """
        return people.num_views == 1 and people.num_frames == 1 and self.options.noise == "unknown"

    def label_pictures(self, people: Starts) -> list[tuple[LabelPictures, PartMesh, bool]]:
        """Pictures to be drawn, the mesh of each, and whether groups can hide one another there."""
        pairs = (people.together, self.together, True), (people.alone, self.drawn.mesh, self.drawn.hides)
        return [(pictures, mesh, hides) for pictures, mesh, hides in pairs if pictures is not None and mesh is not None]

    def feet_of(self, points: torch.Tensor) -> torch.Tensor:
        """Points ``FEET`` of landmarks (..., L, 3), shape (..., 6, 3)."""
        assert self.feet is not None
        return points.index_select(-2, self.feet)

    def lowest_feet(self, points: torch.Tensor, ground: torch.Tensor) -> torch.Tensor:
        """Heights of the lowest of each body's feet over the ground [m], of landmarks (N, L, 3), shape (N,)."""
        return (self.feet_of(points) @ ground[:3]).amin(1) - ground[3]


@dataclass(frozen=True, eq=False)
class PlacedBodies:
    """Bodies of a fit before their cameras.

    Attributes:
        people: Their starts.
        unknowns: Their numbers.
        posed: Bodies about the pelvis.
        vertices: Vertices that are drawn, about the pelvis [m], shape (N, n, 3).
        pelvises: Pelvises in the world [m], shape (N, 3); None: at the origin, for weak perspective knows no distance.
        points: Landmarks in the world [m], shape (N, L, 3).
        before_views: Landmarks in each camera's frame [m], shape (N, V, L, 3).
        crops: Cameras of the M crops of ``REFERENCE_SIZE``.
    """

    people: Starts
    unknowns: Unknowns
    posed: Detailed
    vertices: torch.Tensor
    pelvises: torch.Tensor | None
    points: torch.Tensor
    before_views: torch.Tensor
    crops: Camera

    @cached_property
    def landmark_costs(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Distances from keypoints [px], and squares of depths, shape (M,) each."""
        return landmark_costs(self.before_views.flatten(0, 1), self.crops, self.people.aims)

    def pictured(self, pictures: LabelPictures) -> tuple[torch.Tensor, Camera | ScreenCamera]:
        """Vertices of the bodies in label pictures, and the cameras that draw them."""
        people, slots = self.people, pictures.slots
        if people.views is None or slots is None:
            crops, _ = crop_cameras(people, self.unknowns, pictures.size)
            return self.vertices if self.pelvises is None else self.vertices + self.pelvises[:, None], crops
        assert self.pelvises is not None
        views = PictureViews(
            people.views.rotations,
            people.views.translations,
            slots.lenses,
            people.views.shown,
            slots.slots,
            slots.places,
        )
        return place_people(self.vertices, self.pelvises, views, pictures.size), ScreenCamera(perspective=True)


def crop_cameras(people: Starts, unknowns: Unknowns, size: int) -> tuple[Camera, torch.Tensor | None]:
    """Cameras of N crops of ``size`` pixels a side, and pelvises before them as of ``find_camera``."""
    return through_lens(crop_camera(unknowns.log_scale, unknowns.shift, size), people.lens, size)


def _before_views(points: torch.Tensor, views: WorldViews) -> torch.Tensor:
    """Points (N, L, 3) in each camera's frame, shape (N, V, L, 3)."""
    turned = torch.nn.functional.linear(points, views.rotations.flatten(0, 1), views.translations.flatten())
    return turned.unflatten(2, (-1, 3)).transpose(1, 2)


def _keypoints(energy: MeshEnergy, bodies: PlacedBodies) -> torch.Tensor:
    distances, _ = bodies.landmark_costs
    return keypoint_costs(distances, bodies.people.aims.votes) if energy.of_unknown_noise(bodies.people) else distances


def _overlaps(energy: MeshEnergy, bodies: PlacedBodies) -> torch.Tensor:
    assert energy.capsules is not None
    people = bodies.people
    # Those who are alone in a scene meet nobody, wherever they are.
    by = None if people.views is None else bodies.pelvises
    placed = energy.capsules.of(bodies.posed, people.of_frames(bodies.unknowns.shape), by=by)
    return energy.capsules.overlap(placed, people=people.people_in_scene)


def _heights(energy: MeshEnergy, bodies: PlacedBodies) -> torch.Tensor:
    feet = bodies.people.feet
    assert feet is not None
    return feet.standing * (100 * energy.lowest_feet(bodies.points, feet.plane)).square()


def _slides(energy: MeshEnergy, bodies: PlacedBodies) -> torch.Tensor:
    people, views = bodies.people, bodies.people.views
    assert views is not None
    assert people.rates is not None
    points, shown = (people.by_person(each) for each in (energy.feet_of(bodies.before_views), views.shown))
    return slides(points, shown, people.rates) / (POINTS * _STILL**2)


def _label_losses(energy: MeshEnergy, bodies: PlacedBodies) -> torch.Tensor:
    """Label loss of each picture, in pixels of a person's crop."""
    options, found = energy.options, []
    for pictures, mesh, hides in energy.label_pictures(bodies.people):
        vertices, camera = bodies.pictured(pictures)
        loss, _ = mesh_label_loss(
            vertices,
            mesh,
            camera,
            pictures.target,
            gradient=options.gradient,
            max_distance=options.max_distance,
            depth_weight=options.depth_weight if hides else 0.0,
            validate=False,
        )
        if energy.of_unknown_noise(bodies.people):
            loss = label_costs(loss, pictures.borders, pictures.size)
        found.append(loss if pictures.size == options.size else loss * (options.size / pictures.size) ** 2)
    return torch.cat(found) if len(found) > 1 else found[0]


def _by_cameras(people: Starts) -> float:
    return _SEVERAL_CAMERAS if people.num_views > 1 else 1.0


class MeshTerm(NamedTuple):
    """Term of the energy."""

    name: str
    weight: Callable[[MeshEnergy, Starts], float]
    cost: Callable[[MeshEnergy, PlacedBodies], torch.Tensor]
    applies: Callable[[MeshEnergy, Starts], bool] = lambda energy, people: True


TERMS = (
    MeshTerm("proj", lambda energy, people: _by_cameras(people) * energy.options.proj, _keypoints),
    MeshTerm("depth", lambda energy, people: energy.options.depth, lambda energy, bodies: bodies.landmark_costs[1]),
    MeshTerm(
        "turns",
        lambda energy, people: energy.options.turns,
        lambda energy, bodies: bodies.unknowns.turns.square() / bodies.people.turn_variances,
    ),
    MeshTerm(
        "shape",
        lambda energy, people: energy.options.shape / 2,
        lambda energy, bodies: (bodies.unknowns.shape - bodies.people.shape).square(),
    ),
    MeshTerm(
        "clothes",
        lambda energy, people: energy.options.clothes or 0.0,
        lambda energy, bodies: clothes_costs(bodies.unknowns.clothes),
        lambda energy, people: energy.options.clothes is not None,
    ),
    MeshTerm(
        "apart", lambda energy, people: energy.apart, _overlaps, lambda energy, people: energy.capsules is not None
    ),
    MeshTerm("ground", lambda energy, people: energy.ground, _heights, lambda energy, people: people.feet is not None),
    MeshTerm(
        "sliding", lambda energy, people: energy.sliding, _slides, lambda energy, people: people.rates is not None
    ),
    MeshTerm(
        "seg",
        lambda energy, people: _by_cameras(people) * energy.options.drawn_seg,
        _label_losses,
        lambda energy, people: bool(energy.label_pictures(people)),
    ),
)


def mesh_energy(model: DetailedModel, options: MeshOptions, label_set: LabelSet | None) -> MeshEnergy:
    """Energy of people with labels of this set, each alone in a scene; kept, for captured graphs belong to it."""
    return _mesh_energy(draw_model(model, options, label_set), options)


@lru_cache(maxsize=8)
def _mesh_energy(drawn: DrawnModel, options: MeshOptions) -> MeshEnergy:
    capsules = measure_capsules(drawn.model) if options.apart > 0 else None
    return MeshEnergy(drawn, options, capsules=capsules, apart=options.apart)
