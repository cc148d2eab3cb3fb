"""Calls that a user makes from torch: losses and their gradients, label images, poses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch

from ....render.ellipsoids import Ellipsoids, draw_ellipsoids, ellipsoid_label_loss
from ....render.part_mesh import ellipbody_mesh
from ....render.renderers import RendererEllipsoids, RendererMesh
from ..renderers import GRADIENTS, LEVELS
from ..scene import BenchScene
from .compiled_steps import compiled_step, training_step
from .peers import MeshView, ours
from .plan import COMPILED_STEP, TORCH_BODY, TORCH_GRADIENT, TORCH_ITSELF, TORCH_LABELS, TORCH_POSE, TORCH_STEP

_Call = Callable[[], object]


def _body(scene: BenchScene, name: str) -> _Call:
    """L_seg from the bodies' parameters, and its gradient with respect to them."""
    bodies = scene.bodies.leaves()
    leaves = list(bodies.tensors().values())
    renderer = RendererEllipsoids(GRADIENTS[name]) if name in GRADIENTS else RendererMesh(LEVELS[name])
    return lambda: torch.autograd.grad(renderer.crop_loss(bodies, scene.targets).sum(), leaves)


def _labels(scene: BenchScene, name: str) -> _Call:
    """Label images of posed bodies, or of projected vertices."""
    if name in GRADIENTS:
        size = (scene.targets.shape[1], scene.targets.shape[2])
        return lambda: draw_ellipsoids(scene.posed, scene.camera, size, validate=False).labels
    return ours(mesh_view(scene, name))[0]


def _pose(scene: BenchScene, name: str) -> _Call:
    """Posed bodies, and the gradient of the ellipsoids' centres."""
    bodies = scene.bodies.leaves()
    return lambda: torch.autograd.grad(bodies.posed().centres.sum(), [bodies.rotations, bodies.lengths])


def _gradient(scene: BenchScene, name: str) -> _Call:
    """L_seg and its gradient through autograd: with respect to posed ellipsoids, or to projected vertices."""
    loss: Callable[[torch.Tensor], torch.Tensor]
    leaf = scene.posed.centres.detach().requires_grad_()
    if name == TORCH_ITSELF:
        loss = _Nothing.apply
    elif name in GRADIENTS:
        ellipsoids = Ellipsoids(leaf, scene.posed.axes.detach(), scene.posed.semi_axes.detach())
        seen = ellipsoids, scene.camera, scene.targets
        loss = lambda _: ellipsoid_label_loss(*seen, gradient=GRADIENTS[name], validate=False)[0]  # noqa: E731
    else:
        view = mesh_view(scene, name)
        leaf, (_, loss) = view.vertices.requires_grad_(), ours(view)
    return lambda: torch.autograd.grad(loss(leaf).sum(), leaf)


def mesh_view(scene: BenchScene, name: str) -> MeshView:
    """Projected vertices of the bodies, and what they are compared with."""
    points = scene.camera.project(scene.posed.vertices(LEVELS[name])).detach().contiguous()
    return MeshView(points, ellipbody_mesh(LEVELS[name], device=points.device), scene.targets)


class _Nothing(torch.autograd.Function):
    """A loss and a gradient of the right shapes for one launch each: autograd's own time."""

    @staticmethod
    def forward(ctx: Any, centres: torch.Tensor) -> torch.Tensor:
        ctx.save_for_backward(centres)
        return centres.sum((1, 2))

    @staticmethod
    def backward(ctx: Any, grad_loss: torch.Tensor) -> torch.Tensor:
        (centres,) = ctx.saved_tensors
        return centres * grad_loss[:, None, None]


CALLS_OF: dict[str, Callable[[BenchScene, str], _Call]] = {
    TORCH_GRADIENT: _gradient,
    TORCH_BODY: _body,
    TORCH_LABELS: _labels,
    TORCH_POSE: _pose,
    TORCH_STEP: training_step,
    COMPILED_STEP: compiled_step,
}
