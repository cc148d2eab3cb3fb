"""Turns of a detailed body's joints, by kernels or, to be differentiated again, by torch."""

from __future__ import annotations

from functools import partial
from typing import Any

import torch
from warp import mat33, vec3

from ..body.rotations import rotation_from_axis_angle
from ..interop.arrays import warp_array
from ..interop.captured_function import Fixed, call_captured
from ..interop.derivatives import differentiate_again, is_transformed
from ..interop.graph_cache import Launch
from ..interop.layouts import Tensors
from ..kernels import joint_turns as kernels


def turn_joints(rotations: torch.Tensor, joints: torch.Tensor, turns: torch.Tensor) -> torch.Tensor:
    """Local rotations (B, J, 3, 3), where those of ``joints``, (N,), are turned by rotation vectors (B, N, 3)."""
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
    """Operation of ``turn_joints`` for fixed rotations, float32."""

    @staticmethod
    def forward(ctx: Any, rotations: torch.Tensor, joints: torch.Tensor, turns: torch.Tensor) -> torch.Tensor:
        ctx.save_for_backward(rotations, joints, turns)
        return call_captured(_prepare, (rotations, turns), (rotations.shape,), Fixed(joints))[0]

    @staticmethod
    def backward(ctx: Any, *adjoints: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        rotations, joints, turns = ctx.saved_tensors
        if torch.is_grad_enabled():
            again = differentiate_again(lambda moved: _turn(rotations, joints, moved), (turns,), adjoints[0])
            return None, None, *again
        inputs = rotations, turns, adjoints[0]
        return None, None, *call_captured(_prepare_adjoint, inputs, (turns.shape,), Fixed(joints))


def _prepare(inputs: Tensors, outputs: Tensors, joints: Fixed) -> Launch:
    """Launch that fills the turned rotations from rotations and turns."""
    return partial(kernels.launch_joint_turns, _arrays(inputs, joints), warp_array(outputs[0], mat33))


def _prepare_adjoint(inputs: Tensors, outputs: Tensors, joints: Fixed) -> Launch:
    """Launch that fills the gradient of the turns from rotations, turns and the adjoint of what they turned."""
    adjoint, gradient = warp_array(inputs[2], mat33), warp_array(outputs[0], vec3)
    return partial(kernels.launch_joint_turns_adjoint, _arrays(inputs, joints), adjoint, gradient)


def _arrays(inputs: Tensors, joints: Fixed) -> list[Any]:
    return [warp_array(inputs[0], mat33), warp_array(joints.tensor), warp_array(inputs[1], vec3)]
