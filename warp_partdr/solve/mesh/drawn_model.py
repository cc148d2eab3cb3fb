"""Detailed model as a fit draws it: of few vertices and joints, with the landmarks that are seen and labels' groups."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import torch

from ...body.labels import BACKGROUND, IGNORE, LabelSet
from ...body.template import JOINT_NAMES
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
    """Detailed model that is drawn, for people whose labels are of one set.

    Attributes:
        model: The model, of few vertices and joints.
        mesh: Its faces with the labels' groups; None: without labels.
        hides: True if groups can hide one another.
        dressed: The model with thicknesses of clothes [m] behind its shape values; None: people wear none.
        turning: Its joints in the whole model, shape (J,), int64.
        free: Those of them that a fit turns, shape (N,), int64.
        first: Vertices before this one carry no landmark.
        weights: Weights of all landmarks, over the other vertices and the joints.
        ends: ``JOINT_NAMES`` among the landmarks, shape (21,), int64.
    """

    model: DetailedModel
    mesh: PartMesh | None
    hides: bool
    dressed: DetailedModel | None
    turning: torch.Tensor
    free: torch.Tensor
    first: int
    weights: torch.Tensor
    ends: torch.Tensor

    def pose(self, people: Starts, unknowns: Unknowns) -> Detailed:
        """Pose N bodies, the pelvis about the origin; a shape may be of several bodies, which follow it."""
        where = turn_joints(people.rotations, self.free, unknowns.turns), people.translation
        model, shape = self.model, unknowns.shape
        if self.dressed is not None:
            model, shape = self.dressed, torch.cat([shape, bounded(unknowns.clothes)], dim=1)
        if len(shape) == len(where[0]):
            return model.pose(shape, *where)
        rest, frames = model.rest(shape), len(where[0]) // len(shape)
        vertices, joints = (each.repeat_interleave(frames, 0) for each in (rest.vertices, rest.joints))
        return model.carry(vertices, joints, *where)

    def whole_pose(
        self, model: DetailedModel, people: Starts, unknowns: Unknowns
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Shape values, local rotations and translation of N bodies for the whole model's ``pose``; copies."""
        like = people.rotations
        rotations = torch.eye(3, dtype=like.dtype, device=like.device).repeat(len(like), model.num_joints, 1, 1)
        rotations[:, self.turning] = turn_joints(like, self.free, unknowns.turns)
        return people.of_frames(unknowns.shape).clone(), rotations, people.translation.clone()

    def landmarks(self, posed: Detailed) -> torch.Tensor:
        """All of the model's landmarks, shape (N, L, 3)."""
        return sum_points(self.weights, self.split(posed)[1], posed.joints)

    def split(self, posed: Detailed) -> tuple[torch.Tensor, torch.Tensor]:
        """Vertices that are drawn, and those that carry landmarks."""
        if self.first == 0:
            return posed.vertices, posed.vertices
        # Not by slices, each of whose gradients would be filled up with zeros.
        drawn, marked = posed.vertices.split([self.first, self.model.num_vertices - self.first], dim=1)
        return drawn, marked

    def depths(self, points: torch.Tensor) -> torch.Tensor:
        """Depths of ``JOINT_NAMES`` but the pelvis, relative to it [m], of landmarks (..., L, 3), shape (..., 20)."""
        depths = points[..., self.ends, 2]
        return depths[..., 1:] - depths[..., :1]


def draw_model(model: DetailedModel, options: MeshOptions, label_set: LabelSet | None) -> DrawnModel:
    """Reduce a model to what is drawn of people with labels of this set; None: without any.

    It is kept, for the model takes a while to be reduced.
    """
    drawn = label_set is not None and options.seg > 0
    groups = tuple(label_set.part_groups.tolist()) if label_set is not None and drawn else None
    return _draw_model(model, options, groups, label_set is not None and label_set.at_joints)


@lru_cache(maxsize=8)
def _draw_model(
    model: DetailedModel, options: MeshOptions, groups: tuple[int, ...] | None, at_joints: bool
) -> DrawnModel:
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
        dressed = None if options.clothes is None else dressed_model(reduced, basis)
        return DrawnModel(reduced, mesh, hides, dressed, turning, free, first, weights, ends)


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
