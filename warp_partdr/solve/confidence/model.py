"""Model of confidence: logistic regressions from measures of bodies and limbs, learned by a script."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from typing import Any

import numpy as np

from .limbs import LIMBS
from .measures import BodyMeasures

FORMAT = "warp-partdr body confidence 1"


@dataclass(frozen=True)
class Logistic:
    """Probability from measures: 1 / (1 + exp(-(bias + sum of weights times measures)))."""

    measures: tuple[str, ...]
    weights: tuple[float, ...]
    bias: float

    def logits(self, columns: Mapping[str, np.ndarray]) -> np.ndarray:
        """Logarithms of the odds, of the columns' shape."""
        total = np.zeros_like(columns[self.measures[0]]) + self.bias
        for name, weight in zip(self.measures, self.weights, strict=True):
            total = total + weight * columns[name]
        return total


@dataclass(frozen=True)
class ConfidenceModel:
    """Learned model.

    Attributes:
        bodies: One regression for each set of measures that may be there, the largest set first.
        limbs: Regressions of each kind of limb, likewise.
        least: Confidence below which a body is warned of.
    """

    bodies: tuple[Logistic, ...]
    limbs: Mapping[str, tuple[Logistic, ...]]
    least: float

    def judge(self, measures: BodyMeasures, further: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Probabilities that bodies (N,) and their limbs (N, 5) are right, from the arguments of ``log_odds``."""
        bodies, limbs = self.log_odds(measures, further)
        return probabilities(bodies), probabilities(limbs)

    def log_odds(self, measures: BodyMeasures, further: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Logarithms of the odds that bodies (N,) and their limbs (N, 5) are right.

        Args:
            measures: Measures of N bodies.
            further: Measures by name that only some fits have, such as the detector's score, shape (N,) each.
        """
        logits = _logits(self.bodies, {**measures.columns(), **further})
        columns = measures.limb_columns() | {"body": np.repeat(logits[:, None], len(LIMBS), 1)}
        limbs = np.zeros_like(measures.limb_keypoints)
        for column, limb in enumerate(LIMBS):
            own = {name: values[:, column] for name, values in columns.items()}
            limbs[:, column] = _logits(self.limbs[limb.kind], own)
        return logits, limbs


def _logits(regressions: Sequence[Logistic], columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """Logarithms of the odds by the first regression whose measures are all there."""
    return next(each for each in regressions if columns.keys() >= set(each.measures)).logits(columns)


def probabilities(logits: np.ndarray) -> np.ndarray:
    """Probabilities from logarithms of odds, of the same shape."""
    found: np.ndarray = 1 / (1 + np.exp(-logits))
    return found


def read_confidence_model(text: str) -> ConfidenceModel:
    """Read a model that ``scripts/learn_confidence.py`` wrote.

    Raises:
        ValueError: If it is of another format.
    """
    content: dict[str, Any] = json.loads(text)
    if content["format"] != FORMAT:
        raise ValueError(f"format: {content['format']!r}; expected {FORMAT!r}")
    return ConfidenceModel(
        _logistics(content["bodies"]),
        {kind: _logistics(rows) for kind, rows in content["limbs"].items()},
        content["least"],
    )


def _logistics(rows: Sequence[Mapping[str, Any]]) -> tuple[Logistic, ...]:
    return tuple(Logistic(tuple(row["measures"]), tuple(row["weights"]), row["bias"]) for row in rows)


@lru_cache(maxsize=1)
def packaged_model() -> ConfidenceModel:
    """Packaged model; docs/measured/confidence.md says how it was learned and measured."""
    path = resources.files("warp_partdr").joinpath("assets", "body_confidence.json")
    return read_confidence_model(path.read_text("utf-8"))
