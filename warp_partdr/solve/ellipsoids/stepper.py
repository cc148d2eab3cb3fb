"""Second stage of the paper (section 3.4) step by step: Adam minimises any energy by autograd.

The module ``captured`` has the same learning rates and bounds of sizes, and gives the same type of result.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass

import torch

from ...body.parameters import BodyParameters
from ...errors import check_type
from ...interop.adam import Adam, cosine_share, descend
from ...interop.checks import FLOATS, check_steps, check_tensor
from ...interop.movable import Movable

EnergyFunction = Callable[[BodyParameters], dict[str, torch.Tensor]]

LEARNING_RATE = 1e-2  # learning rate of the paper
FINAL_RATE = 0.1  # share of the learning rate at the last step
SHAPE_RATE = 0.3  # share of the learning rate of angles [rad] that lengths and thicknesses [m] have
# Bounds of a body's sizes, as shares of the mean adult's. A torso's depth can't be seen from the front. Without bounds
# it would take any value that fills a gap in the labels.
SIZES = {"lengths": (0.6, 1.4), "thicknesses": (0.4, 1.6)}


@dataclass(frozen=True)
class Descent:
    """Course of a refinement.

    Attributes:
        iterations: Steps of Adam.
        learning_rate: Rate of angles [rad] and of the camera [half-sides of the crop] at the first step.
        frozen: Names of parameters that stay as they are.
    """

    iterations: int = 50
    learning_rate: float = LEARNING_RATE
    frozen: tuple[str, ...] = ()


@dataclass(frozen=True)
class Refined(Movable):
    """Result of a refinement.

    Attributes:
        parameters: Best state of each body, B bodies.
        energy: Energy of these bodies, shape (B,).
        terms: Weighted terms of this energy by name, shape (B,) each.
        history: Energy before each iteration, shape (iterations, B).
    """

    parameters: BodyParameters
    energy: torch.Tensor
    terms: dict[str, torch.Tensor]
    history: torch.Tensor


def rate_share(step: int, iterations: int) -> float:
    """Share of the learning rate at a step: it falls from 1 to ``FINAL_RATE`` along a cosine, then stays."""
    return cosine_share(step, iterations, FINAL_RATE)


def size_bounds(name: str, device: torch.device | str) -> tuple[torch.Tensor, torch.Tensor]:
    """Bounds of "lengths" or "thicknesses" [m]: the smallest and the largest, shape (1, 12) or (1, 15) each."""
    low, high = SIZES[name]
    mean = BodyParameters.mean(1, device=device).tensors()[name]
    return low * mean, high * mean


class Refinement:
    """Optimiser of a batch of bodies by autograd; ``refine`` describes its arguments and errors.

    Attributes:
        energy: Energy to be minimised.
        bodies: Current state of the B bodies.
        best: Best state of each body so far; None before the first step.
        history: Energy before each step so far, shape (B,) each.
    """

    def __init__(
        self,
        start: BodyParameters,
        energy: EnergyFunction,
        *,
        iterations: int = 50,
        learning_rate: float = LEARNING_RATE,
        frozen: Collection[str] = (),
    ) -> None:
        self._iterations = check_steps(iterations, learning_rate)
        check_type("start", start, BodyParameters, "such as BodyParameters.mean(1)")
        start.check_finite()
        free = BodyParameters.free(frozen)
        self.energy, self.bodies = energy, start.leaves(frozen)
        self.best: Refined | None = None
        self.history: list[torch.Tensor] = []
        tensors = self.bodies.tensors()
        sizes = [tensors[name] for name in free if name in SIZES]
        pose = [tensors[name] for name in free if name not in SIZES]
        self._adam = Adam([(sizes, learning_rate * SHAPE_RATE), (pose, learning_rate)])
        device = self.bodies.lengths.device
        self._bounds = [(tensors[name], *size_bounds(name, device)) for name in SIZES if name in free]

    def step(self, share: float) -> None:
        """Take one iteration at a share of the learning rate (``rate_share``).

        It evaluates the energy, keeps the best states, and moves the bodies.
        """
        total = self._evaluate()
        self.history.append(total.detach())
        total.sum().backward()
        self._adam.step(share)
        with torch.no_grad():
            for sizes, low, high in self._bounds:
                sizes.clamp_(low, high)

    def run(self, on_iteration: Callable[[int], None] | None = None) -> Refined:
        """Take all iterations, and evaluate the last state."""
        descend(lambda _, share: self.step(share), self._iterations, last_share=FINAL_RATE, progress=on_iteration)
        with torch.no_grad():
            total = self._evaluate()
        best = self.best
        assert best is not None
        history = torch.stack(self.history) if self.history else total[None][:0]
        return Refined(best.parameters, best.energy, best.terms, history)

    def _check(self, terms: object) -> None:
        """Raise an error unless the energy's function returned terms of each body that can be minimised."""
        if not isinstance(terms, Mapping) or not terms:
            returned = "none" if isinstance(terms, Mapping) else type(terms).__name__
            raise TypeError(f"energy: returned {returned}; expected terms by name, tensors of shape (B,)")
        for name, term in terms.items():
            check_tensor(f"energy: {name}", term, (self.bodies.batch_size,), dtypes=FLOATS)
        if torch.is_grad_enabled() and not any(term.requires_grad for term in terms.values()):
            raise ValueError("energy: no term has a gradient; expected them to be made of the bodies' parameters")

    def _evaluate(self) -> torch.Tensor:
        """Evaluate the energy, shape (B,), and keep the best state of each body."""
        terms = self.energy(self.bodies)
        if self.best is None:
            self._check(terms)
        total = torch.stack(list(terms.values())).sum(0)
        now = total.detach()
        if self.best is None:
            first = {name: term.detach() for name, term in terms.items()}
            self.best = Refined(self.bodies.leaves().detach(), now, first, now[None][:0])
            return total
        best = self.best
        better = now < best.energy
        for name, old in best.parameters.tensors().items():
            new = self.bodies.tensors()[name].detach()
            old.copy_(torch.where(better.view(-1, *[1] * (old.dim() - 1)), new, old))
        lowest = {name: torch.where(better, terms[name].detach(), old) for name, old in best.terms.items()}
        self.best = Refined(best.parameters, torch.where(better, now, best.energy), lowest, best.history)
        return total
