"""People in pictures, each with a body from which a fit of the mesh starts."""

from __future__ import annotations

from dataclasses import dataclass

from ...body.parameters import BodyParameters
from ...cameras import Crop
from ...inputs.evidence import Evidence
from ...inputs.observation import Observation
from ...inputs.scene import SceneObservation
from ...networks.regression.uncertainty import Uncertainty
from ..ellipsoids.result import FitResult


@dataclass(frozen=True)
class ObservedBody:
    """Person in a picture, and the body from which a fit starts.

    Attributes:
        source: Keypoints and labels as they were given, with the person, frame and view that they belong to.
        evidence: Keypoints and labels that are believed.
        observation: Evidence in a crop around the person.
        crop: Square of the picture that the observation is cut from.
        body: Body from the network or from an earlier fit, as the crop's camera sees it, B = 1.
        uncertainty: Uncertainty of the network about the body. If it is None, no network predicted one.
    """

    source: SceneObservation
    evidence: Evidence
    observation: Observation
    crop: Crop
    body: BodyParameters
    uncertainty: Uncertainty | None

    @property
    def person(self) -> int:
        """Index of the person in the scene."""
        return self.source.person

    @property
    def frame(self) -> int:
        """Index of the frame in the scene."""
        return self.source.frame

    @property
    def view(self) -> int:
        """Index of the view in the scene."""
        return self.source.view

    @classmethod
    def of_fit(cls, result: FitResult, person: int = 0) -> ObservedBody:
        """Person of a fit of ellipsoids, from whose body a fit of the mesh starts."""
        evidence = result.evidence
        source = SceneObservation(evidence.keypoints, evidence.picture, person)
        return cls(source, evidence, result.observation, result.crop, result.parameters, result.uncertainty)
