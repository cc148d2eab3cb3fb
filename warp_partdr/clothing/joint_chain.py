"""Joints of detailed bodies: products along their tree by kernels, with gradients for torch."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import torch

from ..interop.arrays import contiguous, warp_array
from ..interop.derivatives import once, refuse_transforms
from ..interop.streams import on_torch_stream
from ..kernels import joint_chain as kernels


def joint_frames(parents: tuple[int, ...], rotations: torch.Tensor, bones: torch.Tensor) -> torch.Tensor:
    """Each joint's frame, its rotation and its position, shape (B, J, 4, 4).

    Args:
        parents: Parent of each joint, -1 for the root; a parent comes before its children.
        rotations: Of each joint against its parent, shape (B, J, 3, 3), float32 or float64.
        bones: From each joint's parent to it, in the parent's axes; of the root, its position; shape (B, J, 3).
    """
    refuse_transforms("pose", rotations, bones)
    found: torch.Tensor = _Chain.apply(parents, rotations, bones)
    return found


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
                arrays = [warp_array(each, kind) for each, kind in zip(local, types[2:0:-1], strict=True)]
                tree = _tree(parents, str(device))
                kernels.launch_chain(tree, types.scalar(1.0), arrays, warp_array(transforms, types.frame))
        ctx.parents = parents
        ctx.save_for_backward(rotations, bones, transforms)
        return transforms

    @staticmethod
    def backward(ctx: Any, *adjoints: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        rotations, bones, transforms = ctx.saved_tensors
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
                    _tree(ctx.parents, str(device)),
                    [warp_array(each, kind) for each, kind in zip(saved, (*kinds, types.frame), strict=True)],
                    warp_array(adjoint, types.frame),
                    [warp_array(each, kind) for each, kind in zip((*scratch, *found), kinds * 2, strict=True)],
                )
        return None, *once("pose", tuple(found), *adjoints, rotations, bones)
