"""Places of the people of a photo: one camera, one ground, and sizes that agree with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..cameras import Camera, Perspective, UsualLens
from ..inputs.keypoints import Keypoints2D
from ..solve.mesh.mesh_stage import MeshFit
from ..solve.scene.ground import STANDING_LANDMARKS, Standing, ankle_confidence, find_ground


@dataclass(frozen=True)
class ScenePlace:
    """Place of a body in a scene of all.

    Attributes:
        offset: To be added to the body's points [m], shape (3,).
        scale: By which they grow about the camera afterwards, so that all stand on one ground.
        distance: From the camera, grown [m].
    """

    offset: np.ndarray
    scale: float
    distance: float

    def of(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3) of the body in the scene [m]."""
        return (points + self.offset) * self.scale


def place_on_ground(
    fits: Sequence[MeshFit], keypoints: Sequence[Keypoints2D], size: tuple[int, int]
) -> list[ScenePlace]:
    """Places of people of a picture of (H, W) pixels; of somebody alone, as far as the size says.

    Before a camera of weak perspective, which knows no distance, a usual lens is assumed (``UsualLens``).
    """
    offsets = [_offset(fit, size) for fit in fits]
    sizes = np.zeros(len(fits))
    if len(fits) > 1:
        marked = [fit.landmarks(STANDING_LANDMARKS) + move for fit, move in zip(fits, offsets, strict=True)]
        seen = [ankle_confidence(each) for each in keypoints]
        bodies = Standing.of(np.array(marked, dtype=np.float64), np.array(seen), np.arange(len(fits)))
        sizes = find_ground(bodies, np.array([0.0, -1.0, 0.0])).sizes
    places = []
    for fit, offset, scale in zip(fits, offsets, np.exp(sizes).tolist(), strict=True):
        away = fit.ellipbody.posed.joints[0, 0, 2] if isinstance(fit.camera, Perspective) else offset[2]
        places.append(ScenePlace(offset, scale, float(away) * scale))
    return places


def _offset(fit: MeshFit, size: tuple[int, int]) -> np.ndarray:
    """Offset that brings a body before its camera, shape (3,) [m]."""
    camera: Camera = fit.camera
    if isinstance(camera, Perspective):
        return np.zeros(3)
    lens = UsualLens.of_size(size)
    focal, centre = (values.to(camera.scale) for values in (lens.focal[:, 0], lens.centre))
    offset: np.ndarray = camera.to_perspective(focal, centre)[1][0].detach().cpu().numpy()
    return offset
