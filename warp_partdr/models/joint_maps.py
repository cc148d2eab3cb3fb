"""Maps by which joints carry skin: by kernels or, to be differentiated again, by torch."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import torch

from ..interop.arrays import warp_array
from ..interop.captured_function import call_captured
from ..interop.derivatives import differentiate_again, is_transformed
from ..interop.graph_cache import Launch
from ..interop.layouts import Tensors
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
    if torch.compiler.is_compiling() or is_transformed(rotations, translation, rest):
        return _map(parents, rotations, translation, rest)
    found: Tensors = _Mapped.apply(parents, rotations, translation, rest)
    return found


def _map(parents: tuple[int, ...], rotations: torch.Tensor, translation: torch.Tensor, rest: torch.Tensor) -> Tensors:
    bones = torch.cat([translation[:, None], rest[:, 1:] - rest[:, list(parents[1:])]], dim=1)
    transforms = multiply_joints(parents, rotations, bones)
    places = transforms[..., :3, 3]
    return transforms, places, map_rows(transforms[..., :3, :3], places, rest)


class _Mapped(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, parents: tuple[int, ...], rotations: torch.Tensor, translation: torch.Tensor, rest: torch.Tensor
    ) -> Tensors:
        batch, joints = rest.shape[:2]
        shapes = torch.Size((batch, joints, 4, 4)), rest.shape, torch.Size((batch, 12, joints))
        found = call_captured(_prepare, (rotations, translation, rest), shapes, parents)
        ctx.parents = parents
        ctx.set_materialize_grads(False)  # zeros are made once, in the graph's buffers
        ctx.save_for_backward(rotations, translation, rest, found[0])
        return found

    @staticmethod
    def backward(ctx: Any, *adjoints: torch.Tensor | None) -> tuple[torch.Tensor | None, ...]:
        rotations, translation, rest, transforms = ctx.saved_tensors
        given = tuple([adjoint for adjoint in adjoints if adjoint is not None])
        if not given:
            return None, None, None, None
        missing = tuple([adjoint is None for adjoint in adjoints])
        inputs = rotations, translation, rest
        if torch.is_grad_enabled():
            own = partial(_some, ctx.parents, missing)
            return None, *differentiate_again(own, inputs, torch.cat([each.flatten() for each in given]))
        shapes = rotations.shape, translation.shape, rest.shape
        saved = rotations, translation, rest, transforms, *given
        return None, *call_captured(_prepare_adjoint, saved, shapes, ctx.parents, missing)


def _some(parents: tuple[int, ...], missing: Sequence[bool], *inputs: torch.Tensor) -> torch.Tensor:
    """All results that are not missing, flattened into one vector."""
    found = zip(_map(parents, *inputs), missing, strict=True)
    return torch.cat([each.flatten() for each, none in found if not none])


def _prepare(inputs: Tensors, outputs: Tensors, parents: tuple[int, ...]) -> Launch:
    """Launches that fill frames, places and maps from rotations, translation and rest."""
    types, tree = joint_types(inputs[0]), tree_on(parents, inputs[0])
    rotations, translation, rest = _arrays(inputs, (types.mat, types.vec, types.vec))
    transforms, places, maps = _arrays(outputs, (types.frame, types.vec, types.scalar))
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
    adjoints = _arrays(tuple(sent), (types.frame, types.vec, types.scalar))
    rotations, translation, rest, transforms = _arrays(inputs[:4], (types.mat, types.vec, types.vec, types.frame))
    grad_rotations, grad_translation, grad_rest = _arrays(outputs, (types.mat, types.vec, types.vec))
    bones, turn_sums, place_sums, grad_bones, sums = (
        warp_array(torch.empty_like(like), kind)
        for like, kind in zip(
            (at_rest, outputs[0], at_rest, at_rest, frames),
            (types.vec, types.mat, types.vec, types.vec, types.frame),
            strict=True,
        )
    )

    def launch() -> None:
        kernels.launch_bones(tree, translation, rest, bones)
        kernels.launch_maps_adjoint(transforms, rest, adjoints, sums, grad_rest)
        found = turn_sums, place_sums, grad_rotations, grad_bones
        chain.launch_chain_adjoint(tree, (rotations, bones, transforms), sums, found)
        kernels.launch_bones_adjoint(tree, grad_bones, grad_translation, grad_rest)

    return launch


def _arrays(tensors: Tensors, kinds: Sequence[type]) -> list[Any]:
    return [warp_array(each, kind) for each, kind in zip(tensors, kinds, strict=True)]
