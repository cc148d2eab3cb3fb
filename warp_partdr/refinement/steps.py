"""Learning rates, bounds of sizes and result of a refinement, shared by its two implementations."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch

from ..body.parameters import BodyParameters
from ..interop.movable import Movable

LEARNING_RATE = 1e-2  # the paper's
FINAL_RATE = 0.1  # share of the learning rate at the last step
SHAPE_RATE = 0.3  # lengths and thicknesses in metres move this much slower than angles in radians
# Shares of the mean adult's sizes that a body keeps within. A torso's depth can't be seen from the front, and would
# take any value that fills a gap in the labels.
SIZES = {"lengths": (0.6, 1.4), "thicknesses": (0.4, 1.6)}


@dataclass(frozen=True)
class Refined(Movable):
    """Result of a refinement.

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


def rate_share(step: int, iterations: int) -> float:
    """Share of the learning rate at a step: from 1 to ``FINAL_RATE`` along a cosine, then constant."""
    course = min(step, iterations) / max(iterations, 1)
    return FINAL_RATE + (1 - FINAL_RATE) * (1 + math.cos(math.pi * course)) / 2


def size_bounds(name: str, device: torch.device | str) -> tuple[torch.Tensor, torch.Tensor]:
    """Smallest and largest "lengths" or "thicknesses" [m], shape (1, 12) or (1, 15) each."""
    low, high = SIZES[name]
    mean = BodyParameters.mean(1, device=device).tensors()[name]
    return low * mean, high * mean
