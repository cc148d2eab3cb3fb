"""Bodies before a known camera: its lens is focal length and principal point in the crop's coordinates, -1 to 1.

``log_scale`` and ``shift`` say how large and where the pelvis is seen, as they do in weak perspective.
"""

from __future__ import annotations

from dataclasses import replace

import torch

from ..cameras import Camera, Perspective, WeakPerspective
from ..interop.captured_call import call_as_graph
from .parameters import BodyParameters
from .posing import Posed
from .rotations import rotation_between, rotation_from_6d, rotation_to_6d


def place_bodies(
    parameters: BodyParameters, posed: Posed, lens: torch.Tensor | None, size: int
) -> tuple[Posed, Camera]:
    """Bodies where a crop's camera sees them, and that camera, for a crop of ``size`` pixels a side.

    Args:
        parameters: B bodies.
        posed: These bodies, posed with the pelvis at the origin.
        lens: Focal length and principal point in the crop's coordinates, shape (3,), or (B, 3) with one for each body.
            If it is None, the camera is of weak perspective, and bodies stay.
        size: Side of the crop [px].
    """
    camera, pelvises = find_camera(parameters, lens, size)
    return posed if pelvises is None else posed.at(pelvises), camera


def find_camera(parameters: BodyParameters, lens: torch.Tensor | None, size: int) -> tuple[Camera, torch.Tensor | None]:
    """The camera of ``place_bodies``, and where the pelvises are before it, shape (B, 3) [m]; None: at the origin."""
    return through_lens(parameters.camera(size), lens, size)


def through_lens(camera: WeakPerspective, lens: torch.Tensor | None, size: int) -> tuple[Camera, torch.Tensor | None]:
    """Camera and pelvises as ``find_camera`` returns them, for weak-perspective cameras of a crop.

    ``lens`` has shape (3,), or (B, 3) for one a body.
    """
    if lens is None:
        return camera, None
    seen = lens_camera(lens.to(camera.scale).expand(len(camera.scale), 3), size)
    return camera.to_perspective(seen.focal[:, 0], seen.centre)


def lens_camera(lens: torch.Tensor, size: int) -> Perspective:
    """Cameras of crops of ``size`` pixels a side, from their lenses, shape (B, 3)."""
    return Perspective(lens[:, :1].expand(-1, 2) * size / 2, (lens[:, 1:] + 1) * size / 2)


def move_pelvises(parameters: BodyParameters, lens: torch.Tensor | None, moves: torch.Tensor) -> BodyParameters:
    """Bodies whose pelvises are seen where they are after these moves, (B, 3) [m]; their sizes [m] stay.

    ``lens`` may be one a body, (B, 3). With weak perspective, which knows no distance, moves along the view change
    nothing.
    """
    if lens is None:
        return replace(parameters, shift=parameters.shift + parameters.log_scale.exp()[:, None] * moves[:, :2])
    lens = lens.to(moves).expand(len(moves), 3)
    log_scale, shift = seen_at(placed_at(parameters.log_scale, parameters.shift, lens) + moves, lens)
    return replace(parameters, log_scale=log_scale, shift=shift)


def seen_at(pelvises: torch.Tensor, lens: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """``log_scale`` (B,) and ``shift`` (B, 2) of pelvises before the camera, (B, 3) [m], by lenses (B, 3)."""
    focal, middle = lens[:, :1], lens[:, 1:]
    log_scale = (focal / pelvises[:, 2:])[:, 0].log()
    return log_scale, middle + focal * pelvises[:, :2] / pelvises[:, 2:]


def placed_at(log_scale: torch.Tensor, shift: torch.Tensor, lens: torch.Tensor) -> torch.Tensor:
    """Pelvises before the camera, (B, 3) [m]: the inverse of ``seen_at``."""
    return _rays(shift, lens) / log_scale.exp()[:, None]


def _rays(shift: torch.Tensor, lens: torch.Tensor) -> torch.Tensor:
    """Rays from the camera to where the pelvises are seen, in half-sides of the crop, shape (B, 3)."""
    return torch.cat([shift - lens[:, 1:], lens[:, :1]], dim=1)


def turn_to_rays(parameters: BodyParameters, lens: torch.Tensor) -> BodyParameters:
    """Bodies that a camera along its axis would see so, turned to the ray through their pelvis, shortest way."""
    lens = lens.to(parameters.shift).expand(parameters.batch_size, 3)
    (orientation,) = call_as_graph(_turned_orientation, (parameters.orientation, _rays(parameters.shift, lens)))
    return replace(parameters, orientation=orientation)


def _turned_orientation(orientation: torch.Tensor, rays: torch.Tensor) -> tuple[torch.Tensor]:
    """Orientations of ``turn_to_rays``, as in ``BodyParameters``, for rays (B, 3)."""
    return (rotation_to_6d(rotations_to(rays) @ rotation_from_6d(orientation)),)


def ray_rotations(parameters: BodyParameters, lens: torch.Tensor) -> torch.Tensor:
    """Shortest rotations from the camera's axis to the rays through the pelvises, shape (B, 3, 3).

    ``lens`` may be one a body, (B, 3).
    """
    lens = lens.to(parameters.shift).expand(parameters.batch_size, 3)
    return rotations_to(_rays(parameters.shift, lens))


def rotations_to(rays: torch.Tensor) -> torch.Tensor:
    """Shortest rotations from the camera's axis to rays of any length, (B, 3), shape (B, 3, 3)."""
    rays = torch.nn.functional.normalize(rays, dim=1)
    axis = torch.eye(3, dtype=rays.dtype, device=rays.device)[
        2
    ]  # made there: graphs are captured that are sent nothing
    return rotation_between(axis.expand_as(rays), rays)
