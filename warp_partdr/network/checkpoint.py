"""Networks in files: safetensors alone, with the sizes and where the weights come from in the file's own metadata."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any

import torch

from ..errors import InputError
from .label_network import LabelNetwork, LabelNetworkConfig
from .regressor import RegressorConfig

PACKAGED = "label_network.safetensors"
MAX_BYTES = 1 << 30
_FORMAT = "warp-partdr label network 1"


def save_label_network(
    path: Path | str,
    weights: Mapping[str, torch.Tensor],
    config: LabelNetworkConfig,
    about: Mapping[str, Any],
    *,
    half: bool = False,
) -> None:
    """Write a network.

    Args:
        path: A ``.safetensors`` file.
        weights: A ``LabelNetwork``'s ``state_dict``.
        config: Its sizes.
        about: What a reader should know of its training, JSON.
        half: Store weights in float16: half the size. Statistics of batch normalisation stay as they are.
    """
    from safetensors.torch import save_file

    def stored(name: str, tensor: torch.Tensor) -> torch.Tensor:
        tensor = tensor.detach().cpu().contiguous()
        return tensor.half() if half and tensor.is_floating_point() and "running" not in name else tensor

    metadata = {"format": _FORMAT, "config": json.dumps(asdict(config)), "about": json.dumps(dict(about))}
    save_file({name: stored(name, tensor) for name, tensor in weights.items()}, path, metadata)


def load_label_network(path: Path | str | None = None, *, device: torch.device | str = "cpu") -> LabelNetwork:
    """A trained network, ready to predict.

    Args:
        path: A file of ``partdr train``; the packaged network if None.
        device: Where it is to run.

    Raises:
        InputError: If the file can't be read or isn't such a network.
    """
    network, _ = _read(path)
    return network.to(device)


def about_network(path: Path | str | None = None) -> dict[str, Any]:
    """What the file says of its training.

    Raises:
        InputError: If the file can't be read or isn't such a network.
    """
    return _read(path)[1]


@lru_cache(maxsize=4)
def packaged_network(device: str) -> LabelNetwork:
    """The packaged network, loaded once for each device; not to be changed."""
    return load_label_network(device=device)


def _read(path: Path | str | None) -> tuple[LabelNetwork, dict[str, Any]]:
    from safetensors import SafetensorError, safe_open

    packaged = resources.files(__package__.rpartition(".")[0]).joinpath("assets", PACKAGED)
    wanted = "a network of `partdr train` (safetensors)"
    with resources.as_file(packaged) as default:
        place = default if path is None else Path(path)
        try:
            if place.stat().st_size > MAX_BYTES:
                raise InputError(f"{place}: more than {MAX_BYTES >> 20} MiB; expected {wanted}")
            with safe_open(place, framework="pt") as file:
                metadata = file.metadata() or {}
                if metadata.get("format") != _FORMAT:
                    raise InputError(f"{place}: format {metadata.get('format')!r}; expected {wanted}")
                weights = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  no mapping
            network = LabelNetwork(_config(json.loads(metadata["config"])))
            about: dict[str, Any] = json.loads(metadata.get("about", "{}"))
            if not all(torch.isfinite(tensor).all() for tensor in weights.values()):
                raise InputError(f"{place}: weights hold NaN or infinity; expected {wanted}")
            network.load_state_dict(weights)
        except OSError as error:
            raise InputError(f"{place}: {error.strerror or error}; expected {wanted}") from None
        except (SafetensorError, json.JSONDecodeError, KeyError, TypeError, ValueError, RuntimeError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{place}: {' '.join(str(error).split())[:200]}; expected {wanted}") from None
    return network.eval().requires_grad_(False), about


def _config(values: dict[str, Any]) -> LabelNetworkConfig:
    regressor = RegressorConfig(**values.pop("regressor"))
    return LabelNetworkConfig(**{**values, "channels": tuple(values["channels"]), "regressor": regressor})
