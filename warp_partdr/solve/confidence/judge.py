"""Confidence in fits: the probability that a body is right, and of each limb whether it was seen or guessed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from ...body.parameters import BodyParameters
from ...inputs.observations import Observations, batch_observations
from ...networks.regression.uncertainty import Uncertainty
from ..ellipsoids.result import FitResult
from .limbs import LIMBS
from .measures import measure_bodies
from .model import packaged_model
from .sights import LIMB_LANDMARKS, SIGHTS, Sight, describe_guessed, limb_sights, limbs_outside, seen_limbs


@dataclass(frozen=True)
class LimbConfidence:
    """Confidence in a limb.

    Attributes:
        probability: Probability that its joints lie, on average, within 20 cm of the truth.
        sight: State of the limb: "seen"; "hidden", where no keypoint shows it; or "outside" the picture. A limb that is
            not seen is guessed.
    """

    probability: float
    sight: Sight


@dataclass(frozen=True)
class BodyConfidence:
    """Confidence in a fitted body.

    Attributes:
        probability: Probability that the body is right: its joints lie, on average, within 10 cm of the truth in depth,
            and within 10 cm across the picture, for a person of 1.7 m. Only joints that the picture shows count, after
            a move that brings their mean to the truth.
        limbs: Confidence in each limb, by its name: head, left arm, left leg, right arm, right leg.
    """

    probability: float
    limbs: Mapping[str, LimbConfidence]

    @property
    def guessed(self) -> tuple[str, ...]:
        """Names of the limbs that no keypoint shows."""
        return tuple(name for name, limb in self.limbs.items() if limb.sight != "seen")

    @property
    def warnings(self) -> tuple[str, ...]:
        """One sentence if the body is likely wrong, which says why and what to do; else none."""
        return low_confidence(self.probability, self.describe_guessed(), "overlay.png")

    def describe_guessed(self) -> str:
        """Words for the limbs that are guessed and why, such as "left arm hidden, guessed"; empty if all are seen."""
        return describe_guessed({name: limb.sight for name, limb in self.limbs.items()})


def low_confidence(probability: float, reason: str = "", drawn: str = "the body") -> tuple[str, ...]:
    """Warn of a body that is likely wrong: one sentence, or none if the probability is above the limit.

    Args:
        probability: Probability that the body is right.
        reason: Words for the limbs that are guessed; empty if all are seen.
        drawn: Name of what is to be compared with the picture.
    """
    least = packaged_model().least
    if probability >= least:
        return ()
    reason = f"{reason}; " if reason else ""
    return (
        f"body: confidence {probability:.2f}; expected {least:.2f} or more; {reason}compare {drawn} with the picture",
    )


def confidence_record(confidence: BodyConfidence) -> dict[str, Any]:
    """Numbers and words about a body for JSON."""
    limbs = confidence.limbs.items()
    return {
        "confidence": round(confidence.probability, 3),
        "limbs": {
            name.replace(" ", "_"): {"confidence": round(limb.probability, 3), "sight": limb.sight}
            for name, limb in limbs
        },
        "guessed": list(confidence.guessed),
    }


def judge_fits(fits: Sequence[FitResult], further: Sequence[Mapping[str, float]] | None = None) -> list[BodyConfidence]:
    """Judge fitted bodies.

    Args:
        fits: Fits of ellipsoids, or EllipBodies that were measured from a mesh (``MeshFit.ellipbody``).
        further: Measures of each person that the fit does not know, of ``detection_measures``.

    Returns:
        Confidence in each body.

    Example:
        >>> from warp_partdr import fit_body, read_keypoints
        >>> keypoints = read_keypoints("warp_partdr/assets/example/keypoints.json")[0]
        >>> (confidence,) = judge_fits([fit_body(keypoints)])
        >>> confidence.probability > 0.5
        True
    """
    measures = further or [{} for _ in fits]
    # In a batch, all people have the same measures. After a search, no network stated its uncertainty.
    groups: dict[tuple[bool, frozenset[str]], list[int]] = {}
    for row, fit in enumerate(fits):
        groups.setdefault((fit.uncertainty is None, frozenset(measures[row])), []).append(row)
    found: dict[int, BodyConfidence] = {}
    for (_, names), some in groups.items():
        for rows, batch in batch_observations([fits[row].observation for row in some]):
            own = [some[row] for row in rows]
            stated = [each for row in own if (each := fits[row].uncertainty) is not None]
            probabilities, limbs = judge_bodies(
                BodyParameters.joined([fits[row].parameters for row in own]),
                batch,
                Uncertainty.joined(stated) if stated else None,
                {name: np.array([measures[row][name] for row in own]) for name in names},
            )
            for row, probability, by_limb in zip(own, probabilities.tolist(), limbs.tolist(), strict=True):
                found[row] = _confidence(fits[row], probability, by_limb)
    return [found[row] for row in range(len(fits))]


def judge_bodies(
    bodies: BodyParameters,
    observations: Observations,
    uncertainty: Uncertainty | None,
    further: Mapping[str, np.ndarray] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Judge N bodies side by side.

    Args:
        bodies: N bodies in the crops of their people.
        observations: Keypoints and labels in these crops.
        uncertainty: Uncertainty that the label network stated; None after a search.
        further: Further measures by name, shape (N,) each.

    Returns:
        Probabilities that the bodies are right, shape (N,), and their limbs, shape (N, 5).
    """
    return packaged_model().judge(measure_bodies(bodies, observations, uncertainty), further or {})


def _confidence(fit: FitResult, probability: float, limbs: Sequence[float]) -> BodyConfidence:
    sights = _sights(fit)
    own = {limb.name: LimbConfidence(each, sight) for limb, each, sight in zip(LIMBS, limbs, sights, strict=True)}
    return BodyConfidence(probability, own)


def _sights(fit: FitResult) -> list[Sight]:
    """Tell of each limb whether it is seen, from the keypoints in the picture and the body."""
    keypoints, size = fit.evidence.keypoints, fit.evidence.image_size
    seen = seen_limbs(keypoints.format.landmarks, keypoints.confidence[None])
    outside = np.zeros_like(seen)
    if size is not None and not seen.all():
        points = torch.from_numpy(fit.landmarks(LIMB_LANDMARKS)).float()
        pixels = fit.camera.project(points[None].to(fit.camera.intrinsics))[..., :2].cpu().numpy()
        outside = limbs_outside(LIMB_LANDMARKS, pixels, size)
    return [SIGHTS[index] for index in limb_sights(seen, outside)[0].tolist()]
