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
_TOP, _WIDE = 0.6, 0.3  # share of the width at the hips, where cloth leaves the body, and the level from where it is all
_WINDOW = 0.08  # levels to either side among which a leg's thickness is measured
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
        hem: Level where the tube ends; rings beyond lie there, too, so that a tube of 0 has no area.
        room: Distance from the legs at each of ``LEVELS`` [m], shape (25,).

    Returns:
        Vertices, shape (25 * 48, 3) [m], and labels of ``tube_faces``: the leg that is nearer, upper or lower.
    """
    levels = np.minimum(LEVELS, hem)[:, None]
    radii = (_leg_radii(shape, levels[:, 0]) + room)[:, None] * (
        _TOP + (1.0 - _TOP) * np.minimum(levels / _WIDE, 1.0)
    )
    knees_on = np.clip(levels - 1.0, 0.0, 1.0)
    legs, down = [], np.zeros((len(levels), 3))
    for side in "LR":
        hip, knee, ankle = joints(body, LEG, side)
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
    return vertices.reshape(-1, 3), _labels(of_left.ravel())


def _labels(of_left: np.ndarray) -> np.ndarray:
    """Part labels of ``tube_faces`` whose vertices belong to the left leg by these shares, (25 * 48,), uint8."""
    faces = tube_faces()
    lower = LEVELS[faces.min(1) // CORNERS] >= 1.0
    right = of_left[faces].mean(1) < 0.5
    names = [f"{side}_{part}" for part in LEG for side in ("left", "right")]
    return np.array([PART_NAMES.index(name) + 1 for name in names], dtype=np.uint8)[2 * lower + right]


def _leg_radii(shape: torch.Tensor, levels: np.ndarray) -> np.ndarray:
    """Radii of the legs of a person of these shape values, at rest, like ``levels`` [m]."""
    rest, shares = anny().rest(shape), anny_skin().shares
    points = rest.vertices[0].numpy()
    leg = points[(shares["upper_leg"] + shares["lower_leg"] > 0.5) & (points[:, 0] > 0)]
    places, distances = along(leg, *joints(rest, LEG))
    return np.array([distances[np.abs(places - level) < _WINDOW].max() for level in levels])
