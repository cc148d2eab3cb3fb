"""Differentiable forward kinematics of EllipBody on torch tensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
import torch
import warp as wp

from ..interop.captured_function import call_captured
from ..interop.checks import check_numbers, check_tensor
from ..interop.derivatives import is_transformed
from ..interop.graph_cache import Launch
from ..interop.layouts import Shapes, Tensors
from ..interop.movable import Movable
from ..kernels import kinematics
from . import plain_posing
from .bone_launches import DTYPES, BoneLaunches, kinematic_arrays
from .ellipbody import DEFAULT_SUBDIVISIONS, bone_tree
from .icosphere import icosphere
from .landmarks import landmark_points
from .rotations import rotation_from_6d, rotation_from_axis_angle
from .template import BODY_SHAPES, BODY_SIZES, NUM_JOINTS, NUM_PARTS


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

    def at(self, translation: torch.Tensor) -> Posed:
        """Copy of the bodies, moved by ``translation`` from where they are, shape (B, 3) [m]."""
        return replace(self, joints=self.joints + translation[:, None], centres=self.centres + translation[:, None])

    def vertices(self, subdivisions: int = DEFAULT_SUBDIVISIONS) -> torch.Tensor:
        """Mesh vertices in the order of ``ellipbody_faces``, shape (B, 20 N, 3) [m]; NaN where a size is 0 or less."""
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
        global_orient: Rotation of the whole body: matrices, shape (B, 3, 3), axis-angle [rad], (B, 3), or two columns,
            (B, 6), as ``rotation_from_axis_angle`` and ``rotation_from_6d`` take them.
        translation: Position of the pelvis [m], shape (B, 3).
        rotations: Local rotation of each bone in the same forms, shape (B, 20, 3, 3), (B, 20, 3) or (B, 20, 6).
        lengths: Lengths ``LENGTH_NAMES`` [m], shape (B, 12).
        thicknesses: Thicknesses ``THICKNESS_NAMES`` [m], full widths, shape (B, 15).
        validate: True looks for NaN, infinity, matrices that are no rotations and sizes that are not positive. On CUDA,
            that waits for the device. It is not done under ``torch.func`` and ``torch.compile``, which know no numbers.

    Returns:
        The posed bodies; float32 or float64, as the arguments.

    Raises:
        ValueError: If a shape, dtype or device does not fit the others, something is NaN, infinite or no rotation, or a
            length or thickness is 0 or less.
    """
    parameters = (global_orient, translation, rotations, lengths, thicknesses)
    check_parameters(parameters, dtypes=tuple(DTYPES))
    if validate and not _in_torch(*parameters):
        named = dict(zip(BODY_SHAPES, parameters, strict=True))
        check_numbers(named, rotations=matrices_of(parameters), positive=BODY_SIZES)
    return pose_parts(*parameters)


def pose_parts(*parameters: torch.Tensor, locked: int = 0) -> Posed:
    """Pose what was checked before; parts of ``locked``, a set of bits, keep their rest rotation."""
    if _in_torch(*parameters):
        return Posed(*_pose_in_torch(*parameters, locked=locked))
    if parameters[0].dtype == torch.float64:  # kernels make matrices of float32 alone
        return Posed(*_Bones.apply(0, *_as_matrices(parameters, locked)))
    return Posed(*_Bones.apply(locked, *parameters))


def check_parameters(parameters: Sequence[torch.Tensor], *, dtypes: Sequence[torch.dtype]) -> None:
    """Raise unless these are arguments of ``pose``, of one device and dtype."""
    first = parameters[0]
    if not isinstance(first, torch.Tensor) or first.dim() not in (2, 3):
        check_tensor("global_orient", first, (None, 3, 3), dtypes=dtypes)
    batch, like = first.shape[0], ("global_orient", first)
    for (name, shape), tensor in zip(BODY_SHAPES.items(), parameters, strict=True):
        wanted: tuple[int, ...] = (batch, *shape)
        if shape[-2:] == (3, 3) and isinstance(tensor, torch.Tensor) and tensor.dim() == len(shape):
            wanted = (*wanted[:-2], 6 if tensor.shape[-1] == 6 else 3)
        check_tensor(name, tensor, wanted, dtypes=dtypes, like=like)


def matrices_of(parameters: Sequence[torch.Tensor]) -> list[str]:
    """Names of the arguments of ``pose`` that are matrices."""
    rotations = (("global_orient", parameters[0], 3), ("rotations", parameters[2], 4))
    return [name for name, tensor, dim in rotations if tensor.dim() == dim]


def _as_matrices(parameters: Sequence[torch.Tensor], locked: int) -> list[torch.Tensor]:
    """The arguments of ``pose`` with rotations as matrices, by torch."""
    matrices = list(parameters)
    for index, dim in ((0, 3), (2, 4)):
        rotation = parameters[index]
        if rotation.dim() != dim:
            make = rotation_from_6d if rotation.shape[-1] == 6 else rotation_from_axis_angle
            matrices[index] = make(rotation)
    if locked:
        keeps = torch.tensor([[[bool(locked >> part & 1)]] for part in range(NUM_PARTS)], device=matrices[2].device)
        rest = torch.eye(3).to(matrices[2]) + 0 * matrices[2].detach()  # NaN of a locked part shows, too
        matrices[2] = torch.where(keeps, rest, matrices[2])
    return matrices


def _pose_in_torch(*parameters: torch.Tensor, locked: int) -> tuple[torch.Tensor, ...]:
    return plain_posing.pose_bones_by_torch(*_as_matrices(parameters, locked))


def _in_torch(*tensors: torch.Tensor) -> bool:
    """True if plain torch must do it: kernels can't be traced, and can't read what ``torch.func`` has wrapped."""
    return torch.compiler.is_compiling() or is_transformed(*tensors)


def _differentiable(*adjoints: torch.Tensor) -> bool:
    """True if a backward pass has to be differentiable itself, under ``create_graph``, or is one of many under vmap."""
    return torch.is_grad_enabled() or is_transformed(*adjoints)


class _Bones(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, locked: int, *parameters: torch.Tensor) -> tuple[torch.Tensor, ...]:
        ctx.save_for_backward(*parameters)
        ctx.set_materialize_grads(False)  # zeros are made once, in the graph's buffers
        ctx.locked = locked
        return call_captured(_prepare_bones, parameters, _posed_shapes(len(parameters[0])), locked)

    @staticmethod
    def backward(ctx: Any, *adjoints: torch.Tensor | None) -> tuple[torch.Tensor | None, ...]:
        parameters, locked = ctx.saved_tensors, ctx.locked
        given = tuple([adjoint for adjoint in adjoints if adjoint is not None])
        if not given:
            return (None,) * (1 + len(parameters))
        if _differentiable(*given):
            shapes = _posed_shapes(len(parameters[0]))
            full = zip(adjoints, shapes, strict=True)
            sent = tuple(parameters[0].new_zeros(shape) if each is None else each for each, shape in full)
            return None, *torch.func.vjp(partial(_pose_in_torch, locked=locked), *parameters)[1](sent)
        gradients = tuple([tensor.shape for tensor in parameters])
        missing = tuple([adjoint is None for adjoint in adjoints])
        return None, *call_captured(_prepare_bones_adjoint, (*parameters, *given), gradients, locked, missing)


class _Vertices(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, centres: torch.Tensor, axes: torch.Tensor, semi_axes: torch.Tensor, subdivisions: int
    ) -> torch.Tensor:
        ctx.save_for_backward(centres, axes, semi_axes)
        ctx.subdivisions = subdivisions
        shape = torch.Size((*centres.shape[:2], len(icosphere(subdivisions)[0]), 3))
        return call_captured(_prepare_vertices, (centres, axes, semi_axes), (shape,), subdivisions)[0]

    @staticmethod
    def backward(ctx: Any, adj_vertices: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        ellipsoids = ctx.saved_tensors
        if _differentiable(adj_vertices):
            place = partial(plain_posing.place_vertices_by_torch, subdivisions=ctx.subdivisions)
            return *torch.func.vjp(place, *ellipsoids)[1](adj_vertices), None
        gradients = tuple([tensor.shape for tensor in ellipsoids])
        inputs = *ellipsoids[1:], adj_vertices
        return *call_captured(_prepare_vertices_adjoint, inputs, gradients, ctx.subdivisions), None


@lru_cache(maxsize=32)
def _posed_shapes(batch: int) -> Shapes:
    """Shapes of the fields of ``Posed``."""
    fields = (NUM_JOINTS, 3), (NUM_PARTS, 3, 3), (NUM_PARTS, 3), (NUM_PARTS, 3, 3), (NUM_PARTS, 3)
    return tuple([torch.Size((batch, *shape)) for shape in fields])


def _prepare_bones(inputs: Tensors, outputs: Tensors, locked: int) -> Launch:
    """Launches that fill the fields of ``Posed`` from the arguments of ``pose``."""
    return partial(BoneLaunches(inputs, locked).launch, kinematic_arrays(outputs, "vmvmv"))


def _prepare_bones_adjoint(inputs: Tensors, outputs: Tensors, locked: int, missing: Sequence[bool]) -> Launch:
    """Launches that fill the gradients of ``pose``, from its arguments and the adjoints of what it returns.

    Args:
        inputs: Arguments of ``pose``, followed by the adjoints that are not ``missing``.
        outputs: Gradients of the arguments. They are filled.
        locked: Parts that keep their rest rotation, as bits.
        missing: Flag for each field of ``Posed`` whose adjoint is not given, and is zero.
    """
    parameters, given, like = inputs[:5], iter(inputs[5:]), inputs[3]
    bones, shapes = BoneLaunches(parameters, locked), _posed_shapes(len(like))
    posed = kinematic_arrays([like.new_empty(shape) for shape in shapes], "vmvmv")
    adjoints = [like.new_zeros(s) if none else next(given) for none, s in zip(missing, shapes, strict=True)]
    push = bones.prepare_adjoint(posed[1], kinematic_arrays(adjoints, "vmvmv"), outputs)

    def launch() -> None:
        bones.launch(posed)
        push()

    return launch


def _prepare_vertices(inputs: Tensors, outputs: Tensors, subdivisions: int) -> Launch:
    """Launches that fill the vertices (B, P, N, 3) of ellipsoids."""
    *ellipsoids, vertices = kinematic_arrays((*inputs, *outputs), "vmvv")
    return partial(kinematics.launch_vertices, _tree(inputs[0], subdivisions), ellipsoids, vertices)


def _prepare_vertices_adjoint(inputs: Tensors, outputs: Tensors, subdivisions: int) -> Launch:
    """Launches that fill the gradients of centres, axes and semi-axes, from axes, semi-axes and the adjoint."""
    arrays = kinematic_arrays((*inputs, *outputs), "mvvvmv")
    return partial(kinematics.launch_vertices_adjoint, _tree(inputs[0], subdivisions), arrays[:3], arrays[3:])


def _tree(like: torch.Tensor, subdivisions: int) -> kinematics.BoneTree:
    return bone_tree(wp.device_from_torch(like.device).alias, DTYPES[like.dtype]["s"], subdivisions)
