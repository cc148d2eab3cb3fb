"""Energy of detailed bodies against labels and keypoints, for batches of people and for scenes.

``TERMS`` is the table of its terms. In a batch, each person is alone in one frame of one view. The frame of that camera
is the person's world. The people of a scene stand in one world, which all its views share. The rest is common to both.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import torch

from ...body.labels import LabelSet
from ...body.lens import through_lens
from ...body.parameters import crop_camera
from ...cameras import Camera, Perspective, ScreenCamera
from ...inputs.observation import REFERENCE_SIZE
from ...interop.device_cache import device_cache
from ...models.capsules import Capsules, measure_capsules
from ...models.clothes import clothes_costs
from ...models.model import Detailed, DetailedModel
from ...models.point_sums import sum_points
from ...render.mesh import mesh_label_loss
from ...render.part_mesh import PartMesh
from .drawn_model import DrawnModel, draw_model
from .feet import POINTS, slides
from .landmark_costs import landmark_costs
from .mask_weights import ONE_MASK, PART_LABELS, MaskWeights
from .mesh_options import MeshOptions
from .placed_people import PictureViews, pelvises_in_world, place_people
from .starts import LabelPictures, Starts, Unknowns, WorldViews
from .unknown_noise import keypoint_costs, label_costs

# Factor of keypoints and labels if there are several cameras: rays that meet tell more than the network's prediction.
_SEVERAL_CAMERAS = 2.0
_STILL = 0.1  # speed of a foot at which its cost is 1 [m/s]


@dataclass(frozen=True, eq=False)
class MeshEnergy:
    """Energy of people whose labels are of one set.

    Attributes:
        drawn: Model that is drawn.
        options: Weights of the mesh stage's terms, and options of drawing.
        cluster_mesh: Mesh of the people of one cluster, who overlap, with the labels of each; None if nobody overlaps.
        capsules: Capsules of each person; None if nothing keeps parts and people apart.
        feet: Indices of ``FEET`` among the model's landmarks, shape (6,), int64; None if no feet are held.
        apart: Weight of the squared depths by which parts, or people, penetrate each other [1/cm^2].
        ground: Weight of the squared heights of standing feet [1/cm^2].
        sliding: Weight of the squared speeds of standing feet [1/(0.1 m/s)^2].
    """

    drawn: DrawnModel
    options: MeshOptions
    cluster_mesh: PartMesh | None = None
    capsules: Capsules | None = None
    feet: torch.Tensor | None = None
    apart: float = 0.0
    ground: float = 0.0
    sliding: float = 0.0

    def __call__(self, people: Starts, unknowns: Unknowns) -> dict[str, torch.Tensor]:
        """Evaluate the costs by name, before they are weighted.

        For a batch of people, the first dimension of each cost is P. In a scene each cost has a shape of its own. Costs
        are not summed here, because the steps do not need their sums.
        """
        bodies = self.place(people, unknowns)
        return {term.name: term.cost(self, bodies) for term in TERMS if term.applies(self, people)}

    def factors(self, people: Starts) -> dict[str, float]:
        """Weights of all costs by name."""
        return {term.name: term.weight(self, people) for term in TERMS}

    def place(self, people: Starts, unknowns: Unknowns) -> PlacedBodies:
        """Pose bodies with these unknowns, and place them before their cameras."""
        posed = self.drawn.pose(people, unknowns)
        views = people.views
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

    def has_unknown_noise(self, people: Starts) -> bool:
        """Return True if costs are those of noise of unknown size: the options ask for it, and there is one picture.

        With several pictures of a body, these costs gained nothing on noisy input. Noise is not the only reason why a
        body can't agree with all pictures.
        """
        return self.has_one_picture(people) and self.options.noise == "unknown"

    def has_one_picture(self, people: Starts) -> bool:
        """Return True if each body is seen in one picture alone."""
        return people.num_views == 1 and people.num_frames == 1

    def label_weights(self, people: Starts) -> MaskWeights:
        """Find the factors of the weights of keypoints and labels: others for a mask, if there is one picture."""
        return ONE_MASK if self.drawn.num_groups == 1 and self.has_one_picture(people) else PART_LABELS

    def label_pictures(self, people: Starts) -> list[tuple[LabelPictures, PartMesh, bool]]:
        """List the pictures to be drawn, each with its mesh, and with True if one group can hide another one there."""
        pairs = (people.overlapping, self.cluster_mesh, True), (people.alone, self.drawn.mesh, self.drawn.hides)
        return [(pictures, mesh, hides) for pictures, mesh, hides in pairs if pictures is not None and mesh is not None]

    def feet_of(self, points: torch.Tensor) -> torch.Tensor:
        """Select the points ``FEET`` from landmarks (..., L, 3), shape (..., 6, 3)."""
        assert self.feet is not None
        return points.index_select(-2, self.feet)

    def lowest_feet(self, points: torch.Tensor, ground: torch.Tensor) -> torch.Tensor:
        """Find the height of each body's lowest foot point over the ground [m], shape (N,).

        Args:
            points: Landmarks in the world [m], shape (N, L, 3).
            ground: Normal and offset of the ground [m], shape (4,).
        """
        return (self.feet_of(points) @ ground[:3]).amin(1) - ground[3]


@dataclass(frozen=True, eq=False)
class PlacedBodies:
    """Bodies of a fit before their cameras.

    Attributes:
        people: Starts and observations of the people.
        unknowns: Current numbers of the bodies.
        posed: Posed bodies, relative to the pelvis.
        vertices: Vertices that are drawn, relative to the pelvis [m], shape (N, n, 3).
        pelvises: Positions of the pelvises in the world [m], shape (N, 3); None: at the origin, because weak
            perspective knows no distance.
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
        """Costs of keypoints [px] and of depths, shape (M,) each."""
        return landmark_costs(self.before_views.flatten(0, 1), self.crops, self.people.aims)

    def pictured(self, pictures: LabelPictures) -> tuple[torch.Tensor, Camera | ScreenCamera]:
        """Find the vertices of the bodies in label pictures, and the cameras that draw them."""
        people = self.people
        slots = pictures.slots
        if people.views is None or slots is None:
            crops, _ = crop_cameras(people, self.unknowns, pictures.size)
            return self.vertices if self.pelvises is None else self.vertices + self.pelvises[:, None], crops
        assert self.pelvises is not None
        views = PictureViews(
            people.views.rotations,
            people.views.translations,
            slots.lenses,
            people.views.observed,
            slots.slots,
            slots.person_slots,
        )
        return place_people(self.vertices, self.pelvises, views, pictures.size), ScreenCamera(perspective=True)


def crop_cameras(people: Starts, unknowns: Unknowns, size: int) -> tuple[Camera, torch.Tensor | None]:
    """Find the cameras of N crops of ``size`` pixels a side, and the pelvises before them.

    Returns:
        Cameras of the crops; and positions of the pelvises [m], shape (N, 3), None for weak perspective.
    """
    return through_lens(crop_camera(unknowns.log_scale, unknowns.shift, size), people.lens, size)


def _before_views(points: torch.Tensor, views: WorldViews) -> torch.Tensor:
    """Transform points (N, L, 3) into the frame of each camera, shape (N, V, L, 3)."""
    turned = torch.nn.functional.linear(points, views.rotations.flatten(0, 1), views.translations.flatten())
    return turned.unflatten(2, (-1, 3)).transpose(1, 2)


def _keypoints(energy: MeshEnergy, bodies: PlacedBodies) -> torch.Tensor:
    distances, _ = bodies.landmark_costs
    return (
        keypoint_costs(distances, bodies.people.aims.weights) if energy.has_unknown_noise(bodies.people) else distances
    )


def _overlaps(energy: MeshEnergy, bodies: PlacedBodies) -> torch.Tensor:
    assert energy.capsules is not None
    people = bodies.people
    # A person who is alone in a scene can meet nobody, so the position does not matter.
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
    points = people.by_person(energy.feet_of(bodies.before_views))
    observed = people.by_person(views.observed)
    return slides(points, observed, people.rates) / (POINTS * _STILL**2)


def _label_losses(energy: MeshEnergy, bodies: PlacedBodies) -> torch.Tensor:
    """Evaluate the label loss of each picture, in pixels of a crop of ``options.size``."""
    options = energy.options
    found = []
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
        if energy.has_unknown_noise(bodies.people):
            loss = label_costs(loss, pictures.borders, pictures.size)
        found.append(loss if pictures.size == options.size else loss * (options.size / pictures.size) ** 2)
    return torch.cat(found) if len(found) > 1 else found[0]


def _by_cameras(people: Starts) -> float:
    return _SEVERAL_CAMERAS if people.num_views > 1 else 1.0


class MeshTerm(NamedTuple):
    """Term of the energy.

    Attributes:
        name: Name of the term.
        weight: Function that gives the factor of the cost for these people.
        cost: Function that gives the cost before it is weighted.
        applies: Function that tells if the energy of these people has this term.
    """

    name: str
    weight: Callable[[MeshEnergy, Starts], float]
    cost: Callable[[MeshEnergy, PlacedBodies], torch.Tensor]
    applies: Callable[[MeshEnergy, Starts], bool] = lambda energy, people: True


TERMS = (
    MeshTerm(
        "proj",
        lambda energy, people: _by_cameras(people) * energy.label_weights(people).proj * energy.options.proj,
        _keypoints,
    ),
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
        lambda energy, people: _by_cameras(people) * energy.label_weights(people).seg * energy.options.drawn_seg,
        _label_losses,
        lambda energy, people: bool(energy.label_pictures(people)),
    ),
)


def mesh_energy(model: DetailedModel, options: MeshOptions, label_set: LabelSet | None) -> MeshEnergy:
    """Make the energy of a batch of people with labels of one set. It is kept, because captured graphs belong to it."""
    return _mesh_energy(draw_model(model, options, label_set), options)


@device_cache(8)
def _mesh_energy(drawn: DrawnModel, options: MeshOptions) -> MeshEnergy:
    capsules = measure_capsules(drawn.model) if options.apart > 0 else None
    return MeshEnergy(drawn, options, capsules=capsules, apart=options.apart)
