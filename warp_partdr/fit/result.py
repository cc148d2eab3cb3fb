"""The result of a fit: a body, its camera, and how it went."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..body.parameters import BodyParameters
from ..body.posing import LandmarkGather, Posed
from ..cameras import Crop, WeakPerspective
from ..inputs.evidence import Evidence
from ..inputs.observation import Observation
from ..interop.movable import Movable
from ..render.mesh import PartImage, rasterize_parts
from ..render.part_mesh import ellipbody_mesh
from ..render.subdivisions import DEFAULT_TOLERANCE, Subdivisions, coarsest_subdivisions
from .stages import Stage, Start


@dataclass(frozen=True)
class FitResult(Movable):
    """A fitted body.

    Attributes:
        parameters: The body and its camera in the crop, B = 1.
        crop: Where the crop lies in the picture.
        observation: What was fitted, in the crop.
        stages: The rounds it took.
        energy: Weighted terms of the energy at the end, by name.
        history: Energy of the winner's lineage before each iteration, one row a stage.
        stage_seconds: Wall time of each stage.
        hypotheses: How many starts there were.
        finalists: Energies at the end of the last stage that compared several bodies, best first.
        start: Where the winner comes from, "network" or "search".
        evidence: Keypoints and labels that it went by.
        warnings: What looks wrong, in the input or at the end, a sentence each.
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

    @property
    def camera(self) -> WeakPerspective:
        """The camera in pixels of the full picture."""
        return self.parameters.camera(self.crop.size[0]).in_full(self.crop)

    @property
    def posed(self) -> Posed:
        """The body in the camera frame, pelvis at the origin [m]."""
        return self.parameters.posed()

    def landmarks(self, names: Sequence[str]) -> np.ndarray:
        """Landmarks (see ``body.landmarks``) in the camera frame, shape (L, 3) [m]."""
        return LandmarkGather(names, self.parameters.shift.device)(self.posed)[0].cpu().numpy()

    def draw(
        self,
        image_size: tuple[int, int],
        *,
        subdivisions: Subdivisions = 3,
        tolerance: float = DEFAULT_TOLERANCE,
        camera: WeakPerspective | None = None,
    ) -> PartImage:
        """The body's 20 parts in the full picture, or in another camera's.

        Args:
            image_size: (H, W) [px].
            subdivisions: Level of the mesh, 0 to 3, or "auto": the coarsest that keeps the tolerance.
            tolerance: How far its silhouettes may be from the ellipsoids' [px].
            camera: Instead of the fit's.

        Raises:
            ValueError: If no level keeps the tolerance.
        """
        camera = camera or self.camera
        if subdivisions == "auto":
            subdivisions = coarsest_subdivisions(self.posed, camera, tolerance=tolerance)
        vertices = camera.project(self.posed.vertices(subdivisions))
        return rasterize_parts(vertices, ellipbody_mesh(subdivisions, device=vertices.device), image_size)
