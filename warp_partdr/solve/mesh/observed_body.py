"""People in pictures, each with a body from which a fit of the mesh starts."""

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
        sight: Who is seen when and from where, with keypoints and labels as they were given.
        evidence: What is believed of them.
        observation: The same in a crop.
        crop: The crop.
        body: Body of the network or of an earlier fit, as the crop's camera sees it, B = 1.
        uncertainty: How sure the network was of it; None: no network said so.
    """

    sight: Sight
    evidence: Evidence
    observation: Observation
    crop: Crop
    body: BodyParameters
    uncertainty: Uncertainty | None

    @classmethod
    def of_fit(cls, result: FitResult, person: int = 0) -> ObservedBody:
        """Person of a fit of ellipsoids; a fit of the mesh goes on from where its outline stage began."""
        evidence, body = result.evidence, result.before_outline or result.parameters
        sight = Sight(evidence.keypoints, evidence.picture, person)
        return cls(sight, evidence, result.observation, result.crop, body, result.uncertainty)
