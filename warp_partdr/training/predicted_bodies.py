"""Bodies that a network says: their landmarks, drawings and weighted losses, for all tasks."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import lru_cache

import torch

from ..body.parameters import BodyParameters
from ..body.posing import LandmarkGather, Posed
from ..network.predicted import Predicted
from ..render.ellipsoids import draw_ellipsoids


def posed_landmarks(posed: Posed, names: tuple[str, ...]) -> torch.Tensor:
    """Landmarks of posed bodies, shape (B, L, 3) [m]."""
    return _gather(names, posed.joints.device)(posed)


@lru_cache(maxsize=8)
def _gather(names: tuple[str, ...], device: torch.device) -> LandmarkGather:
    return LandmarkGather(names, device)


def draw_bodies(bodies: Predicted | BodyParameters, size: int) -> torch.Tensor:
    """Part labels of bodies in their crops, shape (B, size, size), uint8."""
    return draw_ellipsoids(bodies.posed(), bodies.camera(size), (size, size), validate=False).labels


def weighted_losses(
    terms: Mapping[str, torch.Tensor], weights: Mapping[str, float], left_out: Collection[str]
) -> dict[str, torch.Tensor]:
    """The terms times their weights, but for those left out, and "total", their sum."""
    weighted = {name: weights[name] * term for name, term in terms.items() if name not in left_out}
    return {**weighted, "total": torch.stack(list(weighted.values())).sum()}
