"""Keypoints that networks know: COCO's, and those of other formats that add information."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from ..body.skeletons import skeleton

LANDMARKS: tuple[str, ...] = (
    *skeleton("coco17").landmarks,
    "neck",
    "head_top",
    "mid_hip",
    "left_big_toe",
    "right_big_toe",
    "left_heel",
    "right_heel",
)
# Other names of about the same points.
_TAKEN_FOR = {f"{side}_{name}": f"{side}_big_toe" for side in ("left", "right") for name in ("foot_index", "toe")}


def network_keypoints(names: Sequence[str], points: torch.Tensor, confidence: torch.Tensor) -> torch.Tensor:
    """Keypoints of any format in the order of ``LANDMARKS``; what networks don't know is left out.

    Args:
        names: L landmarks.
        points: In a crop of side 2, shape (L, 2).
        confidence: 0 to 1, shape (L,).

    Returns:
        Coordinates and confidence, all 0 where missing, shape (24, 3).
    """
    rows = {_TAKEN_FOR[name]: row for row, name in enumerate(names) if name in _TAKEN_FOR}
    rows |= {name: row for row, name in enumerate(names) if name in LANDMARKS}
    places = torch.tensor([LANDMARKS.index(name) for name in rows], dtype=torch.int64)
    known = torch.cat([points, confidence[:, None]], dim=1)[list(rows.values())]
    found = points.new_zeros(len(LANDMARKS), 3)
    found[places.to(points.device)] = torch.where(known[:, 2:] > 0, known, 0.0)
    return found
