"""Tubes around both legs, of skirts and coats: they close the gap that cloth on the skin leaves between the legs."""

from __future__ import annotations

import numpy as np
import torch

from ..body.template import PART_NAMES
from ..clothing.anny import anny
from ..clothing.model import Detailed
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


def tube(body: Detailed, shape: torch.Tensor, hem: float, room: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rings, each the hull of a disc about either leg, and the labels of the faces between them.

    Args:
        body: Anny, B = 1, any frame [m].
        shape: Its shape values, shape (1, 20).
        hem: Level where the tube ends with straight legs, with knees bent by 90 degrees at the knees. Rings beyond lie
            there, too, so that a tube of 0 has no area.
        room: Distance from the legs at each of ``LEVELS`` [m], shape (25,).

    Returns:
        Vertices, shape (25 * 48, 3) [m], and labels of ``tube_faces``: the leg that is nearer, upper or lower.
    """
    sides = [joints(body, LEG, side) for side in "LR"]
    levels = np.minimum(LEVELS, min(hem, 1.0 + max(hem - 1.0, 0.0) * min(map(_straightness, sides))))[:, None]
    radii = (_leg_radii(shape, levels[:, 0]) + room)[:, None] * (_TOP + (1.0 - _TOP) * np.minimum(levels / _WIDE, 1.0))
    knees_on = np.clip(levels - 1.0, 0.0, 1.0)
    legs, down = [], np.zeros((len(levels), 3))
    for hip, knee, ankle in sides:
        legs.append(hip + np.minimum(levels, 1.0) * (knee - hip) + knees_on * (ankle - knee))
        down += (1.0 - knees_on) * (knee - hip) + knees_on * (ankle - knee)
    down /= np.linalg.norm(down, axis=1, keepdims=True).clip(1e-6)
    left = legs[0][:1] - legs[1][:1]
    left = left - (left * down).sum(1, keepdims=True) * down
    left /= np.linalg.norm(left, axis=1, keepdims=True).clip(1e-6)
    angles = 2.0 * np.pi * np.arange(CORNERS) / CORNERS
    outward = np.cos(angles)[:, None] * left[:, None] + np.sin(angles)[:, None] * np.cross(down, left)[:, None]
    # In a direction, the hull reaches as far as the disc that is farther there; where both do, it lies between them.
    apart = (legs[0] - legs[1])[:, None]
    turned = (apart * outward).sum(-1, keepdims=True) / np.linalg.norm(apart, axis=-1, keepdims=True).clip(1e-6)
    of_left = np.clip(0.5 + 0.5 * turned / _TURN, 0.0, 1.0)
    vertices = legs[1][:, None] + of_left * apart + radii[..., None] * outward
    return vertices.reshape(-1, 3), _labels(of_left[..., 0])


def _straightness(leg: np.ndarray) -> float:
    """Cosine of a knee's bend, 0 beyond 90 degrees; joints (3, 3)."""
    thigh, shank = np.diff(leg, axis=0)
    return max(float(thigh @ shank / (np.linalg.norm(thigh) * np.linalg.norm(shank))), 0.0)


def _labels(of_left: np.ndarray) -> np.ndarray:
    """Part labels of ``tube_faces`` whose vertices belong to the left leg by these shares, (25, 48), uint8."""
    lower = np.repeat(LEVELS[:-1] >= 1.0, CORNERS)
    beside = of_left + np.roll(of_left, -1, axis=1)
    right = (beside[:-1] + beside[1:] < 2.0).ravel()  # both triangles of four vertices have one label
    names = [f"{side}_{part}" for part in LEG for side in ("left", "right")]
    parts = np.array([PART_NAMES.index(name) + 1 for name in names], dtype=np.uint8)
    return np.tile(parts[2 * lower + right], 2)


def _leg_radii(shape: torch.Tensor, levels: np.ndarray) -> np.ndarray:
    """Radii of the legs of a person of these shape values, at rest, like ``levels`` [m]."""
    rest, shares = anny().rest(shape), anny_skin().shares
    points = rest.vertices[0].numpy()
    leg = points[(shares["upper_leg"] + shares["lower_leg"] > 0.5) & (points[:, 0] > 0)]
    places, distances = along(leg, *joints(rest, LEG))
    return np.array([np.quantile(distances[np.abs(places - level) < _WINDOW], _WITHIN) for level in levels])
