"""Measures that separate right bodies from wrong ones: the network's uncertainty, and how well keypoints agree.

How well the drawn body covers the labels adds nothing to them, and a person's height alone would warn of children.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from ...body.lens import place_bodies
from ...body.parameters import BodyParameters
from ...body.posing import LandmarkGather
from ...body.skeletons import BODY_LANDMARKS
from ...body.template import JOINT_NAMES
from ...inputs.observations import Observations
from ...networks.detection.person import FoundPerson
from ...networks.regression.uncertainty import Uncertainty
from .limbs import LIMBS, limb_columns, mean_over

_LEAST = 1e-4  # of what is a logarithm, so that it stays finite


@dataclass(frozen=True)
class BodyMeasures:
    """Measures of N bodies.

    Attributes:
        seen: Mean confidence in the keypoints of shoulders, elbows, wrists, hips, knees and ankles, shape (N,).
        depths: Uncertainty of the depths of these joints that the label network stated, mean weighted by the
            confidence in their keypoints [m], shape (N,); None without a network.
        keypoints: Distance of these joints from their keypoints, mean weighted likewise, as a share of the crop's side,
            shape (N,).
        limb_depths: Uncertainty of depths of each limb of ``LIMBS`` [m], shape (N, 5); None without a network.
        limb_keypoints: Least confidence in a keypoint of each limb, 0 where the format has none, shape (N, 5).
    """

    seen: np.ndarray
    depths: np.ndarray | None
    keypoints: np.ndarray
    limb_depths: np.ndarray | None
    limb_keypoints: np.ndarray

    def columns(self) -> dict[str, np.ndarray]:
        """Measures of bodies by name, on the scales that the model of confidence takes them, shape (N,) each."""
        found = {"seen": self.seen, "keypoints": _log(self.keypoints)}
        if self.depths is not None:
            found["depths"] = _log(self.depths)
        return found

    def limb_columns(self) -> dict[str, np.ndarray]:
        """Measures of limbs likewise, shape (N, 5) each."""
        found = {"keypoints": self.limb_keypoints}
        return found if self.limb_depths is None else found | {"depths": _log(self.limb_depths)}


@torch.no_grad()
def measure_bodies(bodies: BodyParameters, observations: Observations, uncertainty: Uncertainty | None) -> BodyMeasures:
    """Measure bodies of N people.

    Args:
        bodies: N bodies in the crops of their people.
        observations: Keypoints and labels in these crops.
        uncertainty: Uncertainty that the label network stated about its bodies, from which the fits started; None after
            a search.
    """
    posed, camera = place_bodies(bodies, bodies.posed(), observations.lens, 2)
    points = camera.project(LandmarkGather(observations.marks, posed.joints.device)(posed))[..., :2] - 1
    return measure_points(points[:, body_rows(observations.landmarks)], observations, uncertainty)


@torch.no_grad()
def measure_points(points: torch.Tensor, observations: Observations, uncertainty: Uncertainty | None) -> BodyMeasures:
    """Measure bodies of N people by their joints alone, such as those of meshes.

    Args:
        points: Joints of the bodies at ``body_rows`` of the observations, in the crops of side 2, shape (N, M, 2).
        observations: Keypoints in these crops.
        uncertainty: Uncertainty as for ``measure_bodies``.
    """
    rows = body_rows(observations.landmarks)
    names = [observations.landmarks[row] for row in rows]
    confidence = observations.confidence
    distances = (points - observations.points[:, rows]).norm(dim=-1) / 2
    weights = confidence[:, rows] + _LEAST  # where nothing is seen, all count alike
    limbs = [limb.rows(observations.landmarks) for limb in LIMBS]
    least = [confidence[:, own].amin(1) if own else torch.zeros_like(confidence[:, 0]) for own in limbs]
    depths = limb_depths = None
    if uncertainty is not None:
        own_depths = uncertainty.depths[:, [JOINT_NAMES.index(name) - 1 for name in names]]
        depths = _numbers((own_depths * weights).sum(1) / weights.sum(1))
        limb_depths = _numbers(mean_over(uncertainty.depths, limb_columns()))
    return BodyMeasures(
        seen=_numbers(confidence[:, rows].mean(1)),
        depths=depths,
        keypoints=_numbers((distances * weights).sum(1) / weights.sum(1)),
        limb_depths=limb_depths,
        limb_keypoints=_numbers(torch.stack(least, dim=1)),
    )


def body_rows(landmarks: Sequence[str]) -> list[int]:
    """Rows of the joints of trunk and limbs (``BODY_LANDMARKS``) that are among the landmarks of a format."""
    return [landmarks.index(name) for name in BODY_LANDMARKS if name in landmarks]


def detection_measures(person: FoundPerson) -> dict[str, float]:
    """Measures of a person who was found in a picture, by name, on the scales that the model takes them."""
    measures = {"score": person.score}
    if person.mirror_distance is not None:
        measures["mirror"] = math.log(max(person.mirror_distance, _LEAST))
    return measures


def _numbers(values: torch.Tensor) -> np.ndarray:
    found: np.ndarray = values.double().cpu().numpy()
    return found


def _log(values: np.ndarray) -> np.ndarray:
    found: np.ndarray = np.log(np.maximum(values, _LEAST))
    return found
