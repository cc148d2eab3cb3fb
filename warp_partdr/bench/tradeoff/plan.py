"""The plan of ``partdr bench tradeoff``: renderers, gradients, picture sizes, iterations and starts."""

from __future__ import annotations

from dataclasses import dataclass

from ...body.pose_prior import PosePrior
from ...inputs.observation import Observation
from ...refinement.energy import Energy, Weights
from ...render.renderers import Renderer
from ..renderers import COVERAGE, EXACT, LEVELS, PARTDR, RENDERERS

NAMES = (*LEVELS, PARTDR, COVERAGE, EXACT)  # renderer and gradient, in the order of tables and legends
SIZE, ITERATIONS, DISTANCE = 256, 50, 0.15  # what stays the same while others change
NEAR, FAR = 0.05, 0.3
RATE = 0.02  # of Adam: between those of a fit's stages


@dataclass(frozen=True)
class Setting:
    """A user's choices for a refinement.

    Attributes:
        name: One of ``NAMES``.
        size: Side of the drawn crop [px].
        iterations: Steps of Adam.
    """

    name: str
    size: int = SIZE
    iterations: int = ITERATIONS

    @property
    def columns(self) -> dict[str, str | int]:
        """The same in rows of JSON."""
        return {"renderer": self.name, "size_px": self.size, "iterations": self.iterations}

    @property
    def renderer(self) -> Renderer:
        """The object that draws."""
        return RENDERERS[self.name]

    def energy(self, seen: Observation, prior: PosePrior, weights: Weights | None = None) -> Energy:
        """The energy that the refinement minimises."""
        return Energy(seen, self.size, weights or Weights(), prior, self.renderer)


@dataclass(frozen=True)
class TradeoffPlan:
    """Amount of what is run; ``SIZE``, ``ITERATIONS`` and ``DISTANCE`` are among its numbers.

    Attributes:
        device: "cpu" or a CUDA device.
        ellipbodies: People who are EllipBodies.
        annys: People who are Annys.
        sizes: Sides of the picture [px].
        iterations: Steps of Adam; each number is a run of its own, for the rate falls along all of a run.
        distances: Of starts from the truth [rad].
        gradient_distances: The same, of bodies whose gradients are compared [rad].
        budget: For timing a setting [s].
        fits: People whom ``fit_body`` fits at each quality; 0: none.
    """

    device: str
    ellipbodies: int = 12
    annys: int = 12
    sizes: tuple[int, ...] = (64, 128, 256, 512)
    iterations: tuple[int, ...] = (10, 25, 50, 100)
    distances: tuple[float, ...] = (NEAR, DISTANCE, FAR)
    gradient_distances: tuple[float, ...] = (0.01, NEAR, DISTANCE, FAR)
    budget: float = 0.5
    fits: int = 20


def plan_tradeoff(device: str, *, quick: bool = False) -> TradeoffPlan:
    """All of it, or what takes less than a minute on two cores."""
    if quick:
        return TradeoffPlan(device, 3, 3, (64, 256), (10, 50), (DISTANCE,), (DISTANCE,), 0.05, 1)
    return TradeoffPlan(device)
