"""The keypoints that networks know: COCO's, and what other formats add that says something of its own."""

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
    found = points.new_zeros(len(LANDMARKS), 3)
    for name, point, trust in zip(names, points, confidence, strict=True):
        name = name if name in LANDMARKS else _TAKEN_FOR.get(name, "")
        if name and trust > 0:
            found[LANDMARKS.index(name)] = torch.cat([point, trust[None]])
    return found
