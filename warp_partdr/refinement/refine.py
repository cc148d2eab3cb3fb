"""The paper's second stage: Adam on the energy from a given start (section 3.4), for any batch of starts at once."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass

import torch

from ..body.parameters import BodyParameters
from ..errors import check_type
from ..interop.checks import check_steps
from ..interop.movable import Movable

LEARNING_RATE = 1e-2  # the paper's
SHAPE_RATE = 0.3  # lengths and thicknesses in metres move this much slower than angles in radians
# Shares of the mean adult's sizes that a body keeps within. A torso's depth can't be seen from the front, and would
# take any value that fills a gap in the labels.
SIZES = {"lengths": (0.6, 1.4), "thicknesses": (0.4, 1.6)}


@dataclass(frozen=True)
class Refined(Movable):
    """Where a refinement ended.

    Attributes:
        parameters: The best bodies seen, B of them.
        energy: Their energy, shape (B,).
        terms: Its weighted terms by name, shape (B,) each.
        history: Energy before each iteration, shape (iterations, B).
    """

    parameters: BodyParameters
    energy: torch.Tensor
    terms: dict[str, torch.Tensor]
    history: torch.Tensor


def refine(
    start: BodyParameters,
    energy: Callable[[BodyParameters], dict[str, torch.Tensor]],
    *,
    iterations: int = 50,
    learning_rate: float = LEARNING_RATE,
    final_rate: float = 0.1,
    frozen: Collection[str] = (),
    on_iteration: Callable[[int], None] | None = None,
) -> Refined:
    """Minimise ``energy`` from every start side by side.

    Args:
        start: B bodies; they do not influence one another.
        energy: Terms by name, shape (B,) each; their sum is minimised.
        iterations: Steps of Adam.
        learning_rate: Of angles [rad] and of the camera [half-sides of the crop]; shape moves at 0.3 of it.
        final_rate: Share of the learning rate at the last step; it falls along a cosine.
        frozen: Names of ``BodyParameters`` that stay as they start and get no gradient, such as ("lengths",
            "thicknesses") of a person who was measured before.
        on_iteration: Called with the number of steps done, for a progress bar.

    Returns:
        The best state of each body, not the last: PartDR's estimate does not promise descent. Lengths stay within 60
        and 140 % of the mean adult's, thicknesses within 40 and 160 %.

    Raises:
        ValueError: If ``frozen`` names what is no parameter, or all of them; if ``iterations`` or ``learning_rate`` is
            out of range, or ``start`` holds NaN or infinity.
    """
    iterations = check_steps(iterations, learning_rate)
    check_type("start", start, BodyParameters, "such as BodyParameters.mean(1)")
    start.check_finite()
    free = BodyParameters.free(frozen)
    bodies = start.leaves(frozen)
    rates = {name: learning_rate * (SHAPE_RATE if name in SIZES else 1.0) for name in free}
    optimizer = torch.optim.Adam([{"params": bodies.tensors()[name], "lr": rate} for name, rate in rates.items()])
    schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, lambda step: rate_share(step, iterations, final_rate))
    mean = BodyParameters.mean(1, device=bodies.lengths.device).tensors()
    bounds = [
        (bodies.tensors()[name], low * mean[name], high * mean[name])
        for name, (low, high) in SIZES.items()
        if name in free
    ]
    best: BodyParameters | None = None
    best_energy = torch.empty(0)
    best_terms: dict[str, torch.Tensor] = {}
    history = []
    for iteration in range(iterations + 1):
        last = iteration == iterations
        with torch.set_grad_enabled(not last):
            terms = energy(bodies)
            total = torch.stack(list(terms.values())).sum(0)
        now = total.detach()
        if best is None:
            best, best_energy = bodies.leaves().detach(), now
            best_terms = {name: term.detach() for name, term in terms.items()}
        else:
            better = now < best_energy
            best_energy = torch.where(better, now, best_energy)
            best_terms = {name: torch.where(better, terms[name].detach(), old) for name, old in best_terms.items()}
            for name, old in best.tensors().items():
                old.copy_(torch.where(better.view(-1, *[1] * (old.dim() - 1)), bodies.tensors()[name].detach(), old))
        if last:
            break
        history.append(now)
        optimizer.zero_grad(set_to_none=True)
        total.sum().backward()
        optimizer.step()
        schedule.step()
        with torch.no_grad():
            for sizes, low, high in bounds:
                sizes.clamp_(low, high)
        if on_iteration is not None:
            on_iteration(iteration + 1)
    assert best is not None
    return Refined(best, best_energy, best_terms, torch.stack(history) if history else best_energy[None][:0])


def rate_share(step: int, iterations: int, final_rate: float) -> float:
    """Share of the learning rate at a step: from 1 to ``final_rate`` along a cosine."""
    return final_rate + (1 - final_rate) * (1 + math.cos(math.pi * step / max(iterations, 1))) / 2
