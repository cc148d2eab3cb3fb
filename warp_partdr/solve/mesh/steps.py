"""Steps of Adam on the energy of detailed bodies; on CUDA one captured graph, kept for as many other people."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch

from ...interop.adam import Adam, descend
from ...interop.captured_step import CapturedStep
from ...interop.graph_cache import graphs
from ..ellipsoids.stepper import FINAL_RATE
from .energy import MeshEnergy
from .starts import Starts, Unknowns

# Of Adam. So few steps can't wait for torch's defaults: these forget the start's large gradients, and overshoot less.
_BETAS = 0.7, 0.95


@dataclass(frozen=True)
class RefinedPeople:
    """People whose numbers were refined; a later refinement changes none of these tensors.

    Attributes:
        people: Where they started, and what was observed of them.
        unknowns: Their numbers after the last step.
        terms: Weighted terms of the energy before the last step by name, one number a cost's row; none without a step.
    """

    people: Starts
    unknowns: Unknowns
    terms: dict[str, torch.Tensor]

    @property
    def energies(self) -> dict[str, float]:
        """Weighted terms of all people together, by name."""
        return {name: float(term.sum()) for name, term in self.terms.items()}


def refine_starts(energy: MeshEnergy, people: Starts, progress: Callable[[int], None]) -> RefinedPeople:
    """Refine people from their start on.

    Args:
        energy: Energy, with the number of steps and their size.
        people: Where they start, and what was observed of them.
        progress: Called after each step with the number of steps that are done.
    """
    steps = find_steps(energy, people)
    options = energy.options
    descend(lambda _, share: steps.step(share), options.iterations, last_share=FINAL_RATE, progress=progress)
    with torch.no_grad():
        terms = {name: term.clone() for name, term in steps.terms.items()}
        return RefinedPeople(people, steps.unknowns.copied(), terms)


class Steps:
    """Adam on what is unknown.

    Attributes:
        energy: The energy: the weighted sum of all numbers of its costs.
        people: Where they start, and what was observed of them.
    """

    def __init__(self, energy: MeshEnergy, people: Starts) -> None:
        self.energy, self.people, self._rates = energy, people, people.learning_rates()
        # In units of their rates, so that Adam has one tensor.
        self._moves = torch.zeros_like(self._rates).requires_grad_()
        self._adam = Adam([([self._moves], energy.options.learning_rate)], betas=_BETAS)
        self._costs: dict[str, torch.Tensor] = {}
        self._pulls: dict[str, torch.Tensor] = {}  # weights, of the costs' shapes

    @property
    def unknowns(self) -> Unknowns:
        """Unknowns as they are now."""
        return self.people.moved(self._moves * self._rates)

    @property
    def terms(self) -> dict[str, torch.Tensor]:
        """Weighted terms of the energy before the last step by name, shape (B,) each."""
        factors = self.energy.factors(self.people)
        costs = {name: cost.detach() for name, cost in self._costs.items()}
        return {name: factors[name] * cost.reshape(len(cost), -1).sum(1) for name, cost in costs.items()}

    def step(self, share: float | torch.Tensor) -> None:
        """Take one step, at this share of the learning rate."""
        self._costs = self.energy(self.people, self.unknowns)
        if not self._pulls:
            factors = self.energy.factors(self.people)
            self._pulls = {name: torch.full_like(cost, factors[name]) for name, cost in self._costs.items()}
        torch.autograd.backward(list(self._costs.values()), list(self._pulls.values()))
        self._adam.step(share)

    @torch.no_grad()
    def restart(self, people: Starts) -> None:
        """Take other people, as many as before."""
        torch._foreach_copy_(self.people.tensors(), people.tensors())
        self._moves.zero_()
        self._adam.restart()


class _CapturedSteps(Steps):
    """Steps on CUDA, by one captured graph."""

    def __init__(self, energy: MeshEnergy, people: Starts) -> None:
        super().__init__(energy, people.copied())
        self._share = torch.ones((), device=self._rates.device)
        with torch.enable_grad():
            self._captured = CapturedStep(lambda: super(_CapturedSteps, self).step(self._share), self._share.device)

    def step(self, share: float | torch.Tensor) -> None:
        self._share.fill_(share)
        self._captured.replay()


def find_steps(energy: MeshEnergy, people: Starts) -> Steps:
    """Steps from people's start; on CUDA those of a graph that is kept, if there is one of as many people."""
    device = people.shape.device
    if device.type == "cuda" and energy.options.iterations > 0:
        shapes = tuple((name, each.shape) for name, each in people.named().items())  # names tell which are there
        key = _CapturedSteps, energy, shapes
        steps = graphs.find(key, device, 0, lambda: _CapturedSteps(energy, people), at_once=True)
        if steps is not None:
            steps.restart(people)
            return steps
    return Steps(energy, people)
