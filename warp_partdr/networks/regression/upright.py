"""People who lean in the picture, turned upright before the label network looks at them, and their bodies turned back.

Training leans few people by more than 30 degrees: of one who lay or stood on the head, the network's joints were up to
twice as far off. A turn about the view changes nothing else that it sees.
"""

from __future__ import annotations

import math
from dataclasses import replace

import torch

from ...body.landmarks import mirror_name
from .heads import cell_centres
from .landmarks import LANDMARKS
from .predicted import Predicted

_LEAN = math.radians(30.0)  # farther from upright, a person is turned
# Pairs from the ground up: a person leans as the line from the first that is seen to the shoulders does.
_FEET = ("left_ankle", "left_knee", "left_hip")
_SHOULDERS = "left_shoulder"


def leans(keypoints: torch.Tensor) -> torch.Tensor:
    """Angles by which people lean in the picture, clockwise, 0 if by less than 30 degrees or if not known.

    Args:
        keypoints: Keypoints as networks see them (``network_keypoints``), shape (B, 24, 3).

    Returns:
        Angles from -π to π [rad], shape (B,).
    """
    top, known = _middle(keypoints, _SHOULDERS)
    foot, found = _middle(keypoints, _FEET[0])
    for name in _FEET[1:]:
        other, seen = _middle(keypoints, name)
        foot, found = torch.where(found, foot, other), found | seen
    across, down = (top - foot).unbind(1)
    angles = torch.atan2(across, -down)
    return torch.where((known & found)[:, 0] & (angles.abs() > _LEAN), angles, 0.0)


def turn_inputs(
    pictures: torch.Tensor, keypoints: torch.Tensor, conditions: torch.Tensor, angles: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Inputs of a label network, turned clockwise about the crops' middles by ``angles`` (B,) [rad].

    Of labels as shares or as ids (B, C, S, S), float32: what comes into a crop from beyond it is what is at its border.
    Keypoints and conditions as of the network's ``forward``.
    """
    rows: slice | torch.Tensor = slice(None)  # on a GPU all, for choosing would wait for it
    if not angles.is_cuda:
        rows = angles.nonzero()[:, 0]
        if len(rows) == 0:
            return pictures, keypoints, conditions
    some = pictures[rows]
    across = cell_centres(some.shape[-1], some.device)
    # From positions after the turn to those before it; torch's own products of matrices take a GPU longer.
    right, down = _turns(angles[rows])[:, None, None].unbind(3)
    positions = right * across[:, None] + down * across[:, None, None]
    pictures = pictures.clone()
    pictures[rows] = torch.nn.functional.grid_sample(
        some, positions, mode="nearest", padding_mode="border", align_corners=False
    )
    turns = _turns(angles)
    points = keypoints[..., :2] @ turns.mT
    lens, aside, stature = conditions.split([2, 2, conditions.shape[1] - 4], dim=1)
    conditions = torch.cat([lens, (turns @ aside[..., None])[..., 0], stature], dim=1)
    return pictures, torch.cat([points, keypoints[..., 2:]], dim=2), conditions


def turn_predicted(bodies: Predicted, angles: torch.Tensor) -> Predicted:
    """Bodies turned clockwise about the view by ``angles`` (B,) [rad]; how sure they are stays."""
    turns = _turns(angles)
    about_view = torch.eye(3, device=turns.device).repeat(len(turns), 1, 1)
    about_view[:, :2, :2] = turns
    return replace(bodies, orientation=about_view @ bodies.orientation, shift=(turns @ bodies.shift[..., None])[..., 0])


def _turns(angles: torch.Tensor) -> torch.Tensor:
    """Rotations of the picture, x right and y down, shape (B, 2, 2)."""
    cos, sin = angles.cos(), angles.sin()
    return torch.stack([cos, -sin, sin, cos], dim=1).unflatten(1, (2, 2))


def _middle(keypoints: torch.Tensor, name: str) -> tuple[torch.Tensor, torch.Tensor]:
    """Middle of a landmark and its mirror image, of those that are seen, (B, 2), and if there is any, (B, 1)."""
    # No list of indices, which a GPU would be sent, and wait for.
    pair = torch.stack([keypoints[:, LANDMARKS.index(each)] for each in (name, mirror_name(name))], dim=1)
    seen = (pair[..., 2:] > 0).to(pair.dtype)
    count = seen.sum(1)
    return (pair[..., :2] * seen).sum(1) / count.clamp_min(1.0), count > 0
