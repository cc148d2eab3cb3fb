"""Loading of EllipBodyNets from files of ``partdr train``."""

from __future__ import annotations

from pathlib import Path

import torch

from .ellipbodynet import EllipBodyNet, EllipBodyNetConfig
from .files import NetworkFiles

_FILES = NetworkFiles(
    "warp-partdr ellipbodynet 1", EllipBodyNetConfig, "an EllipBodyNet of `partdr train ellipbodynet` (safetensors)"
)
save_ellipbodynet = _FILES.save


def load_ellipbodynet(path: Path | str, *, device: torch.device | str = "cpu") -> EllipBodyNet:
    """Load a trained network in evaluation mode.

    Args:
        path: A file of ``save_ellipbodynet``.
        device: Device to run on.

    Raises:
        InputError: If the file can't be read or isn't such a network.
    """
    return _FILES.load(path, EllipBodyNet).to(device)
