"""Keypoints that networks know: COCO's, and those of other formats that add information."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import torch

from ...body.skeletons import skeleton

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
        names: Names of L landmarks.
        points: Points in a crop of side 2, shape (L, 2).
        confidence: Confidence of each point, 0 to 1, shape (L,).

    Returns:
        Coordinates and confidence, all 0 where missing, shape (24, 3).
    """
    visible = np.ones((1, len(names)), dtype=bool)
    return format_keypoints(tuple(names), visible, points[None], confidence[None])[0]


def format_keypoints(
    names: tuple[str, ...], visible: np.ndarray, points: torch.Tensor, confidence: torch.Tensor
) -> torch.Tensor:
    """Keypoints of N people with one format, each as in ``network_keypoints``, shape (N, 24, 3).

    Only those of the J keypoints that are ``visible`` count, shape (N, J).
    """
    rows = np.stack([_visible_rows(names, each.tobytes()) for each in visible])
    starts = np.arange(len(rows))[:, None] * len(names)
    known = torch.cat([points, confidence[..., None]], dim=2).flatten(0, 1)
    return _taken(known, np.where(rows < 0, len(known), rows + starts))


def _taken(known: torch.Tensor, rows: np.ndarray) -> torch.Tensor:
    """Rows of keypoints (M, 3), of which number M is of what is missing."""
    found = torch.cat([known, known.new_zeros(1, 3)])[torch.from_numpy(rows).to(known.device)]
    return torch.where(found[..., 2:] > 0, found, 0.0)


@lru_cache(maxsize=4096)
def _visible_rows(names: tuple[str, ...], visible: bytes) -> np.ndarray:
    """Column of each of ``LANDMARKS`` among a format's names, -1 where it is not visible."""
    columns = np.flatnonzero(np.frombuffer(visible, dtype=bool))
    rows = _rows(tuple(names[column] for column in columns))
    return np.where(rows < 0, -1, np.append(columns, -1)[rows])


@lru_cache(maxsize=256)
def _rows(names: tuple[str, ...]) -> np.ndarray:
    """Row of each of ``LANDMARKS`` among names, -1 where it is missing."""
    rows = {_TAKEN_FOR[name]: row for row, name in enumerate(names) if name in _TAKEN_FOR}
    rows |= {name: row for row, name in enumerate(names)}
    return np.array([rows.get(name, -1) for name in LANDMARKS])
