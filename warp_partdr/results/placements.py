"""Placement of a photo's people before one camera, on one ground, with sizes that agree with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from ..cameras import Camera, Perspective, UsualLens, WeakPerspective
from ..inputs.keypoints import Keypoints2D
from ..solve.mesh.mesh_stage import MeshFit
from ..solve.scene.ground import STANDING_LANDMARKS, Standing, ankle_confidence, find_ground


@dataclass(frozen=True)
class Placement:
    """Position and size of a body in the scene of all people.

    Attributes:
        offset: Offset that is added to the body's points [m], shape (3,).
        scale: Factor by which the points are then scaled about the camera, so that all people stand on one ground.
        distance: Distance from the camera after scaling [m].
    """

    offset: np.ndarray
    scale: float
    distance: float

    def apply(self, points: np.ndarray) -> np.ndarray:
        """Move points (..., 3) of the body to the scene [m]."""
        return (points + self.offset) * self.scale


def place_on_ground(
    fits: Sequence[MeshFit], keypoints: Sequence[Keypoints2D], size: tuple[int, int]
) -> list[Placement]:
    """Place people on one ground before the camera of their picture; a single person stays as large as fitted.

    A camera of weak perspective has no distance, so a usual lens is assumed instead (``UsualLens``).

    Args:
        fits: Fits of the people.
        keypoints: Keypoints of the people. They show whose feet are visible.
        size: Size (H, W) of the picture [px].
    """
    offsets = [camera_offset(fit.camera, size) for fit in fits]
    sizes = np.zeros(len(fits))
    if len(fits) > 1:
        landmarks = [fit.landmarks(STANDING_LANDMARKS) + offset for fit, offset in zip(fits, offsets, strict=True)]
        visible = [ankle_confidence(each) for each in keypoints]
        bodies = Standing.of(np.array(landmarks, dtype=np.float64), np.array(visible), np.arange(len(fits)))
        sizes = find_ground(bodies, np.array([0.0, -1.0, 0.0])).sizes
    placements = []
    for fit, offset, scale in zip(fits, offsets, np.exp(sizes).tolist(), strict=True):
        depth = fit.ellipbody.posed.joints[0, 0, 2] if isinstance(fit.camera, Perspective) else offset[2]
        placements.append(Placement(offset, scale, float(depth) * scale))
    return placements


def camera_offset(camera: Camera, size: tuple[int, int]) -> np.ndarray:
    """Offset that brings a body before the camera of its picture of (H, W) pixels, shape (3,) [m]."""
    if isinstance(camera, Perspective):
        return np.zeros(3)
    offset: np.ndarray = with_usual_lens(camera, size)[1][0].detach().cpu().numpy()
    return offset


def with_usual_lens(camera: WeakPerspective, size: tuple[int, int]) -> tuple[Perspective, torch.Tensor]:
    """Perspective camera with a usual lens that sees the same, and the translation to it, shape (B, 3) [m]."""
    lens = UsualLens.of_size(size)
    return camera.to_perspective(lens.focal[:, 0].to(camera.scale), lens.centre.to(camera.scale))
