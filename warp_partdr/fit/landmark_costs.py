"""Costs of a detailed body's landmarks before cameras, by kernels, with gradients for torch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from warp import vec2, vec3, vec4

from ..cameras import Camera
from ..inputs.observation import REFERENCE_SIZE
from ..interop.arrays import contiguous, warp_array
from ..interop.derivatives import once
from ..interop.streams import on_torch_stream
from ..kernels import landmark_costs as kernels


@dataclass(frozen=True)
class LandmarkAims:
    """Places where landmarks of M views of bodies should be.

    Attributes:
        places: Landmark of the model that each keypoint marks, shape (M, K), int64.
        points: Keypoints in the crop, from -1 to 1, shape (M, K, 2).
        votes: Their weights, shape (M, K).
        ends: Landmarks at ``JOINT_NAMES``, shape (E + 1,), int64.
        depths: Of these but the pelvis, relative to it [m], shape (M, E).
        depth_weights: Of their squares [1/m^2], shape (M, E).
    """

    places: torch.Tensor
    points: torch.Tensor
    votes: torch.Tensor
    ends: torch.Tensor
    depths: torch.Tensor
    depth_weights: torch.Tensor


def landmark_costs(landmarks: torch.Tensor, camera: Camera, aims: LandmarkAims) -> tuple[torch.Tensor, torch.Tensor]:
    """Weighted sums of distances from keypoints along both axes [px], and of squares of depths, shape (M,) each.

    Args:
        landmarks: Before the cameras [m], shape (M, L, 3), float32.
        camera: M cameras of crops of ``REFERENCE_SIZE``.
        aims: Of them.
    """
    costs: torch.Tensor = _LandmarkCosts.apply(landmarks, camera.intrinsics, camera.perspective, *vars(aims).values())
    seen, deep = costs.unbind(1)
    return seen, deep


class _LandmarkCosts(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, landmarks: torch.Tensor, cameras: torch.Tensor, perspective: bool, *aims: torch.Tensor
    ) -> torch.Tensor:
        own = tuple(map(contiguous, (landmarks, cameras, *aims)))
        costs = landmarks.new_empty(*landmarks.shape[:2], 2)
        if costs.numel():
            with on_torch_stream(costs.device):
                kernels.launch_landmark_costs(_inputs(own, perspective), warp_array(costs, vec2))
        ctx.perspective = perspective
        ctx.save_for_backward(landmarks, cameras, *own)
        return costs.sum(1)

    @staticmethod
    def backward(ctx: Any, *adjoints: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        landmarks, cameras, *own = ctx.saved_tensors
        found = [own[0].new_empty(*own[0].shape[:2], width) for width in (3, 4)]
        if found[0].numel():
            with on_torch_stream(found[0].device):
                arrays = [warp_array(each, kind) for each, kind in zip(found, (vec3, vec4), strict=True)]
                adjoint = warp_array(contiguous(adjoints[0]), vec2)
                kernels.launch_landmark_costs_adjoint(_inputs(own, ctx.perspective), adjoint, arrays)
        by_camera = found[1].sum(1) if ctx.needs_input_grad[1] else None
        gradients = once("landmark_costs", (found[0], by_camera), *adjoints, landmarks, cameras)
        return *gradients, *[None] * (len(own) - 1)


def _inputs(own: tuple[torch.Tensor, ...] | list[torch.Tensor], perspective: bool) -> list[Any]:
    landmarks, cameras, places, points, *others = own
    aims = [warp_array(places), warp_array(points, vec2), *map(warp_array, others)]
    return [
        warp_array(landmarks, vec3),
        warp_array(cameras, vec4),
        kernels.make_aims(aims, REFERENCE_SIZE / 2, perspective),
    ]
