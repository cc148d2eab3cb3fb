"""Files of networks: safetensors, with sizes and the record of the training in the file's metadata."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any, Generic, TypeVar

import torch

from ..errors import InputError, cause
from ..files.json_files import parse_json
from ..files.sections import read_section
from .ellipbodynet import EllipBodyNet, EllipBodyNetConfig
from .label_network import LabelNetwork, LabelNetworkConfig

MAX_BYTES = 1 << 30

Config = TypeVar("Config")
Network = TypeVar("Network", bound=torch.nn.Module)


@dataclass(frozen=True)
class NetworkFiles(Generic[Network, Config]):
    """Files of one kind of network."""

    kind: str  # name and version, in the file
    make: Callable[[Config], Network]  # from sizes to a network
    sizes: type[Config]  # dataclass of the sizes
    expected: str  # description of such a file, for messages

    def save(
        self,
        path: Path | str,
        weights: Mapping[str, torch.Tensor],
        config: Config,
        about: Mapping[str, Any],
        *,
        half: bool = False,
    ) -> None:
        """Write a network's ``state_dict`` with its sizes and the record of its training (JSON) to a safetensors file.

        With ``half``, weights are stored in float16; statistics of batch normalisation stay as they are.
        """
        from safetensors.torch import save_file

        def stored(name: str, tensor: torch.Tensor) -> torch.Tensor:
            tensor = tensor.detach().cpu().contiguous()
            return tensor.half() if half and tensor.is_floating_point() and "running" not in name else tensor

        values = asdict(config)  # type: ignore[call-overload]  # a dataclass
        metadata = {"format": self.kind, "config": json.dumps(values), "about": json.dumps(dict(about))}
        save_file({name: stored(name, tensor) for name, tensor in weights.items()}, path, metadata)

    def load(self, path: Path | str, *, device: torch.device | str = "cpu") -> Network:
        """Load a network in evaluation mode.

        Raises:
            InputError: If the file can't be read or is no such network.
        """
        from safetensors import SafetensorError, safe_open

        try:
            if Path(path).stat().st_size > MAX_BYTES:
                raise InputError(f"{path}: more than {MAX_BYTES >> 20} MiB; expected {self.expected}")
            with safe_open(path, framework="pt") as file:
                metadata = file.metadata() or {}
                if metadata.get("format") != self.kind:
                    raise InputError(f"{path}: format {metadata.get('format')!r}; expected {self.expected}")
                weights = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  no mapping
            if not all(torch.isfinite(tensor).all() for tensor in weights.values()):
                raise InputError(f"{path}: weights hold NaN or infinity; expected {self.expected}")
            config = read_section(self.sizes, parse_json(metadata["config"], f"{path}: config", self.expected))
            network = self.make(config)
            network.load_state_dict(weights)
        except (OSError, SafetensorError, KeyError, ValueError, TypeError, RuntimeError) as error:
            if isinstance(error, InputError) and str(error).startswith(str(path)):
                raise
            raise InputError(f"{path}: {cause(error)}; expected {self.expected}") from None
        # Convolutions of pictures whose channels lie together take a sixth less time on CPU.
        network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # torch's own stubs lack it
        return network.eval().requires_grad_(False).to(device)


_LABEL_NETWORKS = NetworkFiles(
    "warp-partdr label network 2",
    LabelNetwork,
    LabelNetworkConfig,
    "a network of `partdr train label-network` (safetensors)",
)
_ELLIPBODYNETS = NetworkFiles(
    "warp-partdr ellipbodynet 1",
    EllipBodyNet,
    EllipBodyNetConfig,
    "an EllipBodyNet of `partdr train ellipbodynet` (safetensors)",
)
save_label_network, save_ellipbodynet = _LABEL_NETWORKS.save, _ELLIPBODYNETS.save
load_ellipbodynet = _ELLIPBODYNETS.load


def load_label_network(path: Path | str | None = None, *, device: torch.device | str = "cpu") -> LabelNetwork:
    """Load a trained network in evaluation mode.

    Args:
        path: A file of ``partdr train``; the packaged network if None.
        device: Device to run on.

    Raises:
        InputError: If the file can't be read or isn't such a network.
    """
    packaged = resources.files("warp_partdr").joinpath("assets", "label_network.safetensors")
    with resources.as_file(packaged) as default:
        return _LABEL_NETWORKS.load(default if path is None else path, device=device)


@lru_cache(maxsize=4)
def packaged_network(device: str) -> LabelNetwork:
    """The packaged network, loaded once for each device; not to be changed."""
    return load_label_network(device=device)
