"""Bodies before a known camera: its lens is focal length and principal point in the crop's coordinates, -1 to 1.

``log_scale`` and ``shift`` say how large and where the pelvis is seen, as they do in weak perspective.
"""

from __future__ import annotations

from dataclasses import replace

import torch

from ..cameras import Camera
from .parameters import BodyParameters
from .posing import Posed
from .rotations import rotation_to_6d


def place_bodies(
    parameters: BodyParameters, posed: Posed, lens: torch.Tensor | None, size: int
) -> tuple[Posed, Camera]:
    """Bodies where a crop's camera sees them, and that camera, for a crop of ``size`` pixels a side.

    Args:
        parameters: B bodies.
        posed: The same, the pelvis at the origin.
        lens: Shape (3,); None: the camera is of weak perspective, and bodies stay.
        size: [px].
    """
    camera = parameters.camera(size)
    if lens is None:
        return posed, camera
    lens = lens.to(camera.scale).expand(parameters.batch_size, 3)
    perspective, translation = camera.to_perspective(lens[:, 0] * size / 2, (lens[:, 1:] + 1) * size / 2)
    return posed.at(translation), perspective


def turn_to_rays(parameters: BodyParameters, lens: torch.Tensor) -> BodyParameters:
    """Bodies that a camera along its axis would see so, turned to the ray through their pelvis, shortest way."""
    turned = ray_rotations(parameters, lens) @ parameters.global_orient()
    return replace(parameters, orientation=rotation_to_6d(turned))


def ray_rotations(parameters: BodyParameters, lens: torch.Tensor) -> torch.Tensor:
    """Shortest rotations from the camera's axis to the rays through the pelvises, shape (B, 3, 3)."""
    lens = lens.to(parameters.shift)
    ray = torch.nn.functional.normalize(
        torch.cat([parameters.shift - lens[1:], lens[:1].expand(parameters.batch_size, 1)], dim=1), dim=1
    )
    x, y, z = ray.unbind(1)
    # R = I + [v] + [v]^2 / (1 + z) with v = (0, 0, 1) x ray; z is never negative.
    across = x * y / (1 + z)
    rows = (
        torch.stack([1 - x * x / (1 + z), -across, x], dim=1),
        torch.stack([-across, 1 - y * y / (1 + z), y], dim=1),
        torch.stack([-x, -y, z], dim=1),
    )
    return torch.stack(rows, dim=1)
