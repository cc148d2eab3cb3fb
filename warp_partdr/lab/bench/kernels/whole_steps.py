"""Whole steps of a training: parameters, loss, gradient, Adam; as a loop in Python, compiled, and as one call."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import torch
import warp as wp

from ....body.parameters import BodyLeaves
from ....interop.training_step import TrainingStep
from ....render.ellipsoids import ellipsoid_label_loss
from ....render.renderers import RendererEllipsoids, RendererMesh
from ..renderers import GRADIENTS, LEVELS
from ..scene import BenchScene
from ..timing import Timing, peak_memory, repeat, wall_time
from .plan import COMPILED_STEP, LOOP_STEP, POSED, WHOLE_STEP

_Step = Callable[[], torch.Tensor]  # takes a step and returns its loss
_Loss = Callable[[torch.Tensor], torch.Tensor]

_IN_A_ROW = 20  # steps that are timed together, as they follow one another in a training
_CHECKED = 10  # steps after which both ways must have the same loss
_TOLERANCE = 0.03  # of the losses: on CUDA, a mesh's forces are added in any order
_RATE = 0.005


def time_steps(scene: BenchScene, what: str, name: str, budget: float) -> tuple[Timing, int | None]:
    """Time of a step, where many follow one another, and the most memory that torch takes for them [bytes].

    Raises:
        AssertionError: If it does not have the losses of the loop.
    """
    device = str(scene.targets.device)
    if what != LOOP_STEP:
        _check(scene, what, name)
    step = _MAKERS[what](scene, name)

    def some() -> None:
        for _ in range(_IN_A_ROW):
            step()

    memory = peak_memory(some, device)
    return repeat(lambda: [wall_time(some, device) / _IN_A_ROW], budget), memory


def _check(scene: BenchScene, what: str, name: str) -> None:
    losses = []
    for make in (_MAKERS[what], _loop):
        step = make(scene, name)
        losses.append(torch.stack([step() for _ in range(_CHECKED)]))
    wp.synchronize_device(wp.device_from_torch(scene.targets.device))
    torch.testing.assert_close(losses[0], losses[1], rtol=_TOLERANCE, atol=0)


def _loop(scene: BenchScene, name: str, *, compiled: bool = False) -> _Step:
    leaves, optimizer = _begin(scene)
    loss_of = _loss_of(scene, name, leaves)
    find_loss = torch.compile(loss_of, fullgraph=True) if compiled else loss_of

    def step() -> torch.Tensor:
        optimizer.zero_grad()
        loss = find_loss(scene.targets)
        loss.backward()
        optimizer.step()
        return loss.detach()

    return step


def _whole(scene: BenchScene, name: str) -> _Step:
    leaves, optimizer = _begin(scene)
    return partial(TrainingStep(_loss_of(scene, name, leaves), optimizer), scene.targets)


_MAKERS: dict[str, Callable[[BenchScene, str], _Step]] = {
    LOOP_STEP: _loop,
    WHOLE_STEP: _whole,
    COMPILED_STEP: partial(_loop, compiled=True),
}


def _begin(scene: BenchScene) -> tuple[BodyLeaves, torch.optim.Optimizer]:
    leaves = scene.bodies.leaves(log_sizes=True)
    return leaves, torch.optim.Adam(leaves.tensors().values(), lr=_RATE)


def _loss_of(scene: BenchScene, name: str, leaves: BodyLeaves) -> _Loss:
    """Mean L_seg of the bodies."""
    exact = GRADIENTS.get(name.removesuffix(POSED))
    if exact is None or not name.endswith(POSED):
        renderer = RendererMesh(LEVELS[name]) if exact is None else RendererEllipsoids(exact)
        return lambda target: renderer.crop_loss(leaves.bodies(), target).mean()

    def find_loss(target: torch.Tensor) -> torch.Tensor:
        bodies = leaves.bodies()
        seen = bodies.posed(), bodies.camera(scene.size), target
        return ellipsoid_label_loss(*seen, gradient=exact, validate=False)[0].mean()

    return find_loss
