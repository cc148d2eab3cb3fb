"""Positions of a scene's people in the world, and their vertices in its pictures, found by kernels, with gradients."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import torch
from warp import mat33, vec2, vec2i, vec3

from ...interop.arrays import dense_rows, warp_array, warp_arrays
from ...interop.captured_function import Fixed, Prepare, call_captured
from ...interop.graph_cache import Launch
from ...interop.layouts import Tensors
from ...interop.operation import Gradients, Operation
from ...kernels import scene_pictures as kernels


@dataclass(frozen=True)
class PictureViews:
    """V views of T frames with P people in K clusters, at most C people in one.

    Attributes:
        rotations: Rotations from world to camera, shape (V, 3, 3).
        translations: Translations from world to camera [m], shape (V, 3).
        lenses: Lenses of the pictures' crops, shape (K T V, 3).
        observed: True if a view shows a body, shape (P T, V), bool.
        slots: Person in each slot of each cluster, -1 for an empty slot, shape (K, C), int32.
        person_slots: Cluster and slot of each person, -1 for people in no cluster, shape (P, 2), int32.
    """

    rotations: torch.Tensor
    translations: torch.Tensor
    lenses: torch.Tensor
    observed: torch.Tensor
    slots: torch.Tensor
    person_slots: torch.Tensor


def place_people(vertices: torch.Tensor, pelvises: torch.Tensor, views: PictureViews, size: int) -> torch.Tensor:
    """Project the vertices of each cluster's people into each of its pictures.

    People who are not observed in a picture are put behind the camera, where nothing is drawn.

    Args:
        vertices: Vertices relative to the pelvis, in the world's axes [m], shape (P T, n, 3), float32. The frames of a
            person follow one another.
        pelvises: Positions of the pelvises in the world [m], shape (P T, 3).
        views: Cameras, and the people that they show.
        size: Side of the pictures [px].

    Returns:
        Vertices u [px], v [px], z [m], shape (K T V, C n, 3).
    """
    return _Placed(size)(vertices, pelvises, *vars(views).values())[0]


@dataclass(frozen=True, eq=False)
class _Placed(Operation):
    size: int
    name = "place_people"

    def forward(self, inputs: Tensors) -> tuple[Tensors, Tensors]:
        moving, views = inputs[:2], inputs[2:]
        shape = torch.Size((len(views[2]), views[4].shape[1] * moving[0].shape[1], 3))
        return (_call(_prepare_place, moving, shape, self.size, views),), ()

    def adjoint(self, saved: Tensors, adjoints: Tensors) -> Gradients:
        moving, views = saved[:2], saved[2:]
        given = *moving, *adjoints
        gradient = _call(_prepare_place_adjoint, given, moving[0].shape, self.size, views)
        return gradient, gradient.sum(1)


def _call(
    prepare: Prepare, tensors: Tensors, shape: torch.Size, size: int, views: Sequence[torch.Tensor]
) -> torch.Tensor:
    """Call one launch for the whole scene as a batch of one: its pictures and bodies can't be rows of one batch."""
    rows = tuple([each[None] for each in tensors])
    fixed = [Fixed(dense_rows(each)) for each in views]
    return call_captured(prepare, rows, (torch.Size((1, *shape)),), size, *fixed)[0][0]


def _prepare_place(inputs: Tensors, outputs: Tensors, size: int, *views: Fixed) -> Launch:
    """Launch that fills the vertices in the pictures from vertices and pelvises."""
    scene = [warp_array(inputs[0][0], vec3), warp_array(inputs[1][0], vec3), _scene_views(views, size)]
    return partial(kernels.launch_place, scene, warp_array(outputs[0][0], vec3))


def _prepare_place_adjoint(inputs: Tensors, outputs: Tensors, size: int, *views: Fixed) -> Launch:
    """Launch that fills the gradient of vertices."""
    scene = [warp_array(inputs[0][0], vec3), warp_array(inputs[1][0], vec3), _scene_views(views, size)]
    adjoint = warp_array(inputs[2][0], vec3)
    return partial(kernels.launch_place_adjoint, scene, adjoint, warp_array(outputs[0][0], vec3))


def _scene_views(views: Sequence[Fixed], size: int) -> Any:
    kinds = mat33, vec3, vec3, None, None, vec2i
    arrays = warp_arrays([each.tensor for each in views], kinds)
    return kernels.gather_views(arrays, size / 2)


def pelvises_in_world(
    log_scale: torch.Tensor,
    shift: torch.Tensor,
    lens: torch.Tensor,
    rotations: torch.Tensor,
    translations: torch.Tensor,
) -> torch.Tensor:
    """Find the positions of bodies' pelvises in the world.

    Args:
        log_scale: Logarithms of the scale at the pelvises, as in ``BodyParameters``, shape (N,).
        shift: Positions of the pelvises in the crops, as in ``BodyParameters``, shape (N, 2).
        lens: Lenses of the crops, as in ``Observation``, shape (N, 3).
        rotations: Rotations from world to camera, shape (N, 3, 3).
        translations: Translations from world to camera [m], shape (N, 3).

    Returns:
        Pelvises in the world [m], shape (N, 3).
    """
    return _Pelvises()(log_scale, shift, lens, rotations, translations)[0]


class _Pelvises(Operation):
    name = "pelvises_in_world"

    def forward(self, inputs: Tensors) -> tuple[Tensors, Tensors]:
        return call_captured(_prepare_pelvises, inputs, (inputs[2].shape,)), ()

    def adjoint(self, saved: Tensors, adjoints: Tensors) -> Gradients:
        log_scale, shift = saved[:2]
        return call_captured(_prepare_pelvises_adjoint, (*saved, *adjoints), (log_scale.shape, shift.shape))


def _prepare_pelvises(inputs: Tensors, outputs: Tensors) -> Launch:
    """Launch that fills pelvises."""
    return partial(kernels.launch_pelvises, *_pelvis_arrays(inputs), warp_array(outputs[0], vec3))


def _prepare_pelvises_adjoint(inputs: Tensors, outputs: Tensors) -> Launch:
    """Launch that fills the gradients of ``log_scale`` and ``shift``."""
    *given, adjoint = inputs
    gradients = warp_array(outputs[0]), warp_array(outputs[1], vec2)
    return partial(kernels.launch_pelvises_adjoint, *_pelvis_arrays(given), warp_array(adjoint, vec3), gradients)


def _pelvis_arrays(given: Sequence[torch.Tensor]) -> tuple[list[Any], list[Any]]:
    """Arrays of the bodies' numbers, and arrays of their views."""
    kinds = None, vec2, vec3, mat33, vec3
    arrays = warp_arrays(given, kinds)
    return arrays[:2], arrays[2:]
