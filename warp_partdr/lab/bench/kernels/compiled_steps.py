"""Steps of a training whose loss ``torch.compile`` has compiled: parameters, loss, gradient, Adam."""

from __future__ import annotations

from collections.abc import Callable

import torch

from ....render.renderers import RendererEllipsoids, RendererMesh
from ..renderers import GRADIENTS, LEVELS
from ..scene import BenchScene

_RATE = 0.005


def training_step(scene: BenchScene, name: str) -> Callable[[], torch.Tensor]:
    """Step of the bodies with the mean L_seg of ``crop_loss``; it returns the loss."""
    return _step(scene, name, compiled=False)


def compiled_step(scene: BenchScene, name: str) -> Callable[[], torch.Tensor]:
    """Step of the bodies, from parameters to loss compiled as one graph. The compiler runs at the first call."""
    return _step(scene, name, compiled=True)


def _step(scene: BenchScene, name: str, *, compiled: bool) -> Callable[[], torch.Tensor]:
    leaves = scene.bodies.leaves(log_sizes=True)
    optimizer = torch.optim.Adam(leaves.tensors().values(), lr=_RATE)
    renderer = RendererEllipsoids(GRADIENTS[name]) if name in GRADIENTS else RendererMesh(LEVELS[name])

    def find_loss(target: torch.Tensor) -> torch.Tensor:
        return renderer.crop_loss(leaves.bodies(), target).mean()

    chosen = torch.compile(find_loss, fullgraph=True) if compiled else find_loss

    def step() -> torch.Tensor:
        optimizer.zero_grad()
        loss = chosen(scene.targets)
        loss.backward()
        optimizer.step()
        return loss.detach()

    return step
