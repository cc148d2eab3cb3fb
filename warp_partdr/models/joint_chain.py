"""Joints of detailed bodies: products along their tree, by kernels or, to be differentiated again, by torch."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import torch
import warp as wp

from ..interop.arrays import warp_arrays
from ..interop.captured_function import call_captured
from ..interop.device_cache import device_cache
from ..interop.graph_cache import Launch
from ..interop.layouts import Tensors
from ..interop.operation import Gradients, OperationWithTwin
from ..kernels import joint_chain as kernels


def chain_joints(parents: tuple[int, ...], rotations: torch.Tensor, bones: torch.Tensor) -> torch.Tensor:
    """Each joint's frame, its rotation and its position, shape (B, J, 4, 4); differentiable as often as wanted.

    Args:
        parents: Parent of each joint, -1 for the root. A parent comes before its children.
        rotations: Rotation of each joint relative to its parent, shape (B, J, 3, 3), float32 or float64.
        bones: Vector from the parent to each joint, in the parent's axes, shape (B, J, 3). For the root, it is the
            root's position.
    """
    return _Chain(parents)(rotations, bones)[0]


def multiply_joints(parents: tuple[int, ...], rotations: torch.Tensor, bones: torch.Tensor) -> torch.Tensor:
    """Frames of the joints as in ``chain_joints``, by torch: products of 1, 2, 4, ... bones, so that few steps do."""
    local = homogeneous(rotations, bones)
    nowhere = torch.eye(4, dtype=local.dtype, device=local.device).expand(len(local), 1, 4, 4)
    world = torch.cat([local, nowhere], dim=1)
    for above in _jumps(parents, rotations.device):
        world = world.index_select(1, above) @ world
    return world[:, :-1]


def homogeneous(rotations: torch.Tensor, positions: torch.Tensor) -> torch.Tensor:
    """Rigid motions as matrices, shape (..., 4, 4)."""
    top = torch.cat([rotations, positions[..., None]], dim=-1)
    bottom = torch.eye(4, dtype=top.dtype, device=top.device)[3:].expand(*top.shape[:-2], 1, 4)
    return torch.cat([top, bottom], dim=-2)


@device_cache(32)
def _jumps(parents: tuple[int, ...], device: torch.device) -> list[torch.Tensor]:
    """Joint 1, 2, 4, ... bones above each joint, J where there is none; as many as the longest chain takes.

    Shape (J + 1,) each: above none there is none.
    """
    count = len(parents)
    above, jumps = [*(count if parent < 0 else parent for parent in parents), count], []
    with torch.inference_mode(False):  # kept for calls outside of it, too
        while any(joint < count for joint in above):
            jumps.append(torch.tensor(above, device=device))
            above = [above[joint] for joint in above]
    return jumps


@device_cache(32)
def _tree(parents: tuple[int, ...], device: str) -> Any:
    return kernels.make_joint_tree(parents, device)


@dataclass(frozen=True, eq=False)
class _Chain(OperationWithTwin):
    parents: tuple[int, ...]

    def forward(self, inputs: Tensors) -> tuple[Tensors, Tensors]:
        shape = torch.Size((*inputs[0].shape[:2], 4, 4))
        transforms = call_captured(_prepare, inputs, (shape,), self.parents)
        return transforms, transforms

    def adjoint(self, saved: Tensors, adjoints: Tensors) -> Gradients:
        rotations, bones, _ = saved
        return call_captured(_prepare_adjoint, (*saved, *adjoints), (rotations.shape, bones.shape), self.parents)

    def plain(self, inputs: Tensors) -> Tensors:
        rotations, bones = inputs
        return (multiply_joints(self.parents, rotations, bones),)


def _prepare(inputs: Tensors, outputs: Tensors, parents: tuple[int, ...]) -> Launch:
    """Launch that fills the joints' frames from their rotations and bones."""
    types = joint_types(inputs[0])
    *local, transforms = warp_arrays((*inputs, *outputs), (types.mat, types.vec, types.frame))
    return partial(kernels.launch_chain, tree_on(parents, inputs[0]), types.scalar(1.0), local, transforms)


def _prepare_adjoint(inputs: Tensors, outputs: Tensors, parents: tuple[int, ...]) -> Launch:
    """Launch that fills the gradients of rotations and bones from these, the frames and their adjoint."""
    types = joint_types(inputs[0])
    scratch = [torch.empty_like(each) for each in outputs]
    kinds = types.mat, types.vec
    *saved, adjoint = warp_arrays(inputs, (*kinds, types.frame, types.frame))
    found = warp_arrays((*scratch, *outputs), kinds * 2)
    return partial(kernels.launch_chain_adjoint, tree_on(parents, inputs[0]), saved, adjoint, found)


def joint_types(like: torch.Tensor) -> kernels.JointTypes:
    """Warp's types of a tensor's precision."""
    return kernels.SINGLE if like.dtype == torch.float32 else kernels.DOUBLE


def tree_on(parents: tuple[int, ...], like: torch.Tensor) -> Any:
    """The kernels' ``JointTree`` on a tensor's device."""
    return _tree(parents, wp.device_from_torch(like.device).alias)
