"""Steps of Adam on the energy of detailed bodies; on CUDA, one captured graph serves all batches of the same size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch

from ...interop.adam import Adam, descend
from ...interop.captured_step import CapturedStep
from ...interop.graph_cache import graphs
from ...interop.weighted_costs import backward_weighted
from ..ellipsoids.stepper import FINAL_RATE
from .energy import MeshEnergy
from .starts import Starts, Unknowns

# Decay rates of Adam's moments. With torch's defaults, a few steps would not be enough to forget the large gradients of
# the start. These forget them sooner, and overshoot less.
_BETAS = 0.7, 0.95


@dataclass(frozen=True)
class RefinedPeople:
    """People after a refinement. A later refinement does not change these tensors.

    Attributes:
        people: Starts and observations of the people.
        unknowns: Unknowns after the last step.
        terms: Weighted terms of the energy before the last step by name, one number for each row of a cost. Empty if
            there was no step.
    """

    people: Starts
    unknowns: Unknowns
    terms: dict[str, torch.Tensor]

    @property
    def energies(self) -> dict[str, float]:
        """Weighted terms by name, each summed over all people."""
        return {name: float(term.sum()) for name, term in self.terms.items()}


def refine_starts(energy: MeshEnergy, people: Starts, progress: Callable[[int], None]) -> RefinedPeople:
    """Refine people from their starts.

    Args:
        energy: Energy, whose options give the number of steps and the learning rate.
        people: Starts and observations of the people.
        progress: Function that is called after each step with the number of steps done.
    """
    steps = find_steps(energy, people)
    options = energy.options
    descend(lambda _, share: steps.step(share), options.iterations, last_share=FINAL_RATE, progress=progress)
    with torch.no_grad():
        terms = {name: term.clone() for name, term in steps.terms.items()}
        return RefinedPeople(people, steps.unknowns.copied(), terms)


class Steps:
    """Optimiser of the unknowns by Adam. It minimises the weighted sum of all numbers of the energy's costs.

    Attributes:
        energy: Energy of the people.
        people: Starts and observations of the people.
    """

    def __init__(self, energy: MeshEnergy, people: Starts) -> None:
        self.energy = energy
        self.people = people
        self._rates = people.learning_rates()
        # Moves are in units of their learning rates, so that Adam can treat them as one tensor with one rate.
        self._moves = torch.zeros_like(self._rates).requires_grad_()
        self._adam = Adam([([self._moves], energy.options.learning_rate)], betas=_BETAS)
        self._costs: dict[str, torch.Tensor] = {}
        self._pulls: dict[str, torch.Tensor] = {}  # weights in the shapes of the costs

    @property
    def unknowns(self) -> Unknowns:
        """Current unknowns."""
        return self.people.moved(self._moves * self._rates)

    @property
    def terms(self) -> dict[str, torch.Tensor]:
        """Weighted terms of the energy before the last step by name, shape (B,) each."""
        factors = self.energy.factors(self.people)
        costs = {name: cost.detach() for name, cost in self._costs.items()}
        return {name: factors[name] * cost.reshape(len(cost), -1).sum(1) for name, cost in costs.items()}

    def step(self, share: float | torch.Tensor) -> None:
        """Take one step at a share of the learning rate."""
        self._costs = self.energy(self.people, self.unknowns)
        if not self._pulls:
            factors = self.energy.factors(self.people)
            self._pulls = {name: torch.full_like(cost, factors[name]) for name, cost in self._costs.items()}
        backward_weighted(list(self._costs.values()), list(self._pulls.values()))
        self._adam.step(share)

    @torch.no_grad()
    def restart(self, people: Starts) -> None:
        """Start again with other people, whose tensors have the same shapes."""
        torch._foreach_copy_(self.people.tensors(), people.tensors())
        self._moves.zero_()
        self._adam.restart()


class _CapturedSteps(Steps):
    """Optimiser whose step is one captured graph on CUDA."""

    def __init__(self, energy: MeshEnergy, people: Starts) -> None:
        super().__init__(energy, people.copied())
        self._share = torch.ones((), device=self._rates.device)
        with torch.enable_grad():
            self._captured = CapturedStep(lambda: super(_CapturedSteps, self).step(self._share), self._share.device)

    def step(self, share: float | torch.Tensor) -> None:
        self._share.fill_(share)
        self._captured.replay()


def find_steps(energy: MeshEnergy, people: Starts) -> Steps:
    """Find the optimiser of these people; on CUDA a kept one with a captured graph, if the shapes are the same."""
    device = people.shape.device
    if device.type == "cuda" and energy.options.iterations > 0:
        shapes = tuple((name, each.shape) for name, each in people.named().items())  # some tensors may be missing
        key = _CapturedSteps, energy, shapes
        steps = graphs.find(key, device, 0, lambda: _CapturedSteps(energy, people), at_once=True)
        if steps is not None:
            steps.restart(people)
            return steps
    return Steps(energy, people)
