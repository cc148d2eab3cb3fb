"""Maps by which joints carry skin: by kernels or, to be differentiated again, by torch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from ..interop.arrays import warp_array, warp_arrays
from ..interop.captured_function import call_captured
from ..interop.graph_cache import Launch
from ..interop.layouts import Tensors
from ..interop.operation import Gradients, OperationWithTwin, split_missing
from ..kernels import joint_chain as chain
from ..kernels import joint_maps as kernels
from .joint_chain import joint_types, multiply_joints, tree_on
from .skinning import map_rows


def map_joints(
    parents: tuple[int, ...], rotations: torch.Tensor, translation: torch.Tensor, rest: torch.Tensor
) -> Tensors:
    """Frames of joints, shape (B, J, 4, 4), their places, (B, J, 3), and maps for ``carry_skin``, (B, 12, J).

    Args:
        parents: Parent of each joint, -1 for the root, which is the first one. A parent comes before its children.
        rotations: Rotation of each joint relative to its parent, shape (B, J, 3, 3), float32 or float64.
        translation: Position of the root, shape (B, 3).
        rest: Positions of joints at rest, where their axes are those of the body, shape (B, J, 3).
    """
    return _Mapped(parents)(rotations, translation, rest)


@dataclass(frozen=True, eq=False)
class _Mapped(OperationWithTwin):
    parents: tuple[int, ...]

    def forward(self, inputs: Tensors) -> tuple[Tensors, Tensors]:
        rest = inputs[2]
        batch, joints = rest.shape[:2]
        shapes = torch.Size((batch, joints, 4, 4)), rest.shape, torch.Size((batch, 12, joints))
        found = call_captured(_prepare, inputs, shapes, self.parents)
        return found, found[:1]

    def adjoint(self, saved: Tensors, adjoints: Gradients) -> Gradients:
        rotations, translation, rest, _ = saved
        shapes = rotations.shape, translation.shape, rest.shape
        given, missing = split_missing(adjoints)
        return call_captured(_prepare_adjoint, (*saved, *given), shapes, self.parents, missing)

    def plain(self, inputs: Tensors) -> Tensors:
        rotations, translation, rest = inputs
        bones = torch.cat([translation[:, None], rest[:, 1:] - rest[:, list(self.parents[1:])]], dim=1)
        transforms = multiply_joints(self.parents, rotations, bones)
        places = transforms[..., :3, 3]
        return transforms, places, map_rows(transforms[..., :3, :3], places, rest)


def _prepare(inputs: Tensors, outputs: Tensors, parents: tuple[int, ...]) -> Launch:
    """Launches that fill frames, places and maps from rotations, translation and rest."""
    types, tree = joint_types(inputs[0]), tree_on(parents, inputs[0])
    rotations, translation, rest = warp_arrays(inputs, (types.mat, types.vec, types.vec))
    transforms, places, maps = warp_arrays(outputs, (types.frame, types.vec, types.scalar))
    bones = warp_array(torch.empty_like(inputs[2]), types.vec)

    def launch() -> None:
        kernels.launch_bones(tree, translation, rest, bones)
        chain.launch_chain(tree, types.scalar(1.0), (rotations, bones), transforms)
        kernels.launch_maps(transforms, rest, places, maps)

    return launch


def _prepare_adjoint(inputs: Tensors, outputs: Tensors, parents: tuple[int, ...], missing: Sequence[bool]) -> Launch:
    """Launches that fill the gradients of rotations, translation and rest.

    Args:
        inputs: Rotations, translation, rest and frames, followed by the adjoints that are not ``missing``.
        outputs: Gradients of rotations, translation and rest. They are filled.
        parents: Parent of each joint, as in ``map_joints``.
        missing: Flag for each of frames, places and maps whose adjoint is not given, and is zero.
    """
    types, tree = joint_types(inputs[0]), tree_on(parents, inputs[0])
    at_rest, frames, given = inputs[2], inputs[3], iter(inputs[4:])
    batch, joints = at_rest.shape[:2]
    shapes = frames.shape, at_rest.shape, (batch, 12, joints)
    sent = [at_rest.new_zeros(s) if none else next(given) for none, s in zip(missing, shapes, strict=True)]
    adjoints = warp_arrays(tuple(sent), (types.frame, types.vec, types.scalar))
    rotations, translation, rest, transforms = warp_arrays(inputs[:4], (types.mat, types.vec, types.vec, types.frame))
    grad_rotations, grad_translation, grad_rest = warp_arrays(outputs, (types.mat, types.vec, types.vec))
    scratch = [torch.empty_like(each) for each in (at_rest, at_rest, outputs[0], at_rest, frames)]
    bones, grad_bones, turn_sums, place_sums, sums = warp_arrays(
        scratch, (types.vec, types.vec, types.mat, types.vec, types.frame)
    )

    def launch() -> None:
        kernels.launch_bones(tree, translation, rest, bones)
        kernels.launch_maps_adjoint(transforms, rest, adjoints, sums, grad_rest)
        found = turn_sums, place_sums, grad_rotations, grad_bones
        chain.launch_chain_adjoint(tree, (rotations, bones, transforms), sums, found)
        kernels.launch_bones_adjoint(tree, grad_bones, grad_translation, grad_rest)

    return launch
