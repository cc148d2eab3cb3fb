"""Differentiable forward kinematics of EllipBody on torch tensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np
import torch
import warp as wp

from ..errors import check_whole
from ..interop.captured_function import call_captured, find_together
from ..interop.checks import check_numbers, check_tensor
from ..interop.custom_operations import register_function, split_symbolic
from ..interop.graph_cache import Launch
from ..interop.layouts import Shapes, Tensors, split_blocks
from ..interop.movable import Movable
from ..interop.operation import Gradients, OperationWithTwin, must_be_plain, split_missing
from ..kernels import kinematics
from . import plain_posing
from .bone_launches import DTYPES, BoneLaunches, kinematic_arrays
from .ellipbody import DEFAULT_SUBDIVISIONS, bone_tree
from .icosphere import MAX_SUBDIVISIONS
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

    Examples:
        >>> import torch
        >>> from warp_partdr import BodyParameters, Posed
        >>> posed: Posed = BodyParameters.mean(1).posed()
        >>> posed.joints.shape, posed.vertices(subdivisions=2).shape
        (torch.Size([1, 21, 3]), torch.Size([1, 3240, 3]))
        >>> posed.at(torch.tensor([[0.0, 0.0, 3.0]])).joints[0, 0]  # the pelvis, 3 m in front of the camera
        tensor([0., 0., 3.])
    """

    joints: torch.Tensor
    rotations: torch.Tensor
    centres: torch.Tensor
    axes: torch.Tensor
    semi_axes: torch.Tensor

    def at(self, translation: torch.Tensor) -> Posed:
        """Copy of the bodies, moved by ``translation`` from where they are, shape (B, 3) [m].

        Examples:
            >>> import torch
            >>> from warp_partdr import BodyParameters
            >>> posed = BodyParameters.mean(1).posed()
            >>> moved = posed.at(torch.tensor([[0.5, 0.0, 0.0]]))
            >>> torch.allclose(moved.joints[..., 0], posed.joints[..., 0] + 0.5)
            True
        """
        return replace(self, joints=self.joints + translation[:, None], centres=self.centres + translation[:, None])

    def vertices(self, subdivisions: int = DEFAULT_SUBDIVISIONS) -> torch.Tensor:
        """Mesh vertices in the order of ``ellipbody_faces``, shape (B, 20 N, 3) [m]; NaN where a size is 0 or less.

        Raises:
            ValueError: If ``subdivisions`` is not 0, 1, 2 or 3.

        Examples:
            >>> from warp_partdr import BodyParameters, ellipbody_mesh
            >>> posed = BodyParameters.mean(1).posed()
            >>> posed.vertices(1).shape, ellipbody_mesh(1).faces.shape
            (torch.Size([1, 840, 3]), torch.Size([1600, 3]))
        """
        level = check_whole("subdivisions", subdivisions, 0, MAX_SUBDIVISIONS)
        (vertices,) = _Vertices(level)(self.centres, self.axes, self.semi_axes)
        return vertices.flatten(1, 2)


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

    Examples:
        >>> import torch
        >>> from warp_partdr import JOINT_NAMES, PART_NAMES, BodyParameters, pose
        >>> mean = BodyParameters.mean(1)
        >>> bent = torch.zeros(1, 20, 3)
        >>> bent[0, PART_NAMES.index("left_lower_leg"), 0] = 1.2  # a knee [rad]
        >>> posed = pose(torch.zeros(1, 3), torch.zeros(1, 3), bent, mean.lengths, mean.thicknesses)
        >>> posed.joints.shape
        torch.Size([1, 21, 3])
        >>> ankles = posed.joints[0, [JOINT_NAMES.index("left_ankle"), JOINT_NAMES.index("right_ankle")]]
        >>> bool(ankles[0, 2] < ankles[1, 2])  # the body looks along z: the left ankle has moved backward
        True
    """
    parameters = {
        "global_orient": global_orient,
        "translation": translation,
        "rotations": rotations,
        "lengths": lengths,
        "thicknesses": thicknesses,
    }
    tensors = tuple(parameters.values())
    check_parameters(tensors, dtypes=tuple(DTYPES))
    if validate and not must_be_plain(*tensors):
        check_numbers(parameters, rotations=matrices_of(tensors), positive=BODY_SIZES)
    return pose_parts(global_orient, translation, rotations, lengths, thicknesses)


def pose_parts(
    global_orient: torch.Tensor,
    translation: torch.Tensor,
    rotations: torch.Tensor,
    lengths: torch.Tensor,
    thicknesses: torch.Tensor,
    *,
    locked: int = 0,
) -> Posed:
    """Pose what was checked before; parts of ``locked``, a set of bits, keep their rest rotation."""
    if global_orient.dtype == torch.float64:  # kernels make matrices of float32 alone
        global_orient, rotations = _as_matrices(global_orient, rotations, locked)
        locked = 0
    return Posed(*_Bones(locked)(global_orient, translation, rotations, lengths, thicknesses))


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


def _as_matrices(
    global_orient: torch.Tensor, rotations: torch.Tensor, locked: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """Both rotations among the arguments of ``pose`` as matrices, by torch, and at rest where they are locked."""
    if global_orient.dim() != 3:
        global_orient = _rotation_matrices(global_orient)
    if rotations.dim() != 4:
        rotations = _rotation_matrices(rotations)
    if locked:
        keeps = torch.tensor([[[bool(locked >> part & 1)]] for part in range(NUM_PARTS)], device=rotations.device)
        rest = torch.eye(3).to(rotations) + 0 * rotations.detach()  # NaN of a locked part shows, too
        rotations = torch.where(keeps, rest, rotations)
    return global_orient, rotations


def _rotation_matrices(rotation: torch.Tensor) -> torch.Tensor:
    return rotation_from_6d(rotation) if rotation.shape[-1] == 6 else rotation_from_axis_angle(rotation)


@dataclass(frozen=True, eq=False)
class _Bones(OperationWithTwin):
    """Fields of ``Posed`` from the arguments of ``pose``."""

    locked: int

    def forward(self, inputs: Tensors) -> tuple[Tensors, Tensors]:
        return call_captured(_prepare_bones, inputs, _posed_shapes(len(inputs[0])), self.locked), ()

    def adjoint(self, saved: Tensors, adjoints: Gradients) -> Gradients:
        shapes = tuple([each.shape for each in saved])
        given, missing = split_missing(adjoints)
        return call_captured(_prepare_bones_adjoint, (*saved, *given), shapes, self.locked, missing)

    def plain(self, inputs: Tensors) -> Tensors:
        global_orient, translation, rotations, lengths, thicknesses = inputs
        global_orient, rotations = _as_matrices(global_orient, rotations, self.locked)
        return plain_posing.pose_bones_by_torch(global_orient, translation, rotations, lengths, thicknesses)

    def compiled(self, inputs: Tensors) -> Tensors:
        together = torch.ops.warp_partdr.pose_bones(list(inputs), self.locked)
        return split_symbolic(together, _shapes_of_posed(inputs[3].shape[0]))


@dataclass(frozen=True, eq=False)
class _Vertices(OperationWithTwin):
    """Vertices (B, P, N, 3) of ellipsoids, from their centres, axes and semi-axes."""

    subdivisions: int

    def forward(self, inputs: Tensors) -> tuple[Tensors, Tensors]:
        return call_captured(
            _prepare_vertices, inputs, _vertex_shapes(inputs, self.subdivisions), self.subdivisions
        ), ()

    def adjoint(self, saved: Tensors, adjoints: Tensors) -> Gradients:
        centres, axes, semi_axes = saved
        shapes = centres.shape, axes.shape, semi_axes.shape
        return call_captured(_prepare_vertices_adjoint, (axes, semi_axes, *adjoints), shapes, self.subdivisions)

    def plain(self, inputs: Tensors) -> Tensors:
        centres, axes, semi_axes = inputs
        return (plain_posing.place_vertices_by_torch(centres, axes, semi_axes, self.subdivisions),)

    def compiled(self, inputs: Tensors) -> Tensors:
        together = torch.ops.warp_partdr.place_vertices(list(inputs), self.subdivisions)
        return split_symbolic(together, _vertex_shapes(inputs, self.subdivisions))


def _shapes_of_posed(batch: int) -> Shapes:
    """Shapes of the fields of ``Posed``."""
    fields = (NUM_JOINTS, 3), (NUM_PARTS, 3, 3), (NUM_PARTS, 3), (NUM_PARTS, 3, 3), (NUM_PARTS, 3)
    return tuple([torch.Size((batch, *shape)) for shape in fields])


_posed_shapes = lru_cache(maxsize=32)(_shapes_of_posed)


def _vertex_shapes(inputs: Tensors, subdivisions: int) -> Shapes:
    """Shape of the vertices of ellipsoids."""
    batch, count, _ = inputs[0].shape
    return (torch.Size((batch, count, 10 * 4**subdivisions + 2, 3)),)


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


def _find_bones(inputs: Tensors, locked: int) -> torch.Tensor:
    return find_together(_prepare_bones, inputs, _posed_shapes(inputs[3].shape[0]), locked)


def _find_bones_adjoint(inputs: Tensors, adjoints: torch.Tensor, locked: int) -> torch.Tensor:
    shapes = tuple([each.shape for each in inputs])
    given = split_blocks(adjoints.contiguous(), _posed_shapes(inputs[3].shape[0]))
    return find_together(_prepare_bones_adjoint, (*inputs, *given), shapes, locked, (False,) * len(given))


def _find_vertices(inputs: Tensors, subdivisions: int) -> torch.Tensor:
    return find_together(_prepare_vertices, inputs, _vertex_shapes(inputs, subdivisions), subdivisions)


def _find_vertices_adjoint(inputs: Tensors, adjoints: torch.Tensor, subdivisions: int) -> torch.Tensor:
    shapes = tuple([each.shape for each in inputs])
    given = (*inputs[1:], *split_blocks(adjoints.contiguous(), _vertex_shapes(inputs, subdivisions)))
    return find_together(_prepare_vertices_adjoint, given, shapes, subdivisions)


register_function(
    *("pose_bones", "pose"), lambda inputs, _: _shapes_of_posed(inputs[3].shape[0]), _find_bones, _find_bones_adjoint
)
register_function("place_vertices", "vertices", _vertex_shapes, _find_vertices, _find_vertices_adjoint)
