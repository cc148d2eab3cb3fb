"""Person in a picture, with a body from which a fit of the mesh starts."""

from __future__ import annotations

from dataclasses import dataclass

from ...body.parameters import BodyParameters
from ...cameras import Crop
from ...inputs.evidence import Evidence
from ...inputs.observation import Observation
from ...inputs.scene import Sight
from ...networks.regression.uncertainty import Uncertainty
from ..ellipsoids.result import FitResult


@dataclass(frozen=True)
class ObservedBody:
    """Person in a picture, and the body from which a fit starts.

    Attributes:
        sight: Person, frame and view, with keypoints and labels as they were given.
        evidence: Keypoints and labels after they were weighed (``weigh_evidence``).
        observation: Keypoints and labels in the crop.
        crop: Position of the crop in the picture.
        body: Body from the network or from an earlier fit, as the crop's camera sees it, B = 1.
        uncertainty: Uncertainty of the network about the body; None: the body is not from a network.
    """

    sight: Sight
    evidence: Evidence
    observation: Observation
    crop: Crop
    body: BodyParameters
    uncertainty: Uncertainty | None

    @classmethod
    def of_fit(cls, result: FitResult, person: int = 0) -> ObservedBody:
        """Take the person and the body from a fit of ellipsoids.

        Args:
            result: Fit of ellipsoids. If it has an outline stage, the body is the one where that stage began.
            person: Index of the person.
        """
        evidence, body = result.evidence, result.before_outline or result.parameters
        sight = Sight(evidence.keypoints, evidence.picture, person)
        return cls(sight, evidence, result.observation, result.crop, body, result.uncertainty)
