"""Stages of each quality of a fit, chosen from the measurements of ``partdr bench tradeoff``."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

from ...body.parameters import BodyParameters
from ...errors import check_whole
from ...interop.checks import MAX_PICTURE, MAX_PIXELS, check_steps
from ...render.renderers import Renderer, RendererEllipsoids
from .energy import Weights

Quality = Literal["fast", "balanced", "accurate"]
Start = Literal["network", "search"]
# Called with the stage's name, the iterations done, and the iterations in all.
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Stage:
    """Stage of a fit: it refines the bodies that are left, and the next stage keeps the best of them.

    Attributes:
        name: Name in the progress bar and the report.
        bodies: Largest number of hypotheses that enter the stage.
        iterations: Number of steps of Adam.
        learning_rate: Learning rate of the first step, which ``refine`` describes.
        size: Side of the drawn crop [px]; 0 draws nothing, so that only keypoints count.
        weights: Weights of the energy's terms in this stage; None takes the fit's. The term of depth holds only bodies
            that begin at the network's, to the depths where they began.
        renderer: Renderer of exact ellipsoids or of their mesh, with the options of its gradient.
        frozen: Names of ``BodyParameters`` that stay as they are.

    Examples:
        >>> from warp_partdr import FitOptions, RendererMesh, Stage
        >>> stage = Stage("labels", bodies=1, iterations=40, learning_rate=0.01, size=128, renderer=RendererMesh(1))
        >>> FitOptions(stages=(stage,)).stages[0].size
        128
    """

    name: str
    bodies: int
    iterations: int
    learning_rate: float
    size: int = 0
    weights: Weights | None = None
    renderer: Renderer = field(default_factory=RendererEllipsoids)
    frozen: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        whole = {
            "bodies": check_whole("bodies", self.bodies, 1, MAX_PIXELS),
            "size": check_whole("size", self.size, 0, math.isqrt(MAX_PICTURE) - 1),
            "iterations": check_steps(self.iterations, self.learning_rate),
        }
        for name, value in whole.items():  # JSON can hold ints, but not the integers of NumPy
            object.__setattr__(self, name, value)
        BodyParameters.free(self.frozen)


_EDGES = RendererEllipsoids("edges")

_SEARCH: dict[Quality, tuple[Stage, ...]] = {
    "fast": (
        Stage("lift", 64, 20, 0.15),
        Stage("keypoints", 64, 15, 0.05),
        Stage("labels, coarse", 8, 25, 0.03, 64, renderer=_EDGES),
        Stage("labels, fine", 2, 25, 0.02, 128, renderer=_EDGES),
    ),
    "balanced": (
        Stage("lift", 256, 30, 0.1),
        Stage("keypoints", 256, 20, 0.04),
        Stage("labels, coarse", 40, 25, 0.03, 64),
        Stage("labels, middle", 12, 25, 0.02, 128),
        Stage("labels, fine", 4, 50, 0.01, 256),
    ),
    "accurate": (
        Stage("lift", 256, 30, 0.1),
        Stage("keypoints", 256, 40, 0.04),
        Stage("labels, coarse", 64, 50, 0.03, 64, renderer=_EDGES),
        Stage("labels, middle", 24, 50, 0.02, 128, renderer=_EDGES),
        Stage("labels, fine", 8, 100, 0.01, 256, renderer=_EDGES),
    ),
}

# From the network's body, a few iterations do; keypoints count less beside labels than in a search, and sizes are held
# to what the network says. Neither labels nor keypoints hold depth, so bodies lean and limbs tilt to fill an outline,
# and bones stretch to where label sets end parts. So depth is held as hard as the network is sure of it.
# (In a search this gains nothing: the depth of its bodies is no better than an outline's.)
_NEAR = Weights(proj=0.3, prior=1.0, length=1e-2, thickness=2e-3, depth=1.0)

_NETWORK: dict[Quality, tuple[Stage, ...]] = {
    "fast": (Stage("labels", 1, 50, 0.007, 128, _NEAR, renderer=_EDGES),),
    "balanced": (Stage("labels", 1, 50, 0.007, 192, _NEAR, renderer=_EDGES),),
    "accurate": (Stage("labels", 1, 50, 0.007, 192, _NEAR, renderer=_EDGES),),
}
STAGES: dict[Start, dict[Quality, tuple[Stage, ...]]] = {"network": _NETWORK, "search": _SEARCH}

# Labels tell a body's outline better than its joints: where thighs end and torsos begin, label sets and ellipsoids
# disagree. So following the outline is a stage of its own, for those who want it. It leans on the labels, holds
# keypoints, sizes and pose harder than other stages do, and after a network's body the depth too; pixels act on near
# edges alone.
OUTLINE = "outline"
OUTLINE_STAGES: dict[Start, Stage] = {
    "network": Stage(
        OUTLINE,
        1,
        300,
        0.01,
        192,
        Weights(proj=2.5, seg=0.5, prior=10.0, length=2e-2, thickness=2e-3, depth=10.0),
        _EDGES,
    ),
    "search": Stage(
        OUTLINE,
        1,
        250,
        0.01,
        256,
        Weights(proj=3.0, seg=0.5, prior=10.0, length=1e-2, thickness=2e-3),
        RendererEllipsoids(max_distance=2.0),
    ),
}
# The coverage gradient's steps lower the loss of labels itself; the weights are the usual ones but for L_seg's.
LABELS_FIRST_STAGE = Stage(OUTLINE, 1, 1000, 0.01, 256, Weights(seg=1.0), RendererEllipsoids("coverage"))
