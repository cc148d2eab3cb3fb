"""Files of packed networks: packages that hold networks, and the safetensors files that they become."""

from __future__ import annotations

import json
import subprocess
import tarfile
import zipfile
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import save

ASSETS = Path(__file__).resolve().parents[1] / "warp_partdr" / "assets"
FORMAT = "warp-partdr people detector 1"

Operator = dict[str, Any]


@dataclass(frozen=True)
class Package:
    """A package that holds networks.

    Attributes:
        name: Name and version.
        pattern: Pattern of its file's name.
        fetch: Command that writes the file into the folder where it runs.
    """

    name: str
    pattern: str
    fetch: tuple[str, ...]

    def read(self, folder: Path, files: Mapping[str, str]) -> dict[str, bytes]:
        """Contents of some of its files, by the names that they are given; the folder gets the package if it lacks it.

        Args:
            folder: Folder of the package's file.
            files: Path of each file in the package, by its name.
        """
        if not list(folder.glob(self.pattern)):
            subprocess.run(self.fetch, check=True, cwd=folder)
        (path,) = folder.glob(self.pattern)
        if path.suffix == ".whl":
            with zipfile.ZipFile(path) as wheel:
                return {name: wheel.read(file) for name, file in files.items()}
        with tarfile.open(path) as package:
            found = {name: package.extractfile(file) for name, file in files.items()}
            return {name: file.read() for name, file in found.items() if file is not None}


def same_zeros(size: tuple[int, int], kernel: tuple[int, int], strides: tuple[int, int]) -> list[int]:
    """Zeros left, right, above and below that let ceil(size / stride) windows fit, as padding "same" has them.

    Args:
        size: Height and width of the picture.
        kernel: Height and width of the window.
        strides: Strides down and across.
    """
    zeros: list[int] = []
    for length, window, stride in zip(size[::-1], kernel[::-1], strides[::-1], strict=True):
        missing = max((-(-length // stride) - 1) * stride + window - length, 0)
        zeros += [missing // 2, missing - missing // 2]
    return zeros


def write_graphs(
    target: str, graphs: Mapping[str, Mapping[str, Any]], tensors: Mapping[str, np.ndarray], about: str
) -> None:
    """Write networks into a file of ``assets``.

    Args:
        target: Name of the file.
        graphs: Graph of each network, by name.
        tensors: Weights "NETWORK/N.weight" and "NETWORK/N.bias".
        about: Sentence about their origin and licence.
    """
    content = save(
        {name: np.ascontiguousarray(values) for name, values in tensors.items()},
        {"format": FORMAT, "graphs": json.dumps(graphs), "about": about},
    )
    (ASSETS / target).write_bytes(_sort_header(content))
    for name, graph in graphs.items():
        print(name, dict(Counter(node["kind"] for node in graph["nodes"])))
    print(f"{target}: {(ASSETS / target).stat().st_size / 1e6:.2f} MB, {len(tensors)} tensors")


def _sort_header(content: bytes) -> bytes:
    """A safetensors file with its header in order, which otherwise changes from run to run."""
    start = 8 + int.from_bytes(content[:8], "little")
    header = json.dumps(json.loads(content[8:start]), sort_keys=True, separators=(",", ":")).encode()
    header += b" " * (-len(header) % 8)
    return len(header).to_bytes(8, "little") + header + content[start:]
