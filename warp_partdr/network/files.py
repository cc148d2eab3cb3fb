"""Files of networks: safetensors, with sizes and the record of the training in the file's metadata."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Generic, TypeVar

import torch

from ..errors import InputError
from ..files.json_files import parse_json
from ..files.sections import read_section

MAX_BYTES = 1 << 30

Config = TypeVar("Config")
Network = TypeVar("Network", bound=torch.nn.Module)


class NetworkFiles(Generic[Config]):
    """Files of one kind of network.

    Args:
        kind: Name and version, in the file.
        config: Dataclass of its sizes.
        expected: Description of such a file, for messages.
    """

    def __init__(self, kind: str, config: type[Config], expected: str) -> None:
        self._kind, self._config, self._expected = kind, config, expected

    def save(
        self,
        path: Path | str,
        weights: Mapping[str, torch.Tensor],
        config: Config,
        about: Mapping[str, Any],
        *,
        half: bool = False,
    ) -> None:
        """Write a network.

        Args:
            path: A ``.safetensors`` file.
            weights: Its ``state_dict``.
            config: Its sizes.
            about: Record of its training, JSON.
            half: Store weights in float16: half the size. Statistics of batch normalisation stay as they are.
        """
        from safetensors.torch import save_file

        def stored(name: str, tensor: torch.Tensor) -> torch.Tensor:
            tensor = tensor.detach().cpu().contiguous()
            return tensor.half() if half and tensor.is_floating_point() and "running" not in name else tensor

        values = asdict(config)  # type: ignore[call-overload]  # a dataclass
        metadata = {"format": self._kind, "config": json.dumps(values), "about": json.dumps(dict(about))}
        save_file({name: stored(name, tensor) for name, tensor in weights.items()}, path, metadata)

    def read(self, path: Path | str) -> tuple[dict[str, torch.Tensor], Config, dict[str, Any]]:
        """Read weights, sizes, and the record of the training.

        Raises:
            InputError: If the file can't be read or is no such network.
        """
        from safetensors import SafetensorError, safe_open

        try:
            if Path(path).stat().st_size > MAX_BYTES:
                raise InputError(f"{path}: more than {MAX_BYTES >> 20} MiB; expected {self._expected}")
            with safe_open(path, framework="pt") as file:
                metadata = file.metadata() or {}
                if metadata.get("format") != self._kind:
                    raise InputError(f"{path}: format {metadata.get('format')!r}; expected {self._expected}")
                weights = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  no mapping
            config = read_section(self._config, parse_json(metadata["config"], f"{path}: config", self._expected))
            about: dict[str, Any] = parse_json(metadata.get("about", "{}"), f"{path}: about", self._expected)
        except InputError as error:
            raise error if str(error).startswith(str(path)) else self._refused(path, error) from None
        except OSError as error:
            raise InputError(f"{path}: {error.strerror or error}; expected {self._expected}") from None
        except (SafetensorError, KeyError, ValueError) as error:
            raise self._refused(path, error) from None
        if not all(torch.isfinite(tensor).all() for tensor in weights.values()):
            raise InputError(f"{path}: weights hold NaN or infinity; expected {self._expected}")
        return weights, config, about

    def load(self, path: Path | str, make: Callable[[Config], Network]) -> Network:
        """Load a network in evaluation mode.

        Args:
            path: The file.
            make: From sizes to a network.

        Raises:
            InputError: If the file can't be read or is no such network.
        """
        weights, config, _ = self.read(path)
        try:
            network = make(config)
            network.load_state_dict(weights)
        except (RuntimeError, ValueError, TypeError) as error:
            raise self._refused(path, error) from None
        return network.eval().requires_grad_(False)

    def _refused(self, path: Path | str, error: Exception) -> InputError:
        return InputError(f"{path}: {' '.join(str(error).split())[:200]}; expected {self._expected}")
