"""Energy of the mesh stage: detailed bodies of B people against their labels and keypoints, side by side."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import torch

from ...body.labels import BACKGROUND, IGNORE, LabelSet
from ...body.landmarks import landmark_points
from ...body.lens import through_lens
from ...body.parameters import BodyParameters, crop_camera
from ...body.pose_prior import FREE_PARTS
from ...body.template import JOINT_NAMES
from ...cameras import Camera
from ...inputs.observation import REFERENCE_SIZE, Observation, resize_nearest
from ...models.capsules import Capsules, measure_capsules
from ...models.clothes import bounded, clothes_basis, clothes_costs, dressed_model
from ...models.joint_merging import merge_joints
from ...models.joint_turns import turn_joints
from ...models.model import Detailed, DetailedModel, detailed_mesh
from ...models.point_sums import sum_points
from ...models.pose import free_joints, pose_from_ellipbody, turning_joints
from ...models.reduction import reduce_model, reduce_within
from ...models.registration import shape_from_lengths
from ...models.surfaces import is_closed
from ...networks.regression.uncertainty import Uncertainty
from ...render.mesh import mesh_label_loss
from ...render.part_mesh import PartMesh
from ..ellipsoids.energy import split_votes
from ..ellipsoids.result import FitResult
from .given_poses import GivenPoses
from .landmark_costs import LandmarkAims, landmark_costs
from .mesh_options import MeshOptions
from .mesh_unknowns import Posing, Starts, Unknowns
from .unknown_noise import border_lengths, keypoint_costs, label_costs

# Where no network said how sure it is, and of joints that it says nothing of: depth [m] and turns [rad].
_DEPTH_SPREAD, _TURN_SPREAD, _LOCKED_SPREAD = 0.1, 0.3, 0.05
_ROW = 32  # keypoints: people have so many, or a multiple, so that few sizes of captured graphs serve all


@dataclass(frozen=True, eq=False)
class MeshEnergy:
    """Terms of the mesh stage, for people whose labels are of one set.

    Attributes:
        model: Detailed model that is drawn, of few vertices and joints.
        mesh: Its faces with the labels' groups; None: without labels.
        hides: True if groups can hide one another.
        dressed: The same with thicknesses of clothes [m] behind its shape values.
        turning: Its joints in the whole model, shape (J,), int64.
        free: Those of them that the stage turns, shape (N,), int64.
        first: Vertices before this one carry no landmark.
        weights: Of all landmarks, over the other vertices and the joints.
        ends: Of ``JOINT_NAMES`` among the landmarks, shape (21,), int64.
        capsules: Of the model; None: nothing keeps its parts apart.
        options: Weights and size.
    """

    model: DetailedModel
    mesh: PartMesh | None
    hides: bool
    dressed: DetailedModel
    turning: torch.Tensor
    free: torch.Tensor
    first: int
    weights: torch.Tensor
    ends: torch.Tensor
    capsules: Capsules | None
    options: MeshOptions

    def factors(self, people: Starts) -> dict[str, float]:
        """Weights of all costs, by name."""
        return self.options.factors(self.options.apart, self.options.size)

    def __call__(self, people: Starts, unknowns: Unknowns) -> dict[str, torch.Tensor]:
        """Costs by name, shape (B, ...) each."""
        options = self.options
        posed = self.pose(people, unknowns)
        drawn, marked = self.split(posed)
        points = sum_points(self.weights, marked, posed.joints)
        camera, away = self._camera(people, unknowns, REFERENCE_SIZE)
        aims = LandmarkAims(
            people.places, people.points, people.votes, self.ends, people.depths, people.depth_spreads.pow(-2)
        )
        seen, deep = landmark_costs(points + away, camera, aims)
        costs = {
            "proj": keypoint_costs(seen, people.votes) if options.noise == "unknown" else seen,
            "depth": deep,
            "turns": unknowns.turns.square() / people.turn_spreads.square()[..., None],
            "shape": (unknowns.shape - people.shape).square(),
        }
        if options.clothes is not None:
            costs["clothes"] = clothes_costs(unknowns.clothes)
        if self.capsules is not None:
            costs["apart"] = self.capsules.overlap(self.capsules.of(posed, unknowns.shape))
        if people.target is not None and people.borders is not None and self.mesh is not None:
            camera, _ = self._camera(people, unknowns, options.size)
            wrong, _ = mesh_label_loss(
                drawn + away,
                self.mesh,
                camera,
                people.target,
                gradient=options.gradient,
                max_distance=options.max_distance,
                depth_weight=options.depth_weight if self.hides else 0.0,
                validate=False,
            )
            if options.noise == "unknown":
                wrong = label_costs(wrong, people.borders, options.size)
            costs["seg"] = wrong
        return costs

    def rates(self, people: Starts) -> torch.Tensor:
        """Learning rates, as of ``Unknowns``."""
        return Unknowns.rates(people)

    def moved(self, people: Starts, moves: torch.Tensor) -> Unknowns:
        """Numbers of people who moved, as of ``Unknowns``."""
        return Unknowns.moved(people, moves)

    def rotations(self, people: Posing, turns: torch.Tensor) -> torch.Tensor:
        """Local rotations of the drawn model's joints, shape (B, J, 3, 3)."""
        return turn_joints(people.rotations, self.free, turns)

    def whole_pose(
        self, model: DetailedModel, people: Posing, unknowns: Unknowns
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Shape values, local rotations and translation for the whole model's ``pose``; copies."""
        like = people.rotations
        rotations = torch.eye(3, dtype=like.dtype, device=like.device).repeat(len(like), model.num_joints, 1, 1)
        rotations[:, self.turning] = self.rotations(people, unknowns.turns)
        return unknowns.shape.clone(), rotations, people.translation.clone()

    def start_depths(self, people: Starts) -> torch.Tensor:
        """``Starts.depths`` of where the stage starts."""
        at_rest = Unknowns.moved(people, torch.zeros_like(Unknowns.rates(people)))
        return self.depths(self.landmarks(self.pose(people, at_rest))).detach()

    def pose(self, people: Posing, unknowns: Unknowns) -> Detailed:
        """The body that is drawn, the pelvis about the origin; a shape may be of several bodies, which follow it."""
        where = self.rotations(people, unknowns.turns), people.translation
        model, shape = self.model, unknowns.shape
        if self.options.clothes is not None:
            model, shape = self.dressed, torch.cat([shape, bounded(unknowns.clothes)], dim=1)
        if len(shape) == len(where[0]):
            return model.pose(shape, *where)
        rest, frames = model.rest(shape), len(where[0]) // len(shape)
        vertices, joints = (each.repeat_interleave(frames, 0) for each in (rest.vertices, rest.joints))
        return model.carry(vertices, joints, *where)

    def landmarks(self, posed: Detailed) -> torch.Tensor:
        """All of the model's, shape (B, L, 3)."""
        return sum_points(self.weights, self.split(posed)[1], posed.joints)

    def split(self, posed: Detailed) -> tuple[torch.Tensor, torch.Tensor]:
        """Vertices that are drawn, and those that carry landmarks."""
        if self.first == 0:
            return posed.vertices, posed.vertices
        # Not by slices, each of whose gradients would be filled up with zeros.
        drawn, marked = posed.vertices.split([self.first, self.model.num_vertices - self.first], dim=1)
        return drawn, marked

    def depths(self, points: torch.Tensor) -> torch.Tensor:
        """Depths of ``JOINT_NAMES`` but the pelvis, relative to it [m], shape (..., 20)."""
        depths = points[..., self.ends, 2]
        return depths[..., 1:] - depths[..., :1]

    @staticmethod
    def _camera(people: Starts, unknowns: Unknowns, size: int) -> tuple[Camera, torch.Tensor | float]:
        """Cameras, and what is added to points before them."""
        weak = crop_camera(unknowns.log_scale, unknowns.shift, size)
        camera, pelvis = through_lens(weak, people.lens, size)
        return camera, 0.0 if pelvis is None else pelvis[:, None]


def mesh_energy(model: DetailedModel, options: MeshOptions, label_set: LabelSet | None) -> MeshEnergy:
    """Energy of people with labels of this set; None: without any. Kept, for the model takes a while to be reduced."""
    drawn = label_set is not None and options.seg > 0
    groups = tuple(label_set.part_groups.tolist()) if label_set is not None and drawn else None
    return _mesh_energy(model, options, groups, label_set is not None and label_set.at_joints)


@lru_cache(maxsize=8)
def _mesh_energy(
    model: DetailedModel, options: MeshOptions, groups: tuple[int, ...] | None, at_joints: bool
) -> MeshEnergy:
    with torch.inference_mode(False):  # kept for calls outside of it, too
        reduced, first, basis = _reduced_by(model, options)
        names = reduced.landmark_names
        indices = turning_joints(model), free_joints(reduced), [names.index(name) for name in JOINT_NAMES]
        turning, free, ends = (torch.tensor(each, device=basis.device) for each in indices)
        mesh = None
        if groups is not None:
            whole = replace(detailed_mesh(reduced, at_joints), cull_backfaces=is_closed(model))
            mesh = whole.relabel(np.array(groups))
        hides = len(set(groups or ()) - {BACKGROUND, IGNORE}) > 1
        weights = reduced.landmark_weights[:, first:].contiguous()
        capsules = measure_capsules(reduced) if options.apart > 0 else None
        dressed = dressed_model(reduced, basis)
        return MeshEnergy(reduced, mesh, hides, dressed, turning, free, first, weights, ends, capsules, options)


def drawn_vertices(model: DetailedModel, options: MeshOptions) -> int:
    """Number of vertices of the mesh that is drawn."""
    few, first, _ = _reduced_by(model, options)
    return first or few.num_vertices


def _reduced_by(model: DetailedModel, options: MeshOptions) -> tuple[DetailedModel, int, torch.Tensor]:
    if options.vertices == "auto":
        return _reduced(model, None, options.skin_error)
    return _reduced(model, options.vertices, math.inf)


@lru_cache(maxsize=4)
def _reduced(model: DetailedModel, vertices: int | None, error: float) -> tuple[DetailedModel, int, torch.Tensor]:
    """The model that is drawn, its first vertex that carries a landmark, and its clothes' basis."""
    basis, merged = clothes_basis(model), merge_joints(model, turning_joints(model))
    drawn, few, reduced = 0, merged, None
    if vertices is None:
        reduced = reduce_within(merged, error)
    elif model.num_vertices > vertices:
        reduced = reduce_model(merged, vertices)
    if reduced is not None:
        drawn, few, basis = reduced.drawn, reduced.model, basis[:, reduced.kept]
    # Vertices that carry landmarks alone stay at the body.
    return few, drawn, torch.nn.functional.pad(basis, (0, 0, 0, few.num_vertices - basis.shape[1]))


def gather_starts(
    energy: MeshEnergy, model: DetailedModel, results: Sequence[FitResult], given: GivenPoses | None = None
) -> Starts:
    """Starts of people whose labels are of the energy's set; all have a camera, or none.

    Args:
        energy: Of ``mesh_energy``.
        model: The whole one.
        results: Each goes on from where its outline stage began.
        given: Bodies to start from instead, where the results see theirs.
    """
    start = BodyParameters.joined([each.before_outline or each.parameters for each in results])
    if given is None:
        posed = start.posed()
        shape = shape_from_lengths(model, posed)
        whole, translation = pose_from_ellipbody(model, posed, shape, trunk_along=True)
        rotations = whole[:, energy.turning]
    else:
        shape, rotations, translation = given.shape, given.turning_rotations(), given.translation
    seen = [each.observation for each in results]
    places, points, votes = gather_keypoints(energy.model, seen)
    depth_spreads, turn_spreads = gather_spreads(energy, [each.uncertainty for each in results], shape)
    target = borders = lens = None
    if energy.mesh is not None:
        labels = torch.stack([each.labels for each in seen if each.labels is not None])
        target = resize_nearest(labels, energy.options.size)
        borders = border_lengths(target)
    if seen[0].lens is not None:
        lens = torch.stack([each.lens for each in seen if each.lens is not None])
    people = Starts(
        rotations=rotations,
        translation=translation,
        shape=shape,
        log_scale=start.log_scale,
        shift=start.shift,
        places=places,
        points=points,
        votes=votes,
        depths=shape.new_zeros(len(shape), len(JOINT_NAMES) - 1),
        depth_spreads=depth_spreads,
        turn_spreads=turn_spreads,
        target=target,
        borders=borders,
        lens=lens,
    )
    return replace(people, depths=energy.start_depths(people))


def gather_keypoints(model: DetailedModel, seen: Sequence[Observation]) -> tuple[torch.Tensor, ...]:
    """``places``, ``points`` and ``votes`` of people."""
    device, columns = seen[0].points.device, -(-max(len(each.landmarks) for each in seen) // _ROW) * _ROW
    rows = [_keypoint_table(model, each.landmarks, each.body_points, columns) for each in seen]
    places, parts, known = torch.from_numpy(np.stack(rows, axis=1)).to(device)

    there = np.arange(columns) < np.array([[len(each.landmarks)] for each in seen])
    person, column = (torch.from_numpy(each).to(device) for each in there.nonzero())

    def padded(tensors: list[torch.Tensor]) -> torch.Tensor:
        given = torch.cat(tensors)
        found = given.new_zeros(len(seen), columns, *given.shape[1:])
        found[person, column] = given
        return found

    return (
        places,
        padded([each.points for each in seen]),
        known * split_votes(padded([each.confidence for each in seen]), parts),
    )


@lru_cache(maxsize=1024)
def _keypoint_table(
    model: DetailedModel, landmarks: tuple[str, ...], marks: tuple[str, ...], columns: int
) -> np.ndarray:
    """Landmark of the model, part, and 1 of each keypoint, 0 of one that the model has not, and 0: (3, columns)."""
    index = {name: place for place, name in enumerate(model.landmark_names)}
    found = [
        next((index[name] for name in names if name in index), None) for names in zip(marks, landmarks, strict=True)
    ]
    known = [place is not None for place in found]
    table = np.array([[place or 0 for place in found], landmark_points(landmarks).parts[:, 0], known], dtype=np.int64)
    return np.pad(table, ((0, 0), (0, columns - len(landmarks))))


def gather_spreads(
    energy: MeshEnergy, said: Sequence[Uncertainty | None], like: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """``depth_spreads`` and ``turn_spreads`` of people, of the dtype and on the device of ``like``."""
    count = 1 + len(FREE_PARTS)
    unsaid = like.new_full((1, len(JOINT_NAMES) - 1), _DEPTH_SPREAD), like.new_full((1, count), _TURN_SPREAD)
    depths = torch.cat([unsaid[0] if each is None else each.depths for each in said])
    turns = torch.cat([unsaid[1] if each is None else each.turns for each in said])
    others = like.new_tensor([[_TURN_SPREAD if each is None else _LOCKED_SPREAD] for each in said])
    turns = torch.cat([turns, others], dim=1)
    # The orientation is the root's, then come free parts; of other joints nothing is said.
    stated = {0: 0} | {energy.model.part_joints[part]: 1 + place for place, part in enumerate(FREE_PARTS)}
    columns = [stated.get(joint, count) for joint in free_joints(energy.model)]
    return depths, turns[:, columns]
