"""People of a scene in the world, and their vertices in its pictures, by kernels, with gradients for torch."""

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
    """V views of T frames with P people in K clusters, C at most in one.

    Attributes:
        rotations: World to camera, shape (V, 3, 3).
        translations: The same [m], shape (V, 3).
        lenses: Of the pictures' crops, shape (K T V, 3).
        shown: Who is seen in each view, shape (P T, V), bool.
        slots: Who is in each cluster, -1 where nobody is, shape (K, C), int32.
        places: Cluster and slot of each person, -1 of those who are in none, shape (P, 2), int32.
    """

    rotations: torch.Tensor
    translations: torch.Tensor
    lenses: torch.Tensor
    shown: torch.Tensor
    slots: torch.Tensor
    places: torch.Tensor


def place_people(vertices: torch.Tensor, pelvises: torch.Tensor, views: PictureViews, size: int) -> torch.Tensor:
    """Vertices of a cluster's people in each of its pictures, u [px], v [px], z [m], shape (K T V, C n, 3).

    Who is not seen is behind the camera, where nothing is drawn.

    Args:
        vertices: About the pelvis, in the world's axes [m], shape (P T, n, 3), float32; frames of a person in a row.
        pelvises: In the world [m], shape (P T, 3).
        views: Of them.
        size: Of the pictures [px].
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
    """Result of one launch for a whole scene, whose pictures and bodies are no rows of one batch."""
    rows, fixed = tuple([each[None] for each in tensors]), [Fixed(dense_rows(each)) for each in views]
    return call_captured(prepare, rows, (torch.Size((1, *shape)),), size, *fixed)[0][0]


def _prepare_place(inputs: Tensors, outputs: Tensors, size: int, *views: Fixed) -> Launch:
    """Launch that fills pictures' vertices from vertices and pelvises."""
    vertices, pelvises = (warp_array(each[0], vec3) for each in inputs)
    scene = [vertices, pelvises, _gathered(views, size)]
    return partial(kernels.launch_place, scene, warp_array(outputs[0][0], vec3))


def _prepare_place_adjoint(inputs: Tensors, outputs: Tensors, size: int, *views: Fixed) -> Launch:
    """Launch that fills the gradient of vertices."""
    vertices, pelvises, adjoint = (warp_array(each[0], vec3) for each in inputs)
    scene = [vertices, pelvises, _gathered(views, size)]
    return partial(kernels.launch_place_adjoint, scene, adjoint, warp_array(outputs[0][0], vec3))


def _gathered(views: Sequence[Fixed], size: int) -> Any:
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
    """Pelvises in the world [m], shape (N, 3), of bodies in crops of cameras that stand so, (N, 3, 3) and (N, 3)."""
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
    return partial(kernels.launch_pelvises, *_of_pelvises(inputs), warp_array(outputs[0], vec3))


def _prepare_pelvises_adjoint(inputs: Tensors, outputs: Tensors) -> Launch:
    """Launch that fills gradients of logarithms of scales and of shifts."""
    *given, adjoint = inputs
    gradients = warp_array(outputs[0]), warp_array(outputs[1], vec2)
    return partial(kernels.launch_pelvises_adjoint, *_of_pelvises(given), warp_array(adjoint, vec3), gradients)


def _of_pelvises(given: Sequence[torch.Tensor]) -> tuple[list[Any], list[Any]]:
    """Numbers and views."""
    kinds = None, vec2, vec3, mat33, vec3
    arrays = warp_arrays(given, kinds)
    return arrays[:2], arrays[2:]
