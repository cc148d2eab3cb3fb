"""Packaged networks of the detection: graphs in safetensors files, whose weights may be stored in 8 bits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any

import torch

from ...errors import InputError, cause
from ...files.json_files import parse_json
from ...interop.device_cache import device_cache
from ...interop.torch_threads import one_torch_thread
from . import LandmarkNetwork
from .graph import Node, OperatorGraph
from .heavy_network import HeavyNetwork, load_part_head
from .product_graph import ProductGraph

_FORMAT = "warp-partdr people detector 1"
_EXPECTED = "a file of scripts/pack_detector.py (safetensors)"


@dataclass(frozen=True)
class PeopleNetworks:
    """Networks that find people, on one device.

    Attributes:
        detector: Network from pictures, from -1 to 1, to the maps that ``read_people`` takes, (B, C, 64, 64).
        landmarks: Network from pictures, from 0 to 1, to "landmarks" (B, 195), five numbers [px] for each of 39
            landmarks, to "presence" (B, 1), 0 to 1, and to the logits "mask" (B, 1, 256, 256) and "heat"
            (B, 39, 64, 64).
        heavy: Larger network, whose "landmarks" and "heat" are nearer to the truth, with the part head. If it is None,
            those of ``landmarks`` are taken, and no parts are seen.
    """

    detector: OperatorGraph
    landmarks: OperatorGraph
    heavy: HeavyNetwork | None = None

    @property
    def device(self) -> torch.device:
        """Device of the weights."""
        return next(self.detector.buffers()).device

    def halved(self) -> PeopleNetworks:
        """Networks in float16, for CUDA; keypoints move by 0.2 % of a person's height (see the model card)."""
        heavy = None if self.heavy is None else self.heavy.halved()
        networks = ProductGraph(self.detector, torch.float16), ProductGraph(self.landmarks, torch.float16)
        return PeopleNetworks(*networks, heavy)


def load_people_networks(path: Path | str | None = None, *, device: torch.device | str = "cpu") -> PeopleNetworks:
    """Load the detector and the network "full".

    Args:
        path: A file of ``scripts/pack_detector.py``; the packaged one if None.
        device: Device to run on.

    Raises:
        InputError: If the file can't be read, or is not a file of these networks.
    """
    detector = _load_network(path, "people_detector.safetensors", "detector", device)
    return PeopleNetworks(detector, _load_network(None, "full_landmarks.safetensors", "landmarks", device))


def load_heavy_landmarks(path: Path | str | None = None, *, device: torch.device | str = "cpu") -> OperatorGraph:
    """Load the larger landmark network of ``PeopleNetworks.heavy``. Arguments are those of ``load_people_networks``."""
    return _load_network(path, "heavy_landmarks.safetensors", "heavy", device)


def packaged_people_networks(device: str, *, half: bool = False, landmarks: LandmarkNetwork = "full") -> PeopleNetworks:
    """Load the packaged networks, once for each device and precision. They must not be changed.

    Args:
        device: Device to run on.
        half: True for networks in float16.
        landmarks: Network whose landmarks are taken. "heavy" loads that network, too.
    """
    return replace(_packaged(device, half), heavy=_packaged_heavy(device, half) if landmarks == "heavy" else None)


@device_cache(8)
def _packaged(device: str, half: bool) -> PeopleNetworks:
    return _packaged(device, False).halved() if half else load_people_networks(device=device)


@device_cache(8)
def _packaged_heavy(device: str, half: bool) -> HeavyNetwork:
    if half:
        return _packaged_heavy(device, False).halved()
    return HeavyNetwork(load_heavy_landmarks(device=device), load_part_head(device=device))


@one_torch_thread()  # threads that wait for one another take longer than these small products
def _load_network(path: Path | str | None, packaged: str, name: str, device: torch.device | str) -> OperatorGraph:
    """Load a network from a file, or from the packaged file. On CUDA it is a ``ProductGraph``."""
    with resources.as_file(resources.files("warp_partdr").joinpath("assets", packaged)) as default:
        graph = _read(Path(default if path is None else path), name).to(device)
    return ProductGraph(graph) if torch.device(device).type == "cuda" else graph


def _read(path: Path, name: str) -> OperatorGraph:
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            if metadata.get("format") != _FORMAT:
                raise InputError(f"{path}: format {metadata.get('format')!r}; expected {_EXPECTED}")
            weights = _whole_weights({key: file.get_tensor(key) for key in file.keys()})  # noqa: SIM118  no mapping
        graphs = parse_json(metadata["graphs"], f"{path}: graphs", _EXPECTED)
        return _graph(graphs[name], name, weights)
    except (OSError, SafetensorError, KeyError, ValueError, TypeError) as error:
        if isinstance(error, InputError) and str(error).startswith(str(path)):
            raise
        raise InputError(f"{path}: {cause(error)}; expected {_EXPECTED}") from None


def _graph(about: Mapping[str, Any], name: str, weights: Mapping[str, torch.Tensor]) -> OperatorGraph:
    own = {key.removeprefix(f"{name}/"): value for key, value in weights.items() if name + "/" in key}
    nodes = [Node.from_json(node) for node in about["nodes"]]
    return OperatorGraph(about["size"], about["input"], about["outputs"], nodes, own)


def _whole_weights(tensors: Mapping[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Arrays of the file in float32, in memory of their own. Arrays of 8 bits are multiplied by their scale."""
    arrays = {}
    for name, values in tensors.items():
        stem, _, role = name.rpartition(".")
        if role == "int8":
            # In bytes, channels are brought to the end, where the graph wants them, in a quarter of the time.
            small = values.contiguous(memory_format=torch.channels_last)
            arrays[stem] = small * tensors[f"{stem}.scale"].view(-1, 1, 1, 1)
        elif role != "scale":
            arrays[name] = values.to(torch.float32, copy=True)
    return arrays
