"""Plausibility of a fitted body: its distance from keypoints and labels, and the side that its face is on."""

from __future__ import annotations

import numpy as np
import torch

from ... import metrics
from ...body.labels import BACKGROUND, IGNORE
from ...body.lens import place_bodies
from ...body.parameters import BodyParameters
from ...body.pose_prior import PosePrior
from ...body.skeletons import Skeleton
from ...inputs.keypoint_order import order_question
from ...inputs.observation import REFERENCE_SIZE, resize_nearest
from ...inputs.observations import Observations
from ...render.ellipsoids import draw_ellipsoids
from .energy import SEG, Energy
from .refine import refine_unchecked
from .result import FitResult
from .stepper import Descent

JUDGED_SIZE = 128  # side of the crop in which final bodies are compared with labels [px]
# PartBench's hard people 60 to 119 end at 18 px, 0.31 and 0.37 at the worst. The first 20 end at 22 px at the worst.
# Both were fitted with the default options.
MOST_OFF = 25.0  # mean distance from keypoints along both axes [px of a crop of 256 px]
MOST_WRONG = 0.4  # number of wrong pixels for each pixel of the person
LEAST_PART_F1 = 0.35  # mean over the parts of the label set

# Penalty for a face that is surely visible while the head is turned away from the camera. It is added to the energy of
# a fit of quality "fast". With 13 to 40, all of 98 fits chose the right evidence: PartBench's people 60 to 104, the
# packaged example, and three photos, which were checked by eye. With 0 to 10, all but two did.
_HIDDEN_FACE = 20.0
_FACE = ("nose", "left_eye", "right_eye")
_EARS = ("left_ear", "right_ear")


def far_bodies(
    bodies: BodyParameters, observations: Observations, prior: PosePrior, form: Skeleton
) -> dict[int, list[str]]:
    """Find the bodies that are too far from keypoints or labels.

    Args:
        bodies: N bodies, one of each person.
        observations: Observations of the N people.
        prior: Prior of poses.
        form: Format of the keypoints.

    Returns:
        Warnings about the bodies that are too far, by their row. Other bodies have no entry.
    """
    energy = Energy(observations, JUDGED_SIZE, prior=prior)
    terms = refine_unchecked(bodies, energy, Descent(iterations=0)).terms
    distances = terms["proj"] / energy.weights.proj / energy.landmark_weights.sum(1)
    far = ~(distances < MOST_OFF)
    wrong_shares = None
    if energy.target is not None:
        wrong_shares = terms[SEG.name] / energy.weight(SEG) / (2 * person_pixels(energy.target))
        far |= ~(wrong_shares < MOST_WRONG)
    rows = far.nonzero()[:, 0]
    shares = [None] * len(rows) if wrong_shares is None else wrong_shares[rows].tolist()
    figures = zip(rows.tolist(), distances[rows].tolist(), shares, strict=True)
    return {row: distance_warnings(distance, share, form) for row, distance, share in figures}


def person_pixels(target: torch.Tensor) -> torch.Tensor:
    """Number of pixels of label images (..., N, N) that show the person, at least 1, shape (...)."""
    return ((target != BACKGROUND) & (target != IGNORE)).sum((-2, -1)).clamp_min(1)


def distance_warnings(distance: float, wrong_share: float | None, form: Skeleton) -> list[str]:
    """Write the warnings about one body that may be too far from keypoints or labels.

    Args:
        distance: Mean distance of the body from keypoints, along both axes [px of a crop of 256 px].
        wrong_share: Number of wrong pixels for each pixel of the person; None: there are no labels.
        form: Format of the keypoints. The warning asks if they have another format with as many keypoints.
    """
    warnings = []
    if not distance < MOST_OFF:
        ends = f"the body ends {distance:.0f} px of {REFERENCE_SIZE} from them; expected at most {MOST_OFF:g}"
        question = order_question(form)
        warnings.append(f"keypoints: {ends}" if question is None else f"keypoints: {ends}; {question}")
    if wrong_share is not None and not wrong_share < MOST_WRONG:
        wrong = f"{wrong_share:.2f} wrong pixels for each of the person's"
        warnings.append(f"labels: {wrong}; expected at most {MOST_WRONG:g}")
    return warnings


def find_poor_labels(bodies: BodyParameters, observations: Observations) -> dict[int, list[str]]:
    """Find the bodies of N people whose parts lie elsewhere than the labels; return their warnings by row."""
    if observations.labels is None or observations.label_set is None:
        return {}
    placed = place_bodies(bodies, bodies.posed(), observations.lens, JUDGED_SIZE)
    parts = draw_ellipsoids(*placed, (JUDGED_SIZE, JUDGED_SIZE)).parts
    groups = torch.from_numpy(observations.label_set.part_groups).to(parts.device)
    target = resize_nearest(observations.labels, JUDGED_SIZE)
    scores = metrics.part_f1(metrics.confusion(groups[parts.long()], target, observations.label_set.num_groups + 1))
    expected = f"expected {LEAST_PART_F1:g} or more; are these ids of {observations.label_set.name}?"
    return {
        int(row): [f"labels: part F1 {scores[row]:.2f}; {expected}"] for row in np.flatnonzero(scores < LEAST_PART_F1)
    }


def implausibility(result: FitResult) -> float:
    """Energy of a fit, plus a penalty for a visible face while the head is turned away from the camera.

    In weak perspective, a person and the mirror image in depth look the same. Only the order of overlapping parts and
    the face tell them apart.
    """
    keypoints = result.evidence.keypoints
    points = result.landmarks((*_FACE, *_EARS))
    forward = points[0] - points[len(_FACE) :].mean(axis=0)
    away = max(float(forward[2] / np.linalg.norm(forward)), 0.0)
    confidence = dict(zip(keypoints.format.landmarks, keypoints.confidence, strict=True))
    # Formats with visibilities give a confidence of 0.5 to keypoints that are guessed.
    visible = np.mean([max(2.0 * float(confidence.get(name, 0.0)) - 1.0, 0.0) for name in _FACE])
    return sum(result.energy.values()) + _HIDDEN_FACE * away * float(visible)
