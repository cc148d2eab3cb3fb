"""Costs of a detailed body's landmarks before cameras, by kernels, with gradients for torch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import torch
from warp import vec2, vec3, vec4

from ...cameras import Camera
from ...inputs.observation import REFERENCE_SIZE
from ...interop.arrays import warp_array
from ...interop.captured_function import Fixed, call_captured
from ...interop.derivatives import once
from ...interop.graph_cache import Launch
from ...interop.layouts import Tensors
from ...kernels import landmark_costs as kernels
from .tensors import NamedTensors


@dataclass(frozen=True)
class LandmarkAims(NamedTensors):
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
    own = aims.places, aims.points, aims.votes, aims.depths, aims.depth_weights
    costs: torch.Tensor = _LandmarkCosts.apply(landmarks, camera.intrinsics, camera.perspective, aims.ends, *own)
    seen, deep = costs.unbind(1)
    return seen, deep


class _LandmarkCosts(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        landmarks: torch.Tensor,
        cameras: torch.Tensor,
        perspective: bool,
        ends: torch.Tensor,
        *aims: torch.Tensor,
    ) -> torch.Tensor:
        ctx.options = Fixed(ends), perspective
        ctx.save_for_backward(landmarks, cameras, *aims)
        shape = torch.Size((*landmarks.shape[:2], 2))
        return call_captured(_prepare, (landmarks, cameras, *aims), (shape,), *ctx.options)[0].sum(1)

    @staticmethod
    def backward(ctx: Any, *adjoints: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        saved = landmarks, cameras, *aims = ctx.saved_tensors
        shapes = landmarks.shape, torch.Size((*landmarks.shape[:2], 4))
        found, by_camera = call_captured(_prepare_adjoint, (*saved, adjoints[0]), shapes, *ctx.options)
        of_cameras = by_camera.sum(1) if ctx.needs_input_grad[1] else None
        gradients = once("landmark_costs", (found, of_cameras), *adjoints, landmarks, cameras)
        return *gradients, *[None] * (2 + len(aims))


def _prepare(inputs: Tensors, outputs: Tensors, ends: Fixed, perspective: bool) -> Launch:
    """Launch that fills costs of each landmark from landmarks, cameras and aims."""
    return partial(kernels.launch_landmark_costs, _arrays(inputs, ends, perspective), warp_array(outputs[0], vec2))


def _prepare_adjoint(inputs: Tensors, outputs: Tensors, ends: Fixed, perspective: bool) -> Launch:
    """Launch that fills gradients of landmarks, and shares of those of cameras, from these and the costs' adjoint."""
    *own, adjoint = inputs
    gradients = [warp_array(each, kind) for each, kind in zip(outputs, (vec3, vec4), strict=True)]
    arrays = _arrays(own, ends, perspective)
    return partial(kernels.launch_landmark_costs_adjoint, arrays, warp_array(adjoint, vec2), gradients)


def _arrays(own: Sequence[torch.Tensor], ends: Fixed, perspective: bool) -> list[Any]:
    landmarks, cameras, places, points, votes, *depths = own
    aims = [warp_array(places), warp_array(points, vec2), *map(warp_array, (votes, ends.tensor, *depths))]
    return [
        warp_array(landmarks, vec3),
        warp_array(cameras, vec4),
        kernels.make_aims(aims, REFERENCE_SIZE / 2, perspective),
    ]
