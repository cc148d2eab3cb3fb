"""Options that both renderers share: the reach of PartDR's gradient, the weight of its z part."""

from __future__ import annotations

import math
from typing import Literal, TypeVar, get_args

import torch

Gradient = Literal["edges", "coverage", "partdr"]
MeshGradient = Literal["edges", "partdr"]
# torch 2.6 can't compile get_args itself.
GRADIENTS: tuple[str, ...] = get_args(Gradient)
MESH_GRADIENTS: tuple[str, ...] = get_args(MeshGradient)

IGNORE_LABEL = 255  # a target pixel that neither attracts nor repels
DEFAULT_DEPTH_WEIGHT = 1.0  # the paper's lambda in eq. 12, to which it gives no value

_T = TypeVar("_T")


def check_partdr_options(max_distance: float, depth_weight: float) -> None:
    """Raise ValueError unless PartDR's rule can take these, for a mesh or for ellipsoids."""
    if not max_distance >= 0:
        raise ValueError(f"max_distance: {max_distance}; expected a number of pixels from 0, or infinity")
    if not 0 <= depth_weight < math.inf:
        raise ValueError(f"depth_weight: {depth_weight}; expected a finite number from 0")


def check_mesh_rule(
    gradient: MeshGradient, max_distance: float, depth_weight: float
) -> tuple[float, float, MeshGradient]:
    """Options of a mesh's gradient, checked, as the last three of ``mesh_passes``."""
    if gradient not in MESH_GRADIENTS:
        raise ValueError(f"gradient: {gradient!r}; expected one of {', '.join(MESH_GRADIENTS)}, of a mesh")
    check_partdr_options(max_distance, depth_weight)
    return float(max_distance), float(depth_weight), gradient


def check_target(target: torch.Tensor, like: tuple[str, torch.Tensor], batch: int) -> None:
    """Raise ValueError unless a label image (N, H, W) fits a batch: N is 1 or B, on the same device.

    Args:
        target: Label image. Its dtype uint8 and its three dimensions have been checked.
        like: Name and tensor on whose device it must be.
        batch: Number of bodies B.
    """
    if target.device != like[1].device:
        raise ValueError(f"target: on {target.device}; expected {like[1].device}, as {like[0]}")
    if target.shape[0] not in (1, batch):
        raise ValueError(f"target: batch {target.shape[0]}; expected {batch} as {like[0]}, or 1")


def label_maps(labels: torch.Tensor, count: int, faults: torch.Tensor) -> torch.Tensor:
    """Part maps A^1 to A^K of label images (paper, eq. 9), shape (B, K, H, W), float32.

    ``faults`` (B,) are added to them: 0, or NaN.
    """
    index = torch.arange(1, count + 1, dtype=torch.uint8, device=labels.device)
    maps = torch.empty(len(labels), count, *labels.shape[1:], device=labels.device)
    torch.eq(labels[:, None], index[:, None, None], out=maps)  # on the CPU a quarter of the time of ``float()``
    return maps.add_(faults[:, None, None, None])
