"""Learning rate and phase of each step."""

from __future__ import annotations

import math

from .config import Phase, TrainingConfig


def phase_at(config: TrainingConfig, share: float) -> Phase:
    """The phase that holds after ``share`` of the run, 0 to 1."""
    return next((phase for phase in config.phases if share < phase.until), config.phases[-1])


def learning_rate(config: TrainingConfig, phase: Phase, step: int, share: float) -> float:
    """Learning rate of a step.

    Args:
        config: Of the run.
        phase: In which the step is.
        step: How many steps are over.
        share: How much of the run is over, 0 to 1.
    """
    peak = config.learning_rate if phase.learning_rate is None else phase.learning_rate
    rise = min(1.0, (step + 1) / config.warm_up) if config.warm_up else 1.0
    if config.schedule == "constant":
        return peak * rise
    return peak * rise * (config.floor + (1 - config.floor) * 0.5 * (1 + math.cos(math.pi * min(share, 1.0))))
