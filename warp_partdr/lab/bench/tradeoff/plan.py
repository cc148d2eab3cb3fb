"""The plan of ``partdr bench tradeoff``: renderers, gradients, picture sizes, iterations and starts."""

from __future__ import annotations

from dataclasses import dataclass

from ....body.pose_prior import PosePrior
from ....inputs.observations import Observations
from ....render.renderers import Renderer
from ....solve.ellipsoids.energy import Energy, Weights
from ..renderers import COVERAGE, EXACT, LEVELS, PARTDR, RENDERERS

NAMES = (*LEVELS, PARTDR, COVERAGE, EXACT)  # renderer and gradient, in the order of tables and legends
SIZE, ITERATIONS, DISTANCE = 256, 50, 0.15  # what stays the same while others change
NEAR, FAR = 0.05, 0.3
RATE = 0.02  # of Adam: between those of a fit's stages


@dataclass(frozen=True)
class Setting:
    """A user's choices for a refinement."""

    name: str  # one of ``NAMES``
    size: int = SIZE  # side of the drawn crop [px]
    iterations: int = ITERATIONS  # of Adam

    @property
    def columns(self) -> dict[str, str | int]:
        """Columns of the setting in rows of JSON."""
        return {"renderer": self.name, "size_px": self.size, "iterations": self.iterations}

    @property
    def renderer(self) -> Renderer:
        """The object that draws."""
        return RENDERERS[self.name]

    def energy(self, observations: Observations, prior: PosePrior, weights: Weights | None = None) -> Energy:
        """The energy that the refinement minimises."""
        return Energy(observations, self.size, weights or Weights(), prior, self.renderer)


@dataclass(frozen=True)
class TradeoffPlan:
    """Amount of what is run; ``SIZE``, ``ITERATIONS`` and ``DISTANCE`` are among its numbers."""

    device: str  # "cpu" or a CUDA device
    ellipbodies: int = 12  # people who are EllipBodies
    annys: int = 12  # people who are Annys
    sizes: tuple[int, ...] = (64, 128, 256, 512)  # sides of the picture [px]
    iterations: tuple[int, ...] = (10, 25, 50, 100)  # each is a run of its own, for the rate falls along all of a run
    distances: tuple[float, ...] = (NEAR, DISTANCE, FAR)  # of starts from the truth [rad]
    gradient_distances: tuple[float, ...] = (0.01, NEAR, DISTANCE, FAR)  # of bodies whose gradients are compared [rad]
    budget: float = 0.5  # for timing a setting [s]
    fits: int = 20  # people whom ``fit_body`` fits at each quality; 0: none


def plan_tradeoff(device: str, *, quick: bool = False) -> TradeoffPlan:
    """All of it, or what takes less than a minute on two cores."""
    if quick:
        return TradeoffPlan(device, 3, 3, (64, 256), (10, 50), (DISTANCE,), (DISTANCE,), 0.05, 1)
    return TradeoffPlan(device)
