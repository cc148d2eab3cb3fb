"""The machine and the versions that a figure belongs to."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Mapping
from pathlib import Path

import torch
import warp as wp

from ... import __version__
from .timing import device_sample, repeat

_COPIED = {"cpu": 1 << 26, "cuda": 1 << 29}  # [bytes], several times the caches


def about(device: str = "cpu") -> dict[str, str]:
    """Machine and versions by name."""
    processor = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")  # Linux says the name nowhere else.
    if cpuinfo.exists():
        names = [line.partition(":")[2].strip() for line in cpuinfo.read_text().splitlines() if "model name" in line]
        processor = names[0] if names else processor
    where = {
        "date": time.strftime("%Y-%m-%d"),
        "machine": f"{processor}, {platform.machine()}, {os.cpu_count()} cores",
    }
    if device != "cpu":
        cuda = wp.get_cuda_driver_version() or ()
        where["gpu"] = f"{wp.get_device(device).name}, driver for CUDA {'.'.join(map(str, cuda))}"
    return {
        **where,
        "warp-partdr": __version__,
        "warp": wp.config.version,
        "torch": torch.__version__,
        "python": platform.python_version(),
    }


def in_words(machine: Mapping[str, str]) -> str:
    """One line of what ``about`` returns."""
    return ", ".join(value if key == "machine" else f"{key} {value}" for key, value in machine.items())


def copy_bandwidth(device: str, budget: float) -> float:
    """Bytes read and written a second at best when memory is copied within the device [B/s]; on the CPU by one core.

    The copy is not part of a graph: as a node of a CUDA graph it reaches two thirds of its speed.
    """
    size = _COPIED["cpu" if wp.get_device(device).is_cpu else "cuda"]
    source, target = (wp.zeros(size, dtype=wp.uint8, device=device) for _ in range(2))
    wp.synchronize_device(device)
    return 2 * size / repeat(device_sample(lambda: wp.copy(target, source), device), budget).fastest
