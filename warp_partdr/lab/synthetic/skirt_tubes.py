"""Tubes around both legs, of skirts and coats: they close the gap that cloth on the skin leaves between the legs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from ...body.template import PART_NAMES
from ...models.anny import anny
from ...models.model import Detailed
from .skin import LEG, along, anny_skin, joints

LEVELS = np.linspace(0.0, 2.0, 25)  # of rings along the legs: 0 at the hips, 1 at the knees, 2 at the ankles
CORNERS = 48  # of a ring
_TOP, _WIDE = 0.6, 0.3  # share of its width that a tube has at the hips, and the level where it has all
_WINDOW = 0.08  # levels to either side among which a leg's thickness is measured
_WITHIN = 0.7  # share of a leg's vertices within its radius: buttocks and the inner thighs are farther from its axis
_TURN = 0.3  # cosine of an angle to the line between the legs, within which a ring passes from one leg to the other


def tube_faces() -> np.ndarray:
    """Corners of triangles between the rings, as indices of ``tube``'s vertices, shape (24 * 48 * 2, 3)."""
    rows, corners = (each.ravel() for each in np.mgrid[: len(LEVELS) - 1, :CORNERS])
    one, other = rows * CORNERS + corners, rows * CORNERS + (corners + 1) % CORNERS
    below, across = one + CORNERS, other + CORNERS
    return np.concatenate([np.column_stack([one, other, across]), np.column_stack([one, across, below])])


def leg_joints(body: Detailed) -> torch.Tensor:
    """Hip, knee and ankle of the left leg and of the right one, shape (B, 2, 3, 3) [m]."""
    return torch.stack([joints(body, LEG, side) for side in "LR"], dim=1)


def ring_levels(legs: torch.Tensor, hem: torch.Tensor) -> torch.Tensor:
    """Levels along the legs that a tube's rings lie at, shape (B, 25).

    Of ``leg_joints`` and hems (B,), where tubes end with straight legs; with knees bent by 90 degrees they end at the
    knees. Rings beyond lie there, too, so that a tube of 0 has no area.
    """
    straight = 1.0 + (hem - 1.0).clamp(min=0.0) * _straightness(legs).amin(1)
    return torch.minimum(legs.new_tensor(LEVELS), torch.minimum(hem, straight)[:, None])


def tube(
    legs: torch.Tensor, levels: torch.Tensor, radii: torch.Tensor, shares: Sequence[tuple[float, float]] = ((0, 1),)
) -> tuple[torch.Tensor, torch.Tensor]:
    """Rings of N tubes, each the hull of a disc about either leg.

    Args:
        legs: Joints that ``leg_joints`` returned.
        levels: Levels that ``ring_levels`` returned.
        radii: Radii of the discs where they are widest [m], shape (B, 25).
        shares: Least and largest share of the left leg in each tube: 0.5 to 1 is the hull of its disc and of one
            between the legs.

    Returns:
        Vertices, shape (B, N * 25 * 48, 3) [m], and the left leg's share of each, shape (B, N * 25, 48).
    """
    levels = levels[..., None]
    radii = radii[..., None] * (_TOP + (1.0 - _TOP) * (levels / _WIDE).clamp(max=1.0))
    knees_on = (levels - 1.0).clamp(0.0, 1.0)
    middles, down = [], torch.zeros_like(levels)
    for leg in legs.unbind(1):
        hip, knee, ankle = leg[:, :, None].unbind(1)
        middles.append(hip + levels.clamp(max=1.0) * (knee - hip) + knees_on * (ankle - knee))
        down = down + (1.0 - knees_on) * (knee - hip) + knees_on * (ankle - knee)
    down = torch.nn.functional.normalize(down, dim=-1, eps=1e-6)
    left = middles[0][:, :1] - middles[1][:, :1]
    left = torch.nn.functional.normalize(left - (left * down).sum(-1, keepdim=True) * down, dim=-1, eps=1e-6)
    angles = legs.new_tensor(2.0 * np.pi * np.arange(CORNERS) / CORNERS)[:, None]
    outward = angles.cos() * left[:, :, None] + angles.sin() * torch.linalg.cross(down, left)[:, :, None]
    # In a direction, the hull reaches as far as the disc that is farther there; where both do, it lies between them.
    apart, right = (middles[0] - middles[1])[:, :, None], middles[1][:, :, None]
    turned = (apart * outward).sum(-1, keepdim=True) / apart.norm(dim=-1, keepdim=True).clamp(min=1e-6)
    of_left = 0.5 + 0.5 * turned / _TURN
    of_left = torch.stack([of_left.clamp(*limits) for limits in shares], dim=1)
    vertices = right[:, None] + of_left * apart[:, None] + (radii[..., None] * outward)[:, None]
    return vertices.flatten(1, 3), of_left[..., 0].flatten(1, 2)


def _straightness(legs: torch.Tensor) -> torch.Tensor:
    """Cosine of each knee's bend, 0 beyond 90 degrees; joints (B, 2, 3, 3) to (B, 2)."""
    thighs, shanks = legs.diff(dim=2).unbind(2)
    return torch.nn.functional.cosine_similarity(thighs, shanks, dim=-1).clamp(min=0.0)


def tube_labels(of_left: np.ndarray) -> np.ndarray:
    """Part labels of ``tube_faces``, uint8: the leg that is nearer, upper or lower; shares of the left one (25, 48)."""
    lower = np.repeat(LEVELS[:-1] >= 1.0, CORNERS)
    beside = of_left + np.roll(of_left, -1, axis=1)
    right = (beside[:-1] + beside[1:] < 2.0).ravel()  # both triangles of four vertices have one label
    names = [f"{side}_{part}" for part in LEG for side in ("left", "right")]
    parts = np.array([PART_NAMES.index(name) + 1 for name in names], dtype=np.uint8)
    return np.tile(parts[2 * lower + right], 2)


def leg_radii(shape: torch.Tensor, levels: np.ndarray) -> np.ndarray:
    """Radii of the legs of a person of these shape values, at rest, like ``levels`` [m]."""
    rest, shares = anny().rest(shape), anny_skin().shares
    points = rest.vertices[0].numpy()
    leg = points[(shares["upper_leg"] + shares["lower_leg"] > 0.5) & (points[:, 0] > 0)]
    positions, distances = along(leg, *joints(rest, LEG)[0].numpy())
    return np.array([np.quantile(distances[np.abs(positions - level) < _WINDOW], _WITHIN) for level in levels])
