"""Steps of Adam on an energy of many numbers; on CUDA one captured graph, kept for as many other people."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Generic, Protocol, Self, TypeVar

import torch

from ...interop.adam import Adam
from ...interop.captured_step import CapturedStep
from ...interop.graph_cache import graphs
from ...interop.movable import Movable
from .mesh_options import MeshOptions


class Tensors(Movable):
    """Mixin for a dataclass of tensors, others of these, or None: starts, which a captured graph copies from others."""

    def named(self) -> dict[str, torch.Tensor]:
        """All that are there, by their names."""
        found: dict[str, torch.Tensor] = {}
        for name, value in vars(self).items():
            if isinstance(value, Tensors):
                found |= {f"{name}.{own}": tensor for own, tensor in value.named().items()}
            elif value is not None:
                found[name] = value
        return found

    def tensors(self) -> list[torch.Tensor]:
        """All that are there."""
        return list(self.named().values())

    def copied(self) -> Self:
        """Copies of all tensors."""
        values = {name: value for name, value in vars(self).items() if value is not None}
        return replace(
            self,
            **{name: value.copied() if isinstance(value, Tensors) else value.clone() for name, value in values.items()},
        )


# Of Adam. So few steps can't wait for torch's defaults: these forget the start's large gradients, and overshoot less.
_BETAS = 0.7, 0.95

P = TypeVar("P", bound=Tensors)
U = TypeVar("U")
_P = TypeVar("_P", bound=Tensors, contravariant=True)


class StepEnergy(Protocol[_P, U]):
    """Energy whose unknowns are moves from a start: the weighted sum of all numbers of its costs."""

    def factors(self, people: _P) -> Mapping[str, float]:
        """Weights of all costs, by name."""

    def __call__(self, people: _P, unknowns: U) -> dict[str, torch.Tensor]:
        """Costs by name, shape (B, ...) each: sums that nobody needs at each step are left out."""

    def rates(self, people: _P) -> torch.Tensor:
        """Learning rates of all moves, of the moves' shape."""

    def moved(self, people: _P, moves: torch.Tensor) -> U:
        """Numbers after these moves."""


class Steps(Generic[P, U]):
    """Adam on what is unknown."""

    def __init__(self, energy: StepEnergy[P, U], people: P, learning_rate: float) -> None:
        self._energy, self._people, self._rates = energy, people, energy.rates(people)
        # In units of their rates, so that Adam has one tensor.
        self._moves = torch.zeros_like(self._rates).requires_grad_()
        self._adam = Adam([([self._moves], learning_rate)], betas=_BETAS)
        self._costs: dict[str, torch.Tensor] = {}
        self._pulls: dict[str, torch.Tensor] = {}  # weights, of the costs' shapes

    @property
    def unknowns(self) -> U:
        """Unknowns as they are now."""
        return self._energy.moved(self._people, self._moves * self._rates)

    @property
    def terms(self) -> dict[str, torch.Tensor]:
        """Weighted terms of the energy before the last step by name, shape (B,) each."""
        factors = self._energy.factors(self._people)
        costs = {name: cost.detach() for name, cost in self._costs.items()}
        return {name: factors[name] * cost.reshape(len(cost), -1).sum(1) for name, cost in costs.items()}

    def step(self, share: float | torch.Tensor) -> None:
        """Take one step, at this share of the learning rate."""
        self._costs = self._energy(self._people, self.unknowns)
        if not self._pulls:
            factors = self._energy.factors(self._people)
            self._pulls = {name: torch.full_like(cost, factors[name]) for name, cost in self._costs.items()}
        torch.autograd.backward(list(self._costs.values()), list(self._pulls.values()))
        self._adam.step(share)

    @torch.no_grad()
    def restart(self, people: P) -> None:
        """Take other people, as many as before."""
        torch._foreach_copy_(self._people.tensors(), people.tensors())
        self._moves.zero_()
        self._adam.restart()


class _CapturedSteps(Steps[P, U]):
    """Steps on CUDA, by one captured graph."""

    def __init__(self, energy: StepEnergy[P, U], people: P, learning_rate: float) -> None:
        super().__init__(energy, people.copied(), learning_rate)
        self._share = torch.ones((), device=self._rates.device)
        with torch.enable_grad():
            self._captured = CapturedStep(lambda: super(_CapturedSteps, self).step(self._share), self._share.device)

    def step(self, share: float | torch.Tensor) -> None:
        self._share.fill_(share)
        self._captured.replay()


def find_steps(energy: StepEnergy[P, U], people: P, options: MeshOptions) -> Steps[P, U]:
    """Steps from people's start; on CUDA those of a graph that is kept, if there is one of as many people."""
    tensors = people.tensors()
    device, rate = tensors[0].device, options.learning_rate
    if device.type == "cuda" and options.iterations > 0:
        shapes = tuple((name, each.shape) for name, each in people.named().items())  # names tell which are there
        key = _CapturedSteps, energy, shapes, rate
        steps = graphs.find(key, device, 0, lambda: _CapturedSteps(energy, people, rate), at_once=True)
        if steps is not None:
            steps.restart(people)
            return steps
    return Steps(energy, people, rate)
