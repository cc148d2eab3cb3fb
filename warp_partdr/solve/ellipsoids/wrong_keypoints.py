"""Lower confidence in keypoints that lie far from the body that the label network predicts.

Detectors sometimes take an object for a limb, or another person's limb for this person's. The network was trained with
these errors, and its bodies are plausible in spite of them. A fit that trusted all keypoints equally would undo this.
"""

from __future__ import annotations

from dataclasses import replace

from ...inputs.observation import REFERENCE_SIZE
from ...inputs.observations import Observations
from ...networks.regression.predicted import Predicted, landmarks_in_crop

# For PartBench's first 40 people at the level "hard", all values from 20 to 40 px give the same errors within 0.6 mm.
# Few keypoints of the real people are wrong; with any of these values, or without, their errors are the same
# (docs/measured/partbench.md).
GROSS_ERROR = 30.0  # [px of a crop of 256 px], about 15 cm of an adult; a keypoint this far off counts a quarter


def doubt_keypoints(observations: Observations, predicted: Predicted) -> Observations:
    """Return the observations with lower confidence in keypoints that lie far from the predicted bodies.

    The factor is that of Geman and McClure's robust function, (1 + (distance / GROSS_ERROR)²)⁻².

    Args:
        observations: Observations of N people.
        predicted: Prediction of the label network, N bodies.

    Reference:
        Geman and McClure, "Statistical methods for tomographic image reconstruction", 1987.
    """
    offsets = landmarks_in_crop(predicted, observations.marks, observations.lens) - observations.points
    distances = offsets.norm(dim=-1) * (REFERENCE_SIZE / 2)
    factors = (1 + (distances / GROSS_ERROR) ** 2) ** -2
    return replace(observations, confidence=observations.confidence * factors)
