"""Forward kinematics in plain torch, the same function as the kernels of ``posing``.

It can be differentiated any number of times, traced by ``torch.compile`` and transformed by ``torch.func``.
"""

from __future__ import annotations

import torch

from .icosphere import icosphere
from .template import BONE_STARTS, PARENTS, SIZE_COLUMNS, template

_DIRECTIONS = torch.from_numpy(template().rest_directions)
_AXES = torch.from_numpy(template().rest_axes)


def pose_bones_by_torch(
    global_orient: torch.Tensor,
    translation: torch.Tensor,
    rotations: torch.Tensor,
    lengths: torch.Tensor,
    thicknesses: torch.Tensor,
) -> tuple[torch.Tensor, ...]:
    """Compute the fields of ``Posed`` from the arguments of ``pose``."""
    turns: list[torch.Tensor] = []
    for parent, rotation in zip(PARENTS, rotations.unbind(1), strict=True):
        turns.append((global_orient if parent < 0 else turns[parent]) @ rotation)
    turned = torch.stack(turns, dim=1)
    sizes = torch.cat([lengths, thicknesses], dim=1)[:, SIZE_COLUMNS]
    bones = (turned @ _DIRECTIONS.to(lengths)[..., None])[..., 0] * sizes[..., :1]
    ends = [translation]
    for start, bone in zip(BONE_STARTS, bones.unbind(1), strict=True):
        ends.append(ends[start] + bone)
    joints = torch.stack(ends, dim=1)
    centres = (joints[:, BONE_STARTS] + joints[:, 1:]) / 2
    return joints, turned, centres, turned @ _AXES.to(lengths), sizes / 2


def place_vertices_by_torch(
    centres: torch.Tensor, axes: torch.Tensor, semi_axes: torch.Tensor, subdivisions: int
) -> torch.Tensor:
    """Deform the unit sphere's mesh into each ellipsoid, shape (B, P, N, 3) [m]; NaN if a size is 0 or less."""
    sphere = torch.ops.warp_partdr.unit_sphere(subdivisions).to(semi_axes)
    sizes = torch.where((semi_axes > 0).all(-1, keepdim=True), semi_axes, torch.nan)
    return centres[:, :, None] + (sizes[:, :, None] * sphere) @ axes.mT


@torch.library.custom_op("warp_partdr::unit_sphere", mutates_args=())
def _unit_sphere(subdivisions: int) -> torch.Tensor:
    """Unit sphere as a custom operation, for ``torch.compile`` can't trace how it is made."""
    return torch.from_numpy(icosphere(subdivisions)[0].copy())


@_unit_sphere.register_fake
def _(subdivisions: int) -> torch.Tensor:
    return torch.empty(10 * 4**subdivisions + 2, 3, dtype=torch.float64)
