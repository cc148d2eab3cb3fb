"""Turns of a detailed body's joints, by kernels or, to be differentiated again, by torch."""

from __future__ import annotations

from typing import Any

import torch
from warp import mat33, vec3

from ..body.rotations import rotation_from_axis_angle
from ..interop.arrays import contiguous, warp_array
from ..interop.derivatives import differentiate_again, is_transformed
from ..interop.streams import on_torch_stream
from ..kernels import joint_turns as kernels


def turn_joints(rotations: torch.Tensor, joints: torch.Tensor, turns: torch.Tensor) -> torch.Tensor:
    """Local rotations (B, J, 3, 3) of which those of ``joints``, (N,), are turned by rotation vectors (B, N, 3)."""
    fixed = rotations.dtype == turns.dtype == torch.float32 and not rotations.requires_grad
    if not fixed or torch.compiler.is_compiling() or is_transformed(rotations, turns):
        return _turn(rotations, joints, turns)
    found: torch.Tensor = _Turned.apply(rotations, joints, turns)
    return found


def _turn(rotations: torch.Tensor, joints: torch.Tensor, turns: torch.Tensor) -> torch.Tensor:
    turned = rotations.clone()
    turned[:, joints] = rotations[:, joints] @ rotation_from_axis_angle(turns)
    return turned


class _Turned(torch.autograd.Function):
    """Of fixed rotations, float32."""

    @staticmethod
    def forward(ctx: Any, rotations: torch.Tensor, joints: torch.Tensor, turns: torch.Tensor) -> torch.Tensor:
        inputs = contiguous(rotations), joints, contiguous(turns)
        turned = rotations.new_empty(rotations.shape)
        if turned.numel():
            with on_torch_stream(rotations.device):
                kernels.launch_joint_turns(_arrays(*inputs), warp_array(turned, mat33))
        ctx.save_for_backward(*inputs[:2], turns)
        return turned

    @staticmethod
    def backward(ctx: Any, *adjoints: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        rotations, joints, turns = ctx.saved_tensors
        if torch.is_grad_enabled():
            again = differentiate_again(lambda moved: _turn(rotations, joints, moved), (turns,), adjoints[0])
            return None, None, *again
        gradient = turns.new_empty(turns.shape)
        if gradient.numel():
            with on_torch_stream(turns.device):
                inputs, adjoint = _arrays(rotations, joints, contiguous(turns)), contiguous(adjoints[0])
                kernels.launch_joint_turns_adjoint(inputs, warp_array(adjoint, mat33), warp_array(gradient, vec3))
        return None, None, gradient


def _arrays(rotations: torch.Tensor, joints: torch.Tensor, turns: torch.Tensor) -> list[Any]:
    return [warp_array(rotations, mat33), warp_array(joints), warp_array(turns, vec3)]
