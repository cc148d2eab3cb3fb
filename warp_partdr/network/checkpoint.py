"""Loading of label networks: the packaged one, and those of ``partdr train``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any

import torch

from .files import NetworkFiles
from .label_network import LabelNetwork, LabelNetworkConfig

PACKAGED = "label_network.safetensors"

_FILES = NetworkFiles(
    "warp-partdr label network 1", LabelNetworkConfig, "a network of `partdr train label-network` (safetensors)"
)
save_label_network = _FILES.save


def load_label_network(path: Path | str | None = None, *, device: torch.device | str = "cpu") -> LabelNetwork:
    """Load a trained network in evaluation mode.

    Args:
        path: A file of ``partdr train``; the packaged network if None.
        device: Device to run on.

    Raises:
        InputError: If the file can't be read or isn't such a network.
    """
    with _place(path) as place:
        return _FILES.load(place, LabelNetwork).to(device)


def about_network(path: Path | str | None = None) -> dict[str, Any]:
    """Read a network file's record of its training.

    Raises:
        InputError: If the file can't be read or isn't such a network.
    """
    with _place(path) as place:
        return _FILES.read(place)[2]


@lru_cache(maxsize=4)
def packaged_network(device: str) -> LabelNetwork:
    """The packaged network, loaded once for each device; not to be changed."""
    return load_label_network(device=device)


@contextmanager
def _place(path: Path | str | None) -> Iterator[Path]:
    packaged = resources.files("warp_partdr").joinpath("assets", PACKAGED)
    with resources.as_file(packaged) as default:
        yield default if path is None else Path(path)
