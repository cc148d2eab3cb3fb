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
from ...interop.arrays import warp_array, warp_arrays
from ...interop.captured_function import Fixed, call_captured
from ...interop.graph_cache import Launch
from ...interop.layouts import Tensors
from ...interop.operation import Gradients, Operation
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
    (costs,) = _LandmarkCosts(camera.perspective)(
        landmarks,
        camera.intrinsics,
        aims.places,
        aims.points,
        aims.votes,
        aims.depths,
        aims.depth_weights,
        aims.ends,
    )
    seen, deep = costs.unbind(1)
    return seen, deep


@dataclass(frozen=True, eq=False)
class _LandmarkCosts(Operation):
    """Both costs of each view, shape (M, 2)."""

    perspective: bool
    name = "landmark_costs"

    def forward(self, inputs: Tensors) -> tuple[Tensors, Tensors]:
        rows, ends = inputs[:-1], inputs[-1]
        shape = torch.Size((*inputs[0].shape[:2], 2))
        (costs,) = call_captured(_prepare, rows, (shape,), Fixed(ends), self.perspective)
        return (costs.sum(1),), ()

    def adjoint(self, saved: Tensors, adjoints: Tensors) -> Gradients:
        rows, ends = saved[:-1], saved[-1]
        landmarks, cameras = rows[:2]
        shapes = landmarks.shape, torch.Size((*landmarks.shape[:2], 4))
        given = *rows, *adjoints
        by_landmark, by_camera = call_captured(_prepare_adjoint, given, shapes, Fixed(ends), self.perspective)
        return by_landmark, by_camera.sum(1) if cameras.requires_grad else None


def _prepare(inputs: Tensors, outputs: Tensors, ends: Fixed, perspective: bool) -> Launch:
    """Launch that fills costs of each landmark from landmarks, cameras and aims."""
    return partial(kernels.launch_landmark_costs, _arrays(inputs, ends, perspective), warp_array(outputs[0], vec2))


def _prepare_adjoint(inputs: Tensors, outputs: Tensors, ends: Fixed, perspective: bool) -> Launch:
    """Launch that fills gradients of landmarks, and shares of those of cameras, from these and the costs' adjoint."""
    *own, adjoint = inputs
    gradients = warp_arrays(outputs, (vec3, vec4))
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
