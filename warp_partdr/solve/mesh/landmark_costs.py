"""Costs of detailed bodies' landmarks before cameras, evaluated by kernels, with gradients for torch."""

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
    """Observed positions of keypoints, and expected depths of joints, in M pictures of bodies.

    Attributes:
        landmark_indices: Index of the model's landmark that each keypoint marks, shape (M, K), int64.
        points: Keypoints in the crop, from -1 to 1, shape (M, K, 2).
        weights: Weights of the keypoints, shape (M, K).
        ends: Indices of the model's landmarks at ``JOINT_NAMES``, the pelvis first, shape (E + 1,), int64.
        depths: Expected depths of these joints relative to the pelvis, without the pelvis [m], shape (M, E).
        depth_weights: Weights of squared distances from these depths [1/m^2], shape (M, E).
    """

    landmark_indices: torch.Tensor
    points: torch.Tensor
    weights: torch.Tensor
    ends: torch.Tensor
    depths: torch.Tensor
    depth_weights: torch.Tensor


def landmark_costs(landmarks: torch.Tensor, camera: Camera, aims: LandmarkAims) -> tuple[torch.Tensor, torch.Tensor]:
    """Sum weighted distances of landmarks from keypoints and from expected depths.

    Args:
        landmarks: Landmarks in the cameras' frames [m], shape (M, L, 3), float32.
        camera: M cameras of crops of ``REFERENCE_SIZE``.
        aims: Keypoints and depths in these M pictures.

    Returns:
        Weighted sums of distances from keypoints along both axes [px], and of squared distances from depths, shape (M,)
        each.
    """
    (costs,) = _LandmarkCosts(camera.perspective)(
        landmarks,
        camera.intrinsics,
        aims.landmark_indices,
        aims.points,
        aims.weights,
        aims.depths,
        aims.depth_weights,
        aims.ends,
    )
    keypoint_costs, depth_costs = costs.unbind(1)
    return keypoint_costs, depth_costs


@dataclass(frozen=True, eq=False)
class _LandmarkCosts(Operation):
    """Operation that gives both costs of each picture, shape (M, 2)."""

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
    """Launch that fills gradients of landmarks, and each landmark's share of the cameras' gradients."""
    *own, adjoint = inputs
    gradients = warp_arrays(outputs, (vec3, vec4))
    arrays = _arrays(own, ends, perspective)
    return partial(kernels.launch_landmark_costs_adjoint, arrays, warp_array(adjoint, vec2), gradients)


def _arrays(own: Sequence[torch.Tensor], ends: Fixed, perspective: bool) -> list[Any]:
    landmarks, cameras, landmark_indices, points, weights, depths, depth_weights = own
    aims = [
        warp_array(landmark_indices),
        warp_array(points, vec2),
        warp_array(weights),
        warp_array(ends.tensor),
        warp_array(depths),
        warp_array(depth_weights),
    ]
    return [
        warp_array(landmarks, vec3),
        warp_array(cameras, vec4),
        kernels.make_aims(aims, REFERENCE_SIZE / 2, perspective),
    ]
