"""Scenes and helpers that several test files share."""

from __future__ import annotations

import math
from typing import Any

import torch

from warp_partdr.body.parameters import BodyParameters
from warp_partdr.refinement.stepper import EnergyFunction, Refinement
from warp_partdr.refinement.steps import Refined
from warp_partdr.render.mesh import PartImage, draw_mesh, mesh_label_loss
from warp_partdr.render.part_mesh import PartMesh


class ScreenCamera:
    """A camera of points (u [px], v [px], z [m]) that are in the picture already, also of a perspective one."""

    def __init__(self, like: torch.Tensor, perspective: bool = False, near: float | None = None) -> None:
        self.perspective = perspective
        default, least = (0.01, 1e-6) if perspective else (-math.inf, -math.inf)
        self.near_plane = max(default if near is None else near, least)
        self.intrinsics = torch.zeros(1, 4, device=getattr(like, "device", "cpu"))

    def project(self, points: torch.Tensor) -> torch.Tensor:
        return points


def draw_on_screen(
    vertices: torch.Tensor,
    mesh: PartMesh,
    size: tuple[int, int],
    *,
    perspective: bool = False,
    near: float | None = None,
    **options: Any,
) -> PartImage:
    """``draw_mesh`` of vertices on the screen."""
    return draw_mesh(vertices, mesh, ScreenCamera(vertices, perspective, near), size, **options)


def loss_on_screen(
    vertices: torch.Tensor,
    mesh: PartMesh,
    target: torch.Tensor,
    *,
    perspective: bool = False,
    near: float | None = None,
    **options: Any,
) -> tuple[torch.Tensor, PartImage]:
    """``mesh_label_loss`` of vertices on the screen."""
    return mesh_label_loss(vertices, mesh, ScreenCamera(vertices, perspective, near), target, **options)


def refine_by_autograd(start: BodyParameters, energy: EnergyFunction, **options: Any) -> Refined:
    """``refine`` without its captured graph."""
    return Refinement(start, energy, **options).run()
