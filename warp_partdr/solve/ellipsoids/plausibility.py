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

JUDGED_SIZE = 128  # [px], side of the crop in which bodies are compared with labels in the end
# PartBench's hard people 60 to 119 end at 18, 0.31 and 0.37 at the worst, the first 20 at 22 px (default fit).
MOST_OFF = 25.0  # [px of a 256 px crop], mean distance of keypoints along both axes
MOST_WRONG = 0.4  # wrong pixels a pixel of the person
LEAST_PART_F1 = 0.35  # in the label set's own parts

# Of the energy of a fit of quality "fast" [its unit]: a face that is surely seen while the head turns its back on the
# camera. With 13 to 40, all of 98 fits chose rightly (PartBench's people 60 to 104, the packaged example, three photos,
# which were looked at for this), with 0 to 10 all but two.
_HIDDEN_FACE = 20.0
_FACE = ("nose", "left_eye", "right_eye")
_EARS = ("left_ear", "right_ear")


def far_bodies(
    bodies: BodyParameters, observations: Observations, prior: PosePrior, form: Skeleton
) -> dict[int, list[str]]:
    """Find the bodies that are too far from keypoints or labels.

    Args:
        bodies: N bodies, one of each person.
        observations: N people.
        prior: Prior of poses.
        form: Format of the keypoints.

    Returns:
        Warnings of the bodies that are too far, by their rows; no other rows.
    """
    energy = Energy(observations, JUDGED_SIZE, prior=prior)
    terms = refine_unchecked(bodies, energy, Descent(iterations=0)).terms
    offs = terms["proj"] / energy.weights.proj / energy.votes.sum(1)
    bad, wrongs = ~(offs < MOST_OFF), None
    if energy.target is not None:
        wrongs = terms[SEG.name] / energy.weight(SEG) / (2 * person_pixels(energy.target))
        bad |= ~(wrongs < MOST_WRONG)
    rows = bad.nonzero()[:, 0]
    shares = [None] * len(rows) if wrongs is None else wrongs[rows].tolist()
    named = zip(rows.tolist(), offs[rows].tolist(), shares, strict=True)
    return {row: describe_misfit(off, wrong, form) for row, off, wrong in named}


def person_pixels(target: torch.Tensor) -> torch.Tensor:
    """Pixels of label images (..., N, N) that show the person, 1 at least, shape (...)."""
    return ((target != BACKGROUND) & (target != IGNORE)).sum((-2, -1)).clamp_min(1)


def describe_misfit(off: float, wrong: float | None, form: Skeleton) -> list[str]:
    """Warnings of a body whose keypoints are ``off`` on average [px], and of ``wrong`` pixels a pixel of the person.

    ``form`` is the keypoints' format, which may be another of as many points.
    """
    told = []
    if not off < MOST_OFF:
        ends = f"the body ends {off:.0f} px of {REFERENCE_SIZE} from them; expected at most {MOST_OFF:g}"
        question = order_question(form)
        told.append(f"keypoints: {ends}" if question is None else f"keypoints: {ends}; {question}")
    if wrong is not None and not wrong < MOST_WRONG:
        told.append(f"labels: {wrong:.2f} wrong pixels for each of the person's; expected at most {MOST_WRONG:g}")
    return told


def find_poor_labels(bodies: BodyParameters, observations: Observations) -> dict[int, list[str]]:
    """Warnings of the bodies whose parts lie elsewhere than the labels, by their rows, of N people."""
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
    """Energy of a fit, plus a penalty for a face that is seen through the back of the head.

    Seen in weak perspective, a person and the mirror image behind the picture's plane look the same but for what hides
    what, and for the face.
    """
    keypoints = result.evidence.keypoints
    points = result.landmarks((*_FACE, *_EARS))
    forward = points[0] - points[len(_FACE) :].mean(axis=0)
    away = max(float(forward[2] / np.linalg.norm(forward)), 0.0)
    confidence = dict(zip(keypoints.format.landmarks, keypoints.confidence, strict=True))
    # Formats with visibilities give 0.5 to what is guessed.
    seen = np.mean([max(2.0 * float(confidence.get(name, 0.0)) - 1.0, 0.0) for name in _FACE])
    return sum(result.energy.values()) + _HIDDEN_FACE * away * float(seen)
