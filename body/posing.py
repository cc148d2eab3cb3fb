"""Differentiable forward kinematics of EllipBody on torch tensors."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
import warp as wp

from ..interop.arrays import contiguous, warp_array
from ..interop.checks import check_numbers, check_tensor
from ..interop.derivatives import is_transformed
from ..interop.movable import Movable
from ..interop.streams import on_torch_stream
from ..kernels import kinematics
from . import plain_posing
from .ellipbody import DEFAULT_SUBDIVISIONS, bone_tree
from .landmarks import landmark_points
from .template import BODY_SHAPES, NUM_JOINTS, NUM_PARTS, THICKNESS_NAMES

_WARP_TYPES = {torch.float32: (wp.float32, wp.vec3f, wp.mat33f), torch.float64: (wp.float64, wp.vec3d, wp.mat33d)}


@dataclass(frozen=True)
class Posed(Movable):
    """Posed bodies, differentiable any number of times, in the frame of the translation [m].

    Attributes:
        joints: ``JOINT_NAMES``, shape (B, 21, 3).
        rotations: Global rotation of each bone, shape (B, 20, 3, 3).
        centres: Ellipsoid centres, shape (B, 20, 3).
        axes: Ellipsoid axes as columns (bone, first thickness, second thickness), shape (B, 20, 3, 3).
        semi_axes: Half of length and thicknesses, shape (B, 20, 3).
    """

    joints: torch.Tensor
    rotations: torch.Tensor
    centres: torch.Tensor
    axes: torch.Tensor
    semi_axes: torch.Tensor

    def vertices(self, subdivisions: int = DEFAULT_SUBDIVISIONS) -> torch.Tensor:
        """Mesh vertices in the order of ``ellipbody_faces``, shape (B, 20 N, 3) [m]."""
        ellipsoids = self.centres, self.axes, self.semi_axes
        place = plain_posing.place_vertices_by_torch if _in_torch(*ellipsoids) else _Vertices.apply
        return place(*ellipsoids, subdivisions).flatten(1, 2)


class LandmarkGather:
    """Positions of landmarks on posed bodies.

    Args:
        names: L landmarks.
        device: The bodies' device.
    """

    def __init__(self, names: Sequence[str], device: torch.device | str) -> None:
        points = landmark_points(names)
        self.parts = torch.from_numpy(points.parts).to(device)
        self._normalised = torch.from_numpy(points.normalised.astype(np.float32)).to(device)
        self._weights = torch.from_numpy(points.weights.astype(np.float32)).to(device)

    def __call__(self, posed: Posed) -> torch.Tensor:
        """Compute the positions, shape (B, L, 3) [m], float32 or as the bodies."""
        local = posed.semi_axes[:, self.parts] * self._normalised.to(posed.semi_axes)
        points = posed.centres[:, self.parts] + (posed.axes[:, self.parts] @ local[..., None]).squeeze(-1)
        return (points * self._weights.to(points)[..., None]).sum(2)


def pose(
    global_orient: torch.Tensor,
    translation: torch.Tensor,
    rotations: torch.Tensor,
    lengths: torch.Tensor,
    thicknesses: torch.Tensor,
    *,
    validate: bool = True,
) -> Posed:
    """Pose EllipBody (paper, eq. 13 to 15); differentiable any number of times, also by ``torch.func``.

    Args:
        global_orient: Rotation of the whole body, shape (B, 3, 3).
        translation: Position of the pelvis [m], shape (B, 3).
        rotations: Local rotation of each bone, shape (B, 20, 3, 3); ``rotation_from_6d`` and
            ``rotation_from_axis_angle`` make some.
        lengths: ``LENGTH_NAMES`` [m], shape (B, 12).
        thicknesses: ``THICKNESS_NAMES`` [m], full widths, shape (B, 15).
        validate: Look for NaN, infinity and matrices that are no rotations; on CUDA that waits for the device. Not
            under ``torch.func`` and ``torch.compile``, which know no numbers.

    Returns:
        The posed bodies; float32 or float64, as the arguments.

    Raises:
        ValueError: If a shape, dtype or device does not fit the others, or something is NaN, infinite or no rotation.
    """
    check_tensor("global_orient", global_orient, (None, 3, 3), dtypes=tuple(_WARP_TYPES))
    batch = global_orient.shape[0]
    parameters = (global_orient, translation, rotations, lengths, thicknesses)
    for (name, shape), tensor in zip(BODY_SHAPES.items(), parameters, strict=True):
        check_tensor(name, tensor, (batch, *shape), dtypes=tuple(_WARP_TYPES), like=("global_orient", global_orient))
    if _in_torch(*parameters):
        return Posed(*plain_posing.pose_bones_by_torch(*parameters))
    if validate:
        check_numbers(dict(zip(BODY_SHAPES, parameters, strict=True)), rotations=("global_orient", "rotations"))
    return Posed(*_Bones.apply(*parameters))


def _in_torch(*tensors: torch.Tensor) -> bool:
    """True if plain torch must do it: kernels can't be traced, and can't read what ``torch.func`` has wrapped."""
    return torch.compiler.is_compiling() or is_transformed(*tensors)


def _differentiable(*adjoints: torch.Tensor) -> bool:
    """True if a backward pass has to be differentiable itself, under ``create_graph``, or is one of many under vmap."""
    return torch.is_grad_enabled() or is_transformed(*adjoints)


def _from_torch(tensors: Iterable[torch.Tensor], kinds: Iterable[type]) -> list[wp.array]:
    return [warp_array(contiguous(tensor), kind) for tensor, kind in zip(tensors, kinds, strict=True)]


class _Bones(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *parameters: torch.Tensor) -> tuple[torch.Tensor, ...]:
        lengths = parameters[3]
        scalar, vec, mat = _WARP_TYPES[lengths.dtype]
        batch = lengths.shape[0]
        joints = lengths.new_empty(batch, NUM_JOINTS, 3)
        rotations, axes = lengths.new_empty(2, batch, NUM_PARTS, 3, 3)
        centres, semi_axes = lengths.new_empty(2, batch, NUM_PARTS, 3)
        with on_torch_stream(lengths.device) as device:
            tree = bone_tree(device, scalar)
            inputs = _from_torch(parameters, (mat, vec, mat, scalar, scalar))
            posed = joints, rotations, centres, axes, semi_axes
            kinematics.launch_pose(tree, inputs, _from_torch(posed, (vec, mat, vec, mat, vec)))
        ctx.save_for_backward(*parameters, rotations)
        return posed

    @staticmethod
    def backward(ctx: Any, *adjoints: torch.Tensor) -> tuple[torch.Tensor, ...]:
        *parameters, rotations = ctx.saved_tensors
        if _differentiable(*adjoints):
            return torch.func.vjp(plain_posing.pose_bones_by_torch, *parameters)[1](adjoints)
        global_orient, _, local_rotations, lengths, _ = parameters
        scalar, vec, mat = _WARP_TYPES[lengths.dtype]
        # The kernel gathers into the first two, which autograd may share with others: copies.
        gathered = (adjoint.clone(memory_format=torch.contiguous_format) for adjoint in adjoints[:2])
        gradients = (
            torch.zeros_like(global_orient, memory_format=torch.contiguous_format),
            lengths.new_empty(lengths.shape[0], 3),
            lengths.new_empty(local_rotations.shape),
            torch.zeros_like(lengths, memory_format=torch.contiguous_format),
            lengths.new_zeros(lengths.shape[0], len(THICKNESS_NAMES)),
        )
        with on_torch_stream(lengths.device) as device:
            saved = _from_torch((global_orient, local_rotations, lengths, rotations), (mat, mat, scalar, mat))
            sent = _from_torch((*gathered, *adjoints[2:]), (vec, mat, vec, mat, vec))
            outputs = _from_torch(gradients, (mat, vec, mat, scalar, scalar))
            kinematics.launch_pose_adjoint(bone_tree(device, scalar), saved, sent, outputs)
        return gradients


class _Vertices(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, centres: torch.Tensor, axes: torch.Tensor, semi_axes: torch.Tensor, subdivisions: int
    ) -> torch.Tensor:
        scalar, vec, mat = _WARP_TYPES[centres.dtype]
        with on_torch_stream(centres.device) as device:
            tree = bone_tree(device, scalar, subdivisions)
            vertices = centres.new_empty(*centres.shape[:2], tree.unit_vertices.shape[0], 3)
            *inputs, output = _from_torch((centres, axes, semi_axes, vertices), (vec, mat, vec, vec))
            kinematics.launch_vertices(tree, inputs, output)
        ctx.save_for_backward(centres, axes, semi_axes)
        ctx.subdivisions = subdivisions
        return vertices

    @staticmethod
    def backward(ctx: Any, adj_vertices: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        centres, axes, semi_axes = ctx.saved_tensors
        if _differentiable(adj_vertices):
            place = partial(plain_posing.place_vertices_by_torch, subdivisions=ctx.subdivisions)
            return *torch.func.vjp(place, centres, axes, semi_axes)[1](adj_vertices), None
        scalar, vec, mat = _WARP_TYPES[axes.dtype]
        gradients = tuple(axes.new_empty(each.shape) for each in (semi_axes, axes, semi_axes))
        with on_torch_stream(axes.device) as device:
            tree = bone_tree(device, scalar, ctx.subdivisions)
            inputs = _from_torch((axes, semi_axes, adj_vertices), (mat, vec, vec))
            kinematics.launch_vertices_adjoint(tree, inputs, _from_torch(gradients, (vec, mat, vec)))
        return *gradients, None
