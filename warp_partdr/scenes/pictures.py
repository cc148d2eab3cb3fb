"""People of a scene in the world, and their vertices in its pictures, by kernels, with gradients for torch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from warp import mat33, vec2, vec2i, vec3

from ..interop.arrays import contiguous, dense_rows, warp_array
from ..interop.derivatives import once
from ..interop.streams import on_torch_stream
from ..kernels import scene_pictures as kernels


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
    found: torch.Tensor = _Placed.apply(vertices, pelvises, size, *vars(views).values())
    return found


class _Placed(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, vertices: torch.Tensor, pelvises: torch.Tensor, size: int, *views: torch.Tensor
    ) -> torch.Tensor:
        own = [dense_rows(each) for each in (vertices, pelvises, *views)]
        screen = vertices.new_empty(len(views[2]), views[4].shape[1] * vertices.shape[1], 3)
        if screen.numel():
            with on_torch_stream(screen.device):
                kernels.launch_place(_inputs(own, size), warp_array(screen, vec3))
        ctx.size = size
        ctx.save_for_backward(vertices, pelvises, *own)
        return screen

    @staticmethod
    def backward(ctx: Any, *adjoints: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        vertices, pelvises, *own = ctx.saved_tensors
        gradient = own[0].new_empty(own[0].shape)
        if gradient.numel():
            adjoint = warp_array(contiguous(adjoints[0]), vec3)
            with on_torch_stream(gradient.device):
                kernels.launch_place_adjoint(_inputs(own, ctx.size), adjoint, warp_array(gradient, vec3))
        found = once("place_people", (gradient, gradient.sum(1)), *adjoints, vertices, pelvises)
        return *found, *[None] * (1 + len(own) - 2)


def pelvises_in_world(
    log_scale: torch.Tensor,
    shift: torch.Tensor,
    lens: torch.Tensor,
    rotations: torch.Tensor,
    translations: torch.Tensor,
) -> torch.Tensor:
    """Pelvises in the world [m], shape (N, 3), of bodies in crops of cameras that stand so, (N, 3, 3) and (N, 3)."""
    found: torch.Tensor = _Pelvises.apply(log_scale, shift, lens, rotations, translations)
    return found


class _Pelvises(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *given: torch.Tensor) -> torch.Tensor:
        ctx.save_for_backward(*given)
        pelvises = given[2].new_empty(given[2].shape)
        with on_torch_stream(pelvises.device):
            kernels.launch_pelvises(*_of_pelvises(given), warp_array(pelvises, vec3))
        return pelvises

    @staticmethod
    def backward(ctx: Any, *adjoints: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        given = ctx.saved_tensors
        found = tuple([each.new_empty(each.shape) for each in given[:2]])
        arrays = warp_array(found[0]), warp_array(found[1], vec2)
        with on_torch_stream(found[0].device):
            adjoint = warp_array(contiguous(adjoints[0]), vec3)
            kernels.launch_pelvises_adjoint(*_of_pelvises(given), adjoint, arrays)
        return *once("pelvises_in_world", found, *adjoints, *given[:2]), None, None, None


def _of_pelvises(given: Sequence[torch.Tensor]) -> tuple[list[Any], list[Any]]:
    """Numbers and views."""
    kinds = None, vec2, vec3, mat33, vec3
    arrays = [warp_array(dense_rows(each), kind) for each, kind in zip(given, kinds, strict=True)]
    return arrays[:2], arrays[2:]


def _inputs(own: list[torch.Tensor], size: int) -> list[Any]:
    kinds = vec3, vec3, mat33, vec3, vec3, None, None, vec2i
    vertices, pelvises, *views = (warp_array(each, kind) for each, kind in zip(own, kinds, strict=True))
    return [vertices, pelvises, kernels.gather_views(views, size / 2)]
