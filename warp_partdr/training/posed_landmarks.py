"""Landmarks of bodies that a network says."""

from __future__ import annotations

from functools import lru_cache

import torch

from ..body.posing import LandmarkGather, Posed


def posed_landmarks(posed: Posed, names: tuple[str, ...]) -> torch.Tensor:
    """Landmarks of posed bodies, shape (B, L, 3) [m]."""
    return _gather(names, posed.joints.device)(posed)


@lru_cache(maxsize=8)
def _gather(names: tuple[str, ...], device: torch.device) -> LandmarkGather:
    return LandmarkGather(names, device)
