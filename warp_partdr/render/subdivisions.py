"""Choice of the mesh's level by the distance of its silhouettes from the ellipsoids' own."""

from __future__ import annotations

import math
from typing import Literal

import torch

from ..body.icosphere import MAX_SUBDIVISIONS, icosphere
from ..body.posing import Posed
from ..cameras import Camera
from .ellipsoids import Ellipsoids

Subdivisions = int | Literal["auto"]  # level of the mesh, or the coarsest that keeps a tolerance

DEFAULT_TOLERANCE = 0.5  # [px]
_DIRECTIONS = 256  # around an outline; E3's have about 60 corners
_BODIES = 8  # at a time: a table of one has 26 MB


def coarsest_subdivisions(parts: Ellipsoids | Posed, camera: Camera, *, tolerance: float = DEFAULT_TOLERANCE) -> int:
    """Coarsest level whose silhouettes lie nowhere farther than ``tolerance`` from those of the ellipsoids.

    Args:
        parts: B bodies. One level serves them all.
        camera: Cameras, one for each body, in the pixels that the tolerance is in.
        tolerance: Greatest distance of every part's silhouette, and so of the body's [px].

    Returns:
        Level from 0 to 3, for ``ellipbody_mesh`` and ``Posed.vertices``.

    Raises:
        ValueError: If even the finest level can't keep the tolerance, or it is not positive.

    Examples:
        >>> from warp_partdr import BodyParameters, coarsest_subdivisions
        >>> body = BodyParameters.mean(1)
        >>> [coarsest_subdivisions(body.posed(), body.camera(size)) for size in (64, 256, 1024)]
        [1, 2, 3]
    """
    if not tolerance > 0:
        raise ValueError(f"tolerance: {tolerance}; expected a positive number of pixels")
    error = math.inf
    for level in range(MAX_SUBDIVISIONS + 1):
        errors = silhouette_error(parts, camera, level)
        error = float(errors.max()) if errors.numel() else 0.0
        if error <= tolerance:
            return level
    raise ValueError(f"tolerance: {tolerance:g} px; expected {error:.2g} or more, what E{MAX_SUBDIVISIONS} keeps here")


@torch.no_grad()
def silhouette_error(parts: Ellipsoids | Posed, camera: Camera, subdivisions: int) -> torch.Tensor:
    """Hausdorff distance of each ellipsoid's silhouette from its mesh's [px], shape (B, P), float64.

    The mesh is inscribed. In the plane where the ellipse is the unit disc, both have a support in each direction, and
    how far the ellipse lies outside is greatest across one of the polygon's edges. An ellipsoid that reaches the
    camera's plane is not drawn, and has no error.

    Args:
        parts: B bodies.
        camera: One a body.
        subdivisions: Level of the mesh, 0 to 3.

    Examples:
        >>> from warp_partdr import BodyParameters, silhouette_error
        >>> body = BodyParameters.mean(1)
        >>> errors = silhouette_error(body.posed(), body.camera(256), 1)
        >>> errors.shape, bool(errors.max() < 2)
        (torch.Size([1, 20]), True)
    """
    unit = torch.from_numpy(icosphere(subdivisions)[0]).to(parts.centres.device)
    rows = []
    for first in range(0, parts.centres.shape[0], _BODIES):
        some = slice(first, first + _BODIES)
        centres, axes, semi_axes = (tensor[some].double() for tensor in (parts.centres, parts.axes, parts.semi_axes))
        rows.append(_error(centres, axes * semi_axes[..., None, :], unit, camera, some))
    return torch.cat(rows) if rows else parts.centres.new_zeros(parts.centres.shape[:2], dtype=torch.float64)


def _error(
    centres: torch.Tensor, columns: torch.Tensor, unit: torch.Tensor, camera: Camera, some: slice
) -> torch.Tensor:
    """Silhouette error of some bodies; ``columns`` are axes times semi-axes, shape (B, P, 3, 3)."""
    focal = camera.intrinsics[some].double()[:, None, :2]
    points = centres[..., None, :] + unit @ columns.mT  # (B, P, N, 3)
    spread = columns @ columns.mT
    if camera.perspective:
        # The dual conic of the outline (docs/explanation/exact_renderer.md), in the plane at depth 1.
        conic = centres[..., :, None] * centres[..., None, :] - spread
        drawn = (conic[..., 2, 2] > 0) & (centres[..., 2] > 0)
        scale = torch.where(drawn, conic[..., 2, 2], 1.0)[..., None]
        middle = conic[..., :2, 2] / scale
        shape = middle[..., :, None] * middle[..., None, :] - conic[..., :2, :2] / scale[..., None]
        flat = points[..., :2] / torch.where(drawn[..., None], points[..., 2], 1.0)[..., None]
    else:
        drawn = torch.ones_like(centres[..., 0], dtype=torch.bool)
        middle, shape, flat = centres[..., :2], spread[..., :2, :2], points[..., :2]
    shape = (
        torch.where(drawn[..., None, None], shape, torch.eye(2).to(shape)) * focal[..., :, None] * focal[..., None, :]
    )
    root = torch.linalg.cholesky(shape)  # of the ellipse, [px]: the image of the unit disc
    inverse = torch.linalg.inv(root)
    corners = ((flat - middle[..., None, :]) * focal[..., None, :]) @ inverse.mT  # in the unit disc, (B, P, N, 2)

    angles = 2 * math.pi / _DIRECTIONS * torch.arange(_DIRECTIONS, dtype=torch.float64, device=centres.device)
    directions = torch.stack([angles.cos(), angles.sin()])  # (2, K)
    support, which = (corners @ directions).max(-2)
    gaps = (1 - support) / _lengthen(directions.T, inverse)
    ahead = corners.gather(-2, which[..., None].expand(*which.shape, 2))
    edges = ahead.roll(-1, -2) - ahead
    normals = torch.stack([edges[..., 1], -edges[..., 0]], -1)
    length = normals.norm(dim=-1, keepdim=True)
    normals = torch.where(length > 0, normals / length.clamp_min(1e-300), directions.T)
    across = (1 - (ahead * normals).sum(-1)) / _lengthen(normals, inverse)
    across = torch.where(length[..., 0] > 0, across, 0.0)
    return torch.where(drawn, torch.maximum(gaps.amax(-1), across.amax(-1)), 0.0)


def _lengthen(directions: torch.Tensor, inverse: torch.Tensor) -> torch.Tensor:
    """Length of a normal of the unit disc in the picture, where a gap of 1 along it is 1 over that many pixels."""
    return (directions @ inverse).norm(dim=-1)
