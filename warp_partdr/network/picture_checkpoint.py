"""EllipBodyNets in files: safetensors, with the sizes and where the weights come from in the file's own metadata."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from ..errors import InputError
from .ellipbodynet import EllipBodyNet, EllipBodyNetConfig
from .regressor import RegressorConfig

_FORMAT = "warp-partdr ellipbodynet 1"
_WANTED = "an EllipBodyNet of `partdr train ellipbodynet` (safetensors)"


def save_ellipbodynet(
    path: Path | str,
    weights: Mapping[str, torch.Tensor],
    config: EllipBodyNetConfig,
    about: Mapping[str, Any],
    *,
    half: bool = False,
) -> None:
    """Write a network.

    Args:
        path: A ``.safetensors`` file.
        weights: An ``EllipBodyNet``'s ``state_dict``.
        config: That network's own ``config``, which tells its backbone's architecture.
        about: What a reader should know of its training, JSON.
        half: Store weights in float16, all but the statistics of batch normalisation.
    """
    from safetensors.torch import save_file

    def stored(name: str, tensor: torch.Tensor) -> torch.Tensor:
        tensor = tensor.detach().cpu().contiguous()
        return tensor.half() if half and tensor.is_floating_point() and "running" not in name else tensor

    metadata = {"format": _FORMAT, "config": json.dumps(asdict(config)), "about": json.dumps(dict(about))}
    save_file({name: stored(name, tensor) for name, tensor in weights.items()}, path, metadata)


def load_ellipbodynet(path: Path | str, *, device: torch.device | str = "cpu") -> EllipBodyNet:
    """A trained network, ready to predict.

    Args:
        path: A file of ``save_ellipbodynet``.
        device: Where it is to run.

    Raises:
        InputError: If the file can't be read or isn't such a network.
    """
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            if metadata.get("format") != _FORMAT:
                raise InputError(f"{path}: format {metadata.get('format')!r}; expected {_WANTED}")
            weights = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  no mapping
        values = json.loads(metadata["config"])
        network = EllipBodyNet(EllipBodyNetConfig(**{**values, "regressor": RegressorConfig(**values["regressor"])}))
        if not all(torch.isfinite(tensor).all() for tensor in weights.values()):
            raise InputError(f"{path}: weights hold NaN or infinity; expected {_WANTED}")
        network.load_state_dict(weights)
    except InputError:
        raise
    except (SafetensorError, OSError, KeyError, TypeError, ValueError, RuntimeError) as error:
        raise InputError(f"{path}: {' '.join(str(error).split())[:200]}; expected {_WANTED}") from None
    return network.eval().requires_grad_(False).to(device)
