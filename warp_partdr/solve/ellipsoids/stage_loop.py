"""Loop over the stages of a fit: bodies of many people are refined side by side, and pruned to one of each."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from ...body.parameters import BodyParameters
from ...body.pose_prior import PosePrior
from ...inputs.observations import Observations
from .energy import Energy
from .options import FitOptions
from .refine import refine_unchecked
from .stages import Progress, Stage
from .start_search import distinct
from .stepper import Descent, EnergyFunction


@dataclass(frozen=True)
class RefinedStages:
    """Bodies after all stages.

    Attributes:
        bodies: The best body of each person, B = N.
        terms: Weighted terms of the last stage's energy by name, shape (N,).
        history: Energy of each body's lineage before each iteration, shape (N, iterations), of each stage.
        seconds: Wall time of each stage, of all people.
        finalists: Energies at the end of the last stage that compared several bodies of a person, best first; of each
            person.
    """

    bodies: BodyParameters
    terms: dict[str, torch.Tensor]
    history: list[np.ndarray]
    seconds: dict[str, float]
    finalists: list[list[float]]


def refine_stages(
    bodies: BodyParameters,
    person_indices: torch.Tensor,
    observations: Observations,
    stages: Sequence[Stage],
    options: FitOptions,
    prior: PosePrior,
    *,
    first_energy: Callable[[Energy], EnergyFunction] | None = None,
    progress: Progress | None = None,
) -> RefinedStages:
    """Refine bodies through all stages.

    Args:
        bodies: B bodies, at least one of each person.
        person_indices: Index of each body's person, in ascending order, shape (B,), int64.
        observations: N people.
        stages: Stages, of which each but the first one first keeps each person's best bodies that are distinct.
        options: Weights of the energy, where a stage has none of its own.
        prior: Prior of poses.
        first_energy: Makes the first stage's energy from the usual one of the B bodies.
        progress: Called after each iteration.
    """
    count = len(observations)
    energies = torch.zeros(bodies.batch_size, device=person_indices.device)
    terms: dict[str, torch.Tensor] = {}
    seconds: dict[str, float] = {}
    lineage: list[np.ndarray] = []  # energies of what is left and of its ancestors
    finalists: list[list[float]] = [[] for _ in range(count)]
    done, total = 0, sum(stage.iterations for stage in stages)
    for index, stage in enumerate(stages):
        started = time.perf_counter()
        if len(person_indices) > count and index > 0:
            kept = _best_of_each(bodies, energies, person_indices, count, stage.bodies)
            bodies, person_indices = bodies.select(kept), person_indices[kept]
            lineage = [rows[kept.cpu().numpy()] for rows in lineage]
        energy = options.energy(stage, observations, prior)
        if count > 1 and len(person_indices) > count:
            energy = energy.select(person_indices)

        def report(iteration: int, name: str = stage.name, before: int = done) -> None:
            assert progress is not None
            progress(name, before + iteration, total)

        refined = refine_unchecked(
            bodies,
            first_energy(energy) if first_energy is not None and index == 0 else energy,
            Descent(stage.iterations, stage.learning_rate, stage.frozen),
            None if progress is None else report,
        )
        bodies, energies, terms = refined.parameters, refined.energy, refined.terms
        lineage.append(refined.history.T.cpu().numpy())
        if len(person_indices) > count:
            finalists = [energies[person_indices == person].sort().values.tolist() for person in range(count)]
        done += stage.iterations
        seconds[stage.name] = time.perf_counter() - started
    if len(person_indices) > count:
        winners = _best_of_each(bodies, energies, person_indices, count, 1)
        bodies, terms = bodies.select(winners), {name: term[winners] for name, term in terms.items()}
        lineage = [rows[winners.cpu().numpy()] for rows in lineage]
    return RefinedStages(bodies, terms, lineage, seconds, finalists)


def _best_of_each(
    bodies: BodyParameters, energies: torch.Tensor, person_indices: torch.Tensor, count: int, most: int
) -> torch.Tensor:
    """Indices of each person's best bodies that are distinct, so many at most, best first."""
    kept = []
    for person in range(count):
        own = (person_indices == person).nonzero()[:, 0]
        kept.append(own[distinct(bodies.select(own), energies[own], most)])
    return torch.cat(kept)
