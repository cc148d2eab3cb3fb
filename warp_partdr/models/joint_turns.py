"""Turns of a detailed body's joints, by kernels or, to be differentiated again, by torch."""

from __future__ import annotations

from functools import partial
from typing import Any

import torch
from warp import mat33, vec3

from ..body.rotations import rotation_from_axis_angle
from ..interop.arrays import warp_array
from ..interop.captured_function import Fixed, call_captured
from ..interop.graph_cache import Launch
from ..interop.layouts import Tensors
from ..interop.operation import Gradients, OperationWithTwin
from ..kernels import joint_turns as kernels


def turn_joints(rotations: torch.Tensor, joints: torch.Tensor, turns: torch.Tensor) -> torch.Tensor:
    """Local rotations (B, J, 3, 3), where those of ``joints``, (N,), are turned by rotation vectors (B, N, 3)."""
    if not rotations.dtype == turns.dtype == torch.float32 or rotations.requires_grad:
        return _turn(rotations, joints, turns)
    return _Turned()(turns, rotations, joints)[0]


def _turn(rotations: torch.Tensor, joints: torch.Tensor, turns: torch.Tensor) -> torch.Tensor:
    turned = rotations.clone()
    turned[:, joints] = rotations[:, joints] @ rotation_from_axis_angle(turns)
    return turned


class _Turned(OperationWithTwin):
    """Operation of ``turn_joints`` for fixed rotations, float32."""

    def forward(self, inputs: Tensors) -> tuple[Tensors, Tensors]:
        turns, rotations, joints = inputs
        return call_captured(_prepare, (rotations, turns), (rotations.shape,), Fixed(joints)), ()

    def adjoint(self, saved: Tensors, adjoints: Tensors) -> Gradients:
        turns, rotations, joints = saved
        return call_captured(_prepare_adjoint, (rotations, turns, *adjoints), (turns.shape,), Fixed(joints))

    def plain(self, inputs: Tensors) -> Tensors:
        turns, rotations, joints = inputs
        return (_turn(rotations, joints, turns),)


def _prepare(inputs: Tensors, outputs: Tensors, joints: Fixed) -> Launch:
    """Launch that fills the turned rotations from rotations and turns."""
    return partial(kernels.launch_joint_turns, _arrays(inputs, joints), warp_array(outputs[0], mat33))


def _prepare_adjoint(inputs: Tensors, outputs: Tensors, joints: Fixed) -> Launch:
    """Launch that fills the gradient of the turns from rotations, turns and the adjoint of what they turned."""
    adjoint, gradient = warp_array(inputs[2], mat33), warp_array(outputs[0], vec3)
    return partial(kernels.launch_joint_turns_adjoint, _arrays(inputs, joints), adjoint, gradient)


def _arrays(inputs: Tensors, joints: Fixed) -> list[Any]:
    return [warp_array(inputs[0], mat33), warp_array(joints.tensor), warp_array(inputs[1], vec3)]
