"""Landmark network "heavy" together with the part head, which looks at its features: one pass gives both."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import nullcontext
from importlib import resources
from pathlib import Path
from typing import Any

import torch

from ...interop.captured_call import call_as_graph
from ...interop.precision import exact_convolutions
from ..regression.checkpoint import NetworkFiles
from .graph import OperatorGraph
from .part_head import MOST_WINDOWS, TAPS, PartHead, PartHeadConfig
from .product_graph import ProductGraph

_FILES = NetworkFiles(
    "warp-partdr part head 1", PartHead, PartHeadConfig, "a part head of `partdr train parts` (safetensors)"
)
save_part_head = _FILES.save


def load_part_head(path: Path | str | None = None, *, device: torch.device | str = "cpu") -> PartHead:
    """Load a part head in evaluation mode.

    Args:
        path: File of ``partdr train parts``; the packaged one if None.
        device: Device to run on.

    Raises:
        InputError: If the file can't be read or is no such network.
    """
    with resources.as_file(resources.files("warp_partdr").joinpath("assets", "part_head.safetensors")) as default:
        return _FILES.load(default if path is None else path, device=device)


def with_features(graph: OperatorGraph, *, half: bool = False) -> OperatorGraph:
    """The landmark network "heavy", which shows the values of ``TAPS``, too; on CUDA in float16 if ``half``."""
    shown = graph.showing({str(number): number for numbers in TAPS.values() for number in numbers})
    if not next(graph.buffers()).is_cuda:
        return shown
    return ProductGraph(shown, torch.float16 if half else torch.float32)


def join_features(values: Mapping[str, torch.Tensor]) -> dict[int, torch.Tensor]:
    """Features that a part head looks at, from the values of a graph of ``with_features``."""
    return {side: torch.cat([values[str(number)] for number in numbers], dim=1) for side, numbers in TAPS.items()}


class HeavyNetwork(torch.nn.Module):
    """Landmark network and part head.

    Args:
        graph: Landmark network "heavy".
        head: Part head on the same device.
        half: True runs both in float16, on CUDA.

    Attributes:
        size: Side of the square pictures that it takes [px].
    """

    def __init__(self, graph: OperatorGraph, head: PartHead, *, half: bool = False) -> None:
        super().__init__()
        self.size = graph.size
        self._plain, self._half = graph, half
        self._graph = with_features(graph, half=half)
        self._trained, self._head = head, head.folded()

    def halved(self) -> HeavyNetwork:
        """Copy in float16, for CUDA."""
        return HeavyNetwork(self._plain, self._trained, half=True)

    def forward(self, pictures: torch.Tensor) -> dict[str, torch.Tensor]:
        """Outputs of the landmark network, and of the head.

        Args:
            pictures: Pictures, from 0 to 1, shape (B, 3, 256, 256).

        Returns:
            Values by name: "landmarks" and "heat" as of ``PeopleNetworks``; "parts", probabilities of background and
            the 20 parts, shape (B, 21, 128, 128); and "joints", x and y from 0 to 1 across the picture, (B, 21, 2).
        """
        values = self._graph(pictures)
        features = join_features(values)
        given = *(features[side] for side in TAPS), values["landmarks"], pictures
        few = len(pictures) <= MOST_WINDOWS  # whose launches take longer than their work
        # On the CPU, several threads look at a time, which must not change torch's settings.
        exact = exact_convolutions() if pictures.is_cuda else nullcontext()
        with torch.autocast(pictures.device.type, torch.float16, enabled=self._half), exact:
            parts, joints = call_as_graph(_see, given, self._head) if few else _see(*given, self._head)
        found = {name: values[name] for name in self._plain.outputs}
        return found | {"parts": parts, "joints": joints}


def _see(*given: Any) -> tuple[torch.Tensor, torch.Tensor]:
    """Probabilities of parts, and joints, from features by their sides, landmarks, pictures and a part head."""
    *features, landmarks, pictures, head = given
    seen = head(dict(zip(TAPS, features, strict=True)), landmarks, pictures)
    return seen.logits.float().softmax(1), seen.joints
