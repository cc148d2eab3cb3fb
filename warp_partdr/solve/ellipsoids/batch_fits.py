"""Fits of N people as arrays; a person's ``FitResult`` is made when it is asked for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np

from ...body.parameters import BodyParameters
from ...inputs.cut_people import CutPeople
from ...inputs.observations import Observations
from ...networks.regression.uncertainty import Uncertainty
from .depth_flips import DepthOrder
from .result import FitResult
from .stages import Stage, Start


@dataclass(frozen=True, eq=False)
class BatchFits(Sequence[FitResult]):
    """Fits of N people, all through the same stages.

    Attributes:
        people: People who were fitted, as they were given.
        observations: Observations as the fits saw them: with expected sizes and depths, with longer lenses, and with
            less confidence in keypoints that the network doubts.
        stages: Stages of the fits.
        parameters: Bodies and their cameras in the crops, B = N.
        energy: Weighted terms of the energy at the end by name, shape (N,).
        history: Energy before each iteration, shape (N, iterations), of each stage.
        stage_seconds: Wall time of each stage, of all N people.
        body_warnings: Warnings of bodies by their rows; most have none.
        depth_orders: Limbs that were tried mirrored in depth.
        uncertainty: Uncertainty of the network about its bodies, B = N; None after a search.
        start: Start of the fits, "network" or "search".
        hypotheses: Number of starts of each person; None: one each.
        finalists: Energies at the end of the last stage that compared several bodies of a person, best first; of each
            person. Empty if no stage did.
    """

    people: CutPeople
    observations: Observations
    stages: tuple[Stage, ...]
    parameters: BodyParameters
    energy: Mapping[str, np.ndarray]
    history: Sequence[np.ndarray]
    stage_seconds: Mapping[str, float]
    body_warnings: Mapping[int, list[str]]
    depth_orders: Sequence[DepthOrder | None]
    uncertainty: Uncertainty | None
    start: Start = "network"
    hypotheses: Sequence[int] | None = None
    finalists: Sequence[list[float]] = ()

    def __len__(self) -> int:
        """Number of people, N."""
        return len(self.people)

    @overload
    def __getitem__(self, index: int) -> FitResult: ...
    @overload
    def __getitem__(self, index: slice) -> list[FitResult]: ...
    def __getitem__(self, index: int | slice) -> FitResult | list[FitResult]:
        """Return the fit of one person, or of some."""
        if isinstance(index, slice):
            return [self[row] for row in range(*index.indices(len(self)))]
        row = range(len(self))[index]
        own, person, observation = slice(row, row + 1), self.people[row], self.observations[row]
        return FitResult(
            parameters=self.parameters.select(own),
            crop=person.crop,
            observation=observation,
            stages=self.stages,
            energy={name: float(values[row]) for name, values in self.energy.items()},
            history=[each[row] for each in self.history],
            stage_seconds=dict(self.stage_seconds),
            hypotheses=1 if self.hypotheses is None else self.hypotheses[row],
            finalists=self.finalists[row] if self.finalists else [],
            start=self.start,
            evidence=person.evidence,
            warnings=self.warnings(row),
            depth_order=self.depth_orders[row],
            uncertainty=None if self.uncertainty is None else self.uncertainty.select(own),
            stature=observation.stature,
        )

    def warnings(self, row: int) -> tuple[str, ...]:
        """Faults of one person's input or body, a sentence each."""
        return (*self.people.warnings[row], *self.body_warnings.get(row, ()))

    def losses(self) -> list[float] | None:
        """Energies at the end, the sums of their terms; None without stages."""
        if not self.energy:
            return None
        return sum(values.astype(np.float64) for values in self.energy.values()).tolist()  # type: ignore[union-attr]
