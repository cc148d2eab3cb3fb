"""Joints of detailed bodies: products along their tree, by kernels or, to be differentiated again, by torch."""

from __future__ import annotations

from functools import lru_cache, partial
from typing import Any

import torch

from ..interop.arrays import contiguous, warp_array
from ..interop.derivatives import differentiate_again, is_transformed
from ..interop.streams import on_torch_stream
from ..kernels import joint_chain as kernels


def chain_joints(parents: tuple[int, ...], rotations: torch.Tensor, bones: torch.Tensor) -> torch.Tensor:
    """Each joint's frame, its rotation and its position, shape (B, J, 4, 4); differentiable as often as wanted.

    Args:
        parents: Parent of each joint, -1 for the root; a parent comes before its children.
        rotations: Of each joint against its parent, shape (B, J, 3, 3), float32 or float64.
        bones: From each joint's parent to it, in the parent's axes; of the root, its position; shape (B, J, 3).
    """
    if torch.compiler.is_compiling() or is_transformed(rotations, bones):
        return multiply_joints(parents, rotations, bones)
    found: torch.Tensor = _Chain.apply(parents, rotations, bones)
    return found


def multiply_joints(parents: tuple[int, ...], rotations: torch.Tensor, bones: torch.Tensor) -> torch.Tensor:
    """The same by torch: products of 1, 2, 4, ... bones, so that few steps do."""
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


@lru_cache(maxsize=32)
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


@lru_cache(maxsize=32)
def _tree(parents: tuple[int, ...], device: str) -> Any:
    return kernels.make_joint_tree(parents, device)


def _types(like: torch.Tensor) -> kernels.JointTypes:
    return kernels.SINGLE if like.dtype == torch.float32 else kernels.DOUBLE


class _Chain(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, parents: tuple[int, ...], rotations: torch.Tensor, bones: torch.Tensor) -> torch.Tensor:
        local = contiguous(rotations), contiguous(bones)
        transforms, types = rotations.new_empty(*rotations.shape[:2], 4, 4), _types(rotations)
        if transforms.numel():
            with on_torch_stream(rotations.device) as device:
                arrays = [warp_array(each, kind) for each, kind in zip(local, (types.mat, types.vec), strict=True)]
                tree = _tree(parents, device)
                kernels.launch_chain(tree, types.scalar(1.0), arrays, warp_array(transforms, types.frame))
        ctx.parents = parents
        ctx.save_for_backward(rotations, bones, transforms)
        return transforms

    @staticmethod
    def backward(ctx: Any, *adjoints: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        rotations, bones, transforms = ctx.saved_tensors
        if torch.is_grad_enabled():
            products = partial(multiply_joints, ctx.parents)
            return None, *differentiate_again(products, (rotations, bones), adjoints[0])
        types = _types(rotations)
        kinds = types.mat, types.vec
        scratch, found = (
            [torch.empty_like(each, memory_format=torch.contiguous_format) for each in (rotations, bones)]
            for _ in range(2)
        )
        if transforms.numel():
            saved = contiguous(rotations), contiguous(bones), transforms.detach()
            adjoint = contiguous(adjoints[0])
            with on_torch_stream(rotations.device) as device:
                kernels.launch_chain_adjoint(
                    _tree(ctx.parents, device),
                    [warp_array(each, kind) for each, kind in zip(saved, (*kinds, types.frame), strict=True)],
                    warp_array(adjoint, types.frame),
                    [warp_array(each, kind) for each, kind in zip((*scratch, *found), kinds * 2, strict=True)],
                )
        return None, *found
