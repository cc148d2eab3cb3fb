"""Keypoints that lie far from the body that the label network sees count less.

Detectors sometimes take a thing for a limb, or another person's limb for this one's. The network learned from people
with such errors, and follows its idea of a body. A fit that pulls the body to all keypoints alike would undo this.
"""

from __future__ import annotations

from dataclasses import replace

from ...inputs.observation import REFERENCE_SIZE
from ...inputs.observations import Observations
from ...networks.regression.predicted import Predicted, landmarks_in_crop

# Of PartBench's first 40 people at the level "hard", 20 to 40 px give the same errors within 0.6 mm. Real people, of
# whom few keypoints are wrong, have the same errors with all of these and without (docs/evaluation.md).
GROSS_ERROR = 30.0  # [px of a crop of 256 px], about 15 cm of an adult; a keypoint this far off counts a quarter


def doubt_keypoints(observations: Observations, predicted: Predicted) -> Observations:
    """Returns the observations with lower confidence in keypoints that lie far from the predicted bodies.

    The factor is that of Geman and McClure's robust function, (1 + (distance / GROSS_ERROR)²)⁻².

    Args:
        observations: N people.
        predicted: What the label network says of them, N bodies.

    Reference:
        Geman and McClure, "Statistical methods for tomographic image reconstruction", 1987.
    """
    ways = landmarks_in_crop(predicted, observations.marks, observations.lens) - observations.points
    distances = ways.norm(dim=-1) * (REFERENCE_SIZE / 2)
    factors = (1 + (distances / GROSS_ERROR) ** 2) ** -2
    return replace(observations, confidence=observations.confidence * factors)
