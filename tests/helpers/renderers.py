"""Bodies that every renderer draws and compares, from leaves of its gradient."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import torch

from helpers.pictures import GRADIENTS, body_camera, body_parameters, draw_on_screen, loss_on_screen
from warp_partdr.body.posing import Posed, pose
from warp_partdr.cameras import WeakPerspective
from warp_partdr.render.ellipsoids import EllipsoidImage, Ellipsoids, draw_ellipsoids, ellipsoid_label_loss
from warp_partdr.render.mesh import PartImage
from warp_partdr.render.part_mesh import PartMesh, ellipbody_mesh

RENDERERS = [*GRADIENTS, "mesh"]


@cache  # one mesh for all tests, for graphs are kept by it
def level_1(device: str) -> PartMesh:
    return ellipbody_mesh(1, device=device)


@dataclass(frozen=True)
class Scene:
    """Posed bodies, a camera, and the labels of other poses; the mesh is of level 1."""

    posed: Posed
    camera: WeakPerspective
    target: torch.Tensor
    mesh: PartMesh

    @classmethod
    def make(cls, seed: int, device: str, batch: int = 1, size: tuple[int, int] = (48, 40)) -> Scene:
        camera = body_camera(size, False, batch, device)
        posed, others = (pose(**body_parameters(each, device, batch)) for each in (seed, seed + 1000))
        return cls(posed, camera, draw_ellipsoids(others, camera, size).labels, level_1(str(device)))

    def leaves(self, renderer: str) -> list[torch.Tensor]:
        """Tensors that a renderer's gradient is with respect to."""
        if renderer == "mesh":
            tensors = [self.camera.project(self.posed.vertices(1))]
        else:
            tensors = [self.posed.centres, self.posed.axes, self.posed.semi_axes]
        return [tensor.detach().clone().requires_grad_() for tensor in tensors]

    def loss(
        self, renderer: str, leaves: list[torch.Tensor], **options: Any
    ) -> tuple[torch.Tensor, EllipsoidImage | PartImage]:
        """L_seg and the picture."""
        if renderer == "mesh":
            return loss_on_screen(leaves[0], self.mesh, self.target, **options)
        return ellipsoid_label_loss(Ellipsoids(*leaves), self.camera, self.target, gradient=renderer, **options)

    def draw(self, renderer: str, leaves: list[torch.Tensor], **options: Any) -> EllipsoidImage | PartImage:
        size = (self.target.shape[1], self.target.shape[2])
        if renderer == "mesh":
            return draw_on_screen(leaves[0], self.mesh, size, **options)
        return draw_ellipsoids(Ellipsoids(*leaves), self.camera, size, gradient=renderer, **options)
