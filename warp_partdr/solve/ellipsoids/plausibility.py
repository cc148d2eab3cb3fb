"""Plausibility of a fitted body: its distance from keypoints and labels, and the side that its face is on."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch

from ... import metrics
from ...body.labels import BACKGROUND, IGNORE
from ...body.parameters import BodyParameters
from ...body.skeletons import Skeleton
from ...inputs.evidence import Evidence
from ...inputs.keypoint_order import order_question
from ...inputs.observation import REFERENCE_SIZE
from ...render.ellipsoids import draw_ellipsoids
from .energy import Energy
from .result import FitResult

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


def complaints(parameters: BodyParameters, energy: Energy, form: Skeleton) -> list[str]:
    """Warnings of what one body is too far from; none if it lies where keypoints and labels are.

    ``form`` is the keypoints' format.
    """
    posed = parameters.posed()
    off = float(energy.reprojection(parameters, posed) / energy.votes.sum())
    wrong = None
    if energy.target is not None:
        wrong = float(energy.segmentation(parameters, posed) / (2 * person_pixels(energy.target)))
    return describe_misfit(off, wrong, form)


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


def poor_labels(parameters: BodyParameters, energy: Energy) -> list[str]:
    """Warning if one body's parts lie elsewhere than the labels."""
    label_set = energy.observation.label_set
    if energy.target is None or label_set is None:
        return []
    placed = energy.place(parameters, parameters.posed(), energy.size)
    parts = draw_ellipsoids(*placed, (energy.size, energy.size)).parts[0]
    shown = label_set.part_groups[parts.cpu().numpy()]
    counts = metrics.confusion(shown, energy.target.cpu().numpy(), label_set.num_groups + 1)
    score = metrics.part_f1(counts)
    if np.isnan(score) or score >= LEAST_PART_F1:
        return []
    return [f"labels: part F1 {score:.2f}; expected {LEAST_PART_F1:g} or more; are these ids of {label_set.name}?"]


def choose_sides(readings: Sequence[Evidence], fit: Callable[[Evidence], FitResult]) -> Evidence:
    """Choose the most plausible of several readings of one person.

    Seen in weak perspective, a person and the mirror image behind the picture's plane look the same but for what hides
    what, and for the face. So both readings are fitted, quickly, by ``fit``.
    """
    if len(readings) == 1:
        return readings[0]
    return min(readings, key=lambda reading: implausibility(reading, fit(reading)))


def implausibility(reading: Evidence, result: FitResult) -> float:
    """Energy plus a penalty for a face that is seen through the back of the head."""
    points = result.landmarks((*_FACE, *_EARS))
    forward = points[0] - points[len(_FACE) :].mean(axis=0)
    away = max(float(forward[2] / np.linalg.norm(forward)), 0.0)
    confidence = dict(zip(reading.keypoints.format.landmarks, reading.keypoints.confidence, strict=True))
    # Formats with visibilities give 0.5 to what is guessed.
    seen = np.mean([max(2.0 * float(confidence.get(name, 0.0)) - 1.0, 0.0) for name in _FACE])
    return sum(result.energy.values()) + _HIDDEN_FACE * away * float(seen)
