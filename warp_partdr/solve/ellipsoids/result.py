"""Result of a fit: a body, its camera, its energies and warnings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...body.lens import find_camera, place_bodies
from ...body.parameters import BodyParameters
from ...body.posing import LandmarkGather, Posed
from ...cameras import Camera, Crop
from ...inputs.evidence import Evidence
from ...inputs.observation import Observation
from ...interop.movable import Movable
from ...networks.regression.uncertainty import Uncertainty
from ...render.ellipsoids import EllipsoidImage
from ...render.mesh import PartImage
from ...render.renderers import Renderer, RendererMesh
from .depth_flips import DepthOrder
from .stages import Stage, Start

_FINE_MESH = RendererMesh(3)


@dataclass(frozen=True)
class FitResult(Movable):
    """A fitted body.

    Attributes:
        parameters: The body and its camera in the crop, B = 1.
        crop: Place of the crop in the picture.
        observation: Keypoints and labels in the crop.
        stages: Stages of the fit.
        energy: Weighted terms of the energy at the end, by name.
        history: Energy of the winner's lineage before each iteration, one row a stage.
        stage_seconds: Wall time of each stage.
        hypotheses: Number of starts.
        finalists: Energies at the end of the last stage that compared several bodies, best first.
        start: Start of the winner, "network" or "search".
        evidence: Keypoints and labels in the picture.
        warnings: Faults of the input or the body, a sentence each.
        depth_order: Limbs that were tried mirrored in depth; None of a search, or without labels.
        uncertainty: Uncertainty of the network about its body, before any stage; None after a search.
        stature: The person's height that was given [m], which the body has; None: sizes are guessed.

    Examples:
        After ``result = fit_body(person, parts)``:

        >>> from warp_partdr import FitResult
        >>> isinstance(result, FitResult), result.start, result.warnings
        (True, 'network', ())
        >>> result.parameters.lengths.shape
        torch.Size([1, 12])
        >>> result.camera.project(result.posed.joints).shape  # u [px], v [px], z [m] of 21 joints
        torch.Size([1, 21, 3])
    """

    parameters: BodyParameters
    crop: Crop
    observation: Observation
    stages: tuple[Stage, ...]
    energy: dict[str, float]
    history: list[np.ndarray]
    stage_seconds: dict[str, float]
    hypotheses: int
    finalists: list[float]
    start: Start
    evidence: Evidence
    warnings: tuple[str, ...] = ()
    depth_order: DepthOrder | None = None
    uncertainty: Uncertainty | None = None
    stature: float | None = None

    @property
    def camera(self) -> Camera:
        """The camera in pixels of the full picture: perspective if it was given or assumed, else weak perspective."""
        return find_camera(self.parameters, self.observation.lens, self.crop.size[0])[0].in_full(self.crop)

    @property
    def camera_guessed(self) -> bool:
        """True if the camera is not known, and a lens is assumed: a usual one (``UsualLens``), or a longer one."""
        return self.observation.lens_assumed

    @property
    def posed(self) -> Posed:
        """The body in the camera frame [m]; with weak perspective, which knows no distance, pelvis at the origin."""
        return place_bodies(self.parameters, self.parameters.posed(), self.observation.lens, self.crop.size[0])[0]

    def landmarks(self, names: Sequence[str]) -> np.ndarray:
        """Landmarks (see ``body.landmarks``) in the camera frame, shape (L, 3) [m].

        Examples:
            After ``result = fit_body(person, parts)``:

            >>> result.landmarks(["nose", "left_wrist"]).shape
            (2, 3)
        """
        return LandmarkGather(names, self.parameters.shift.device)(self.posed)[0].cpu().numpy()

    def draw(
        self,
        image_size: tuple[int, int],
        *,
        renderer: Renderer = _FINE_MESH,
        camera: Camera | None = None,
    ) -> PartImage | EllipsoidImage:
        """Draw the body's 20 parts in the full picture, or in another camera's.

        Args:
            image_size: Height and width (H, W) of the picture [px].
            renderer: Exact ellipsoids or a mesh, E3 by default.
            camera: Instead of the fit's.

        Raises:
            ValueError: If no level keeps the tolerance of a mesh whose level is "auto".

        Examples:
            After ``result = fit_body(person, parts)``:

            >>> result.draw((512, 384)).labels.shape
            torch.Size([1, 512, 384])
        """
        return renderer.draw(self.posed, camera or self.camera, image_size)
