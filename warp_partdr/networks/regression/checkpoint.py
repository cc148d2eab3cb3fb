"""Files of networks: safetensors, with sizes and the record of the training in the file's metadata."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Generic, TypeVar

import torch
from torch.overrides import TorchFunctionMode

from ...errors import InputError, cause
from ...files.disk import check_regular
from ...files.json_files import parse_json
from ...files.sections import read_section
from ...interop.device_cache import device_cache
from ...interop.torch_threads import one_torch_thread
from .ellipbodynet import EllipBodyNet, EllipBodyNetConfig
from .label_network import LabelNetwork, LabelNetworkConfig

MAX_BYTES = 1 << 30
_BITS = (8, 16, 32)
_LARGE = 1 << 16  # weights from which on a matrix is worth a scale for each row
_SCALE = "/scale"  # of a name's rows; names of weights have no slash

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
        bits: int = 32,
    ) -> None:
        """Write a network's ``state_dict`` with its sizes and the record of its training (JSON) to a safetensors file.

        With 16 ``bits``, weights are stored in float16, statistics of batch normalisation as they are; with 8, large
        matrices and filters moreover in bytes, the largest weight of each row being 127.

        Raises:
            InputError: If ``bits`` are others than 8, 16 or 32.
        """
        from safetensors.torch import save_file

        check_weight_bits(bits)
        values = asdict(config)  # type: ignore[call-overload]  # a dataclass
        metadata = {"format": self.kind, "config": json.dumps(values), "about": json.dumps(dict(about))}
        save_file(_packed(weights, bits), path, metadata)

    @one_torch_thread()  # threads that wait for one another take longer than these small products
    def load(self, path: Path | str, *, device: torch.device | str = "cpu") -> Network:
        """Load a network in evaluation mode.

        Raises:
            InputError: If the file can't be read or is no such network.
        """
        from safetensors import SafetensorError, safe_open

        try:
            check_regular(path)
            if Path(path).stat().st_size > MAX_BYTES:
                raise InputError(f"{path}: more than {MAX_BYTES >> 20} MiB; expected {self.expected}")
            with safe_open(path, framework="pt") as file:
                metadata = file.metadata() or {}
                if metadata.get("format") != self.kind:
                    raise InputError(f"{path}: format {metadata.get('format')!r}; expected {self.expected}")
                weights = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  no mapping
            weights = _unpacked(weights)
            if not all(map(_is_finite, weights.values())):
                raise InputError(f"{path}: weights hold NaN or infinity; expected {self.expected}")
            config = read_section(self.sizes, parse_json(metadata["config"], f"{path}: config", self.expected))
            with _NoFirstWeights():
                network = self.make(config)
            network.load_state_dict(weights, assign=True)
        except (OSError, SafetensorError, KeyError, ValueError, TypeError, RuntimeError) as error:
            if isinstance(error, InputError) and str(error).startswith(str(path)):
                raise
            raise InputError(f"{path}: {cause(error)}; expected {self.expected}") from None
        # Convolutions of pictures whose channels lie together take a sixth less time on CPU.
        network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # torch's own stubs lack it
        return network.eval().requires_grad_(False).to(device)


class _NoFirstWeights(TorchFunctionMode):
    """Mode in which networks are made without random weights, which take a quarter of the time of loading one."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        if getattr(func, "__module__", None) == "torch.nn.init":
            return args[0] if args else kwargs["tensor"]
        return func(*args, **(kwargs or {}))


def check_weight_bits(bits: int) -> None:
    """Check in how many bits weights are to be stored; see ``NetworkFiles.save``."""
    if bits not in _BITS:
        raise InputError(f"bits: {bits}; expected 8, 16 or 32")


def _packed(weights: Mapping[str, torch.Tensor], bits: int) -> dict[str, torch.Tensor]:
    packed = {}
    for name, weight in weights.items():
        tensor = weight.detach().cpu().contiguous()
        if bits < 32 and tensor.is_floating_point() and "running" not in name:
            if bits == 8 and tensor.ndim > 1 and tensor.numel() >= _LARGE:
                scale = tensor.flatten(1).abs().amax(1).clamp_min(torch.finfo(torch.float32).tiny) / 127
                packed[name + _SCALE] = scale.float()
                tensor = (tensor / _for_rows(scale, tensor)).round().to(torch.int8)
            else:
                tensor = tensor.half()
        packed[name] = tensor
    return packed


def _unpacked(packed: Mapping[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Weights of a file in float32, in memory of their own, so that a network can take them as they are."""
    scales = {name.removesuffix(_SCALE): scale for name, scale in packed.items() if name.endswith(_SCALE)}
    weights = {}
    for name, tensor in packed.items():
        if name in scales:
            # In bytes, channels are brought to the end, where the network wants them, in a quarter of the time.
            rows = tensor.contiguous(memory_format=torch.channels_last) if tensor.ndim == 4 else tensor
            weights[name] = rows * _for_rows(scales[name], rows)
        elif not name.endswith(_SCALE):
            weights[name] = tensor.to(torch.float32 if tensor.is_floating_point() else tensor.dtype, copy=True)
    return weights


def _is_finite(tensor: torch.Tensor) -> bool:
    """True if a tensor holds neither NaN nor infinity, in a tenth of the time of ``torch.isfinite``."""
    return not tensor.numel() or all(math.isfinite(bound) for bound in tensor.aminmax())


def _for_rows(scale: torch.Tensor, rows: torch.Tensor) -> torch.Tensor:
    return scale.view(-1, *[1] * (rows.ndim - 1))


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

    Examples:
        >>> from warp_partdr import load_label_network
        >>> network = load_label_network()  # load_label_network("model.safetensors") loads your own
        >>> network.training
        False
    """
    packaged = resources.files("warp_partdr").joinpath("assets", "label_network.safetensors")
    with resources.as_file(packaged) as default:
        return _LABEL_NETWORKS.load(default if path is None else path, device=device)


@device_cache(4)
def packaged_network(device: str) -> LabelNetwork:
    """The packaged network, loaded once for each device; not to be changed."""
    return load_label_network(device=device)


def known_network(path: Path | str | None, device: str) -> LabelNetwork:
    """The network of a file, read once while the file stays as it is, or the packaged one; not to be changed.

    Raises:
        InputError: If ``load_label_network`` raises it.
    """
    if path is None:
        return packaged_network(device)
    try:
        found = os.stat(path)
    except OSError:
        return load_label_network(path, device=device)  # which says what is wrong
    return _network_of(str(path), device, found.st_mtime_ns, found.st_size)


@device_cache(4)
def _network_of(path: str, device: str, *state: int) -> LabelNetwork:
    return load_label_network(path, device=device)
