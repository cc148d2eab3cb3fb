"""Detailed model as a fit draws it: with few vertices and joints, with landmarks, and with the groups of labels."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch

from ...body.labels import BACKGROUND, IGNORE, LabelSet
from ...body.template import JOINT_NAMES
from ...interop.device_cache import device_cache
from ...models.clothes import bounded, clothes_basis, dressed_model
from ...models.joint_merging import merge_joints
from ...models.joint_turns import turn_joints
from ...models.model import Detailed, DetailedModel, detailed_mesh
from ...models.point_sums import sum_points
from ...models.pose import free_joints, turning_joints
from ...models.reduction import reduce_model, reduce_within
from ...models.surfaces import is_closed
from ...render.part_mesh import PartMesh
from .mesh_options import MeshOptions
from .starts import Starts, Unknowns


@dataclass(frozen=True, eq=False)
class DrawnModel:
    """Detailed model that is drawn in a fit, for people whose labels are of one set.

    Attributes:
        model: Model with few vertices and joints.
        mesh: Faces of the model with the groups of the labels; None if there are no labels.
        num_groups: Number of groups of the labels, background not counted; 0 if there are no labels.
        dressed: Model whose shape values are followed by thicknesses of clothes [m]; None if people wear none.
        turning: Indices of the model's joints in the whole model, shape (J,), int64.
        free: Indices of the model's joints that a fit turns, shape (F,), int64.
        first: Index of the first vertex that carries landmarks and is not drawn; 0 if all vertices are drawn and can
            carry landmarks.
        weights: Weights of all landmarks, over the vertices from ``first`` on and the joints.
        ends: Indices of ``JOINT_NAMES`` among the landmarks, shape (21,), int64.
    """

    model: DetailedModel
    mesh: PartMesh | None
    num_groups: int
    dressed: DetailedModel | None
    turning: torch.Tensor
    free: torch.Tensor
    first: int
    weights: torch.Tensor
    ends: torch.Tensor

    @property
    def hides(self) -> bool:
        """True if one group can hide another one."""
        return self.num_groups > 1

    def pose(self, people: Starts, unknowns: Unknowns) -> Detailed:
        """Pose N bodies with the pelvis near the origin; all frames of a person share one shape."""
        rotations = turn_joints(people.rotations, self.free, unknowns.turns)
        model = self.model
        shape = unknowns.shape
        if self.dressed is not None:
            model = self.dressed
            shape = torch.cat([shape, bounded(unknowns.clothes)], dim=1)
        if len(shape) == len(rotations):
            return model.pose(shape, rotations, people.translation)
        # The frames of a person differ in pose alone, so the rest pose is found once for a person.
        rest = model.rest(shape)
        frames = len(rotations) // len(shape)
        vertices = rest.vertices.repeat_interleave(frames, 0)
        joints = rest.joints.repeat_interleave(frames, 0)
        return model.carry(vertices, joints, rotations, people.translation)

    def whole_pose(
        self, model: DetailedModel, people: Starts, unknowns: Unknowns
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Find the arguments of the whole model's ``pose`` for N bodies.

        Returns:
            Copies of shape values (N, S), local rotations (N, joints, 3, 3) and translations (N, 3) [m].
        """
        like = people.rotations
        rotations = torch.eye(3, dtype=like.dtype, device=like.device).repeat(len(like), model.num_joints, 1, 1)
        rotations[:, self.turning] = turn_joints(like, self.free, unknowns.turns)
        return people.of_frames(unknowns.shape).clone(), rotations, people.translation.clone()

    def landmarks(self, posed: Detailed) -> torch.Tensor:
        """Find all landmarks of posed bodies [m], shape (N, L, 3)."""
        return sum_points(self.weights, self.split(posed)[1], posed.joints)

    def split(self, posed: Detailed) -> tuple[torch.Tensor, torch.Tensor]:
        """Split the vertices into those that are drawn and those that carry landmarks."""
        if self.first == 0:
            return posed.vertices, posed.vertices
        # Each slice would fill its gradient up with zeros; a split does not.
        drawn, marked = posed.vertices.split([self.first, self.model.num_vertices - self.first], dim=1)
        return drawn, marked

    def depths(self, points: torch.Tensor) -> torch.Tensor:
        """Find the depths of ``JOINT_NAMES`` relative to the pelvis [m], shape (..., 20).

        Args:
            points: All landmarks, shape (..., L, 3).
        """
        depths = points[..., self.ends, 2]
        return depths[..., 1:] - depths[..., :1]


def draw_model(model: DetailedModel, options: MeshOptions, label_set: LabelSet | None) -> DrawnModel:
    """Reduce a model to the part that a fit draws. The result is kept, because reducing a model takes a while.

    Args:
        model: Whole detailed model.
        options: Options of the mesh stage.
        label_set: Label set of the people; None if there are no labels.
    """
    drawn = label_set is not None and options.seg > 0
    groups = tuple(label_set.part_groups.tolist()) if label_set is not None and drawn else None
    return _draw_model(model, options, groups, label_set is not None and label_set.at_joints)


@device_cache(8)
def _draw_model(
    model: DetailedModel, options: MeshOptions, groups: tuple[int, ...] | None, at_joints: bool
) -> DrawnModel:
    with torch.inference_mode(False):  # the cached model also serves calls outside of inference mode
        reduced, first, basis = _reduced_by(model, options)
        names = reduced.landmark_names
        device = basis.device
        turning = torch.tensor(turning_joints(model), device=device)
        free = torch.tensor(free_joints(reduced), device=device)
        ends = torch.tensor([names.index(name) for name in JOINT_NAMES], device=device)
        mesh = None
        if groups is not None:
            whole = replace(detailed_mesh(reduced, at_joints), cull_backfaces=is_closed(model))
            mesh = whole.relabel(np.array(groups))
        num_groups = len(set(groups or ()) - {BACKGROUND, IGNORE})
        weights = reduced.landmark_weights[:, first:].contiguous()
        dressed = None if options.clothes is None else dressed_model(reduced, basis)
        return DrawnModel(reduced, mesh, num_groups, dressed, turning, free, first, weights, ends)


def few_joints(model: DetailedModel) -> DetailedModel:
    """Merge the joints that a fit does not turn with those above them."""
    return merge_joints(model, turning_joints(model))


def drawn_vertices(model: DetailedModel, options: MeshOptions) -> int:
    """Number of vertices of the mesh that a fit draws."""
    few, first, _ = _reduced_by(model, options)
    return first or few.num_vertices


def _reduced_by(model: DetailedModel, options: MeshOptions) -> tuple[DetailedModel, int, torch.Tensor]:
    if options.vertices == "auto":
        return _reduced(model, None, options.skin_error)
    return _reduced(model, options.vertices, math.inf)


@device_cache(4)
def _reduced(model: DetailedModel, vertices: int | None, error: float) -> tuple[DetailedModel, int, torch.Tensor]:
    """Reduce a model; return it with its first vertex that carries a landmark, and the basis of its clothes."""
    basis = clothes_basis(model)
    merged = few_joints(model)
    first = 0
    few = merged
    reduced = None
    if vertices is None:
        reduced = reduce_within(merged, error)
    elif model.num_vertices > vertices:
        reduced = reduce_model(merged, vertices)
    if reduced is not None:
        first = reduced.drawn
        few = reduced.model
        basis = basis[:, reduced.kept]
    # Clothes do not move the vertices that only carry landmarks.
    return few, first, torch.nn.functional.pad(basis, (0, 0, 0, few.num_vertices - basis.shape[1]))
