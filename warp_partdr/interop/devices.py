"""Choice of the device that a command runs on."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

from ..errors import InputError


def choose_device(name: str) -> str:
    """Choose the device that ``--device`` names, or the best there is; Warp then prints nothing but warnings.

    Args:
        name: Name of the device: "auto", "cpu", "cuda" or "cuda:N".

    Raises:
        InputError: If torch or Warp has no such device here.
    """
    import torch
    import warp as wp

    wp.config.log_level = wp.LOG_WARNING
    with without_driver_warning():
        wp.init()
    count = min(torch.cuda.device_count(), wp.get_cuda_device_count())
    if name == "auto":
        return "cuda" if count else "cpu"
    devices = ["cpu", *(["cuda"] if count else []), *(f"cuda:{index}" for index in range(count))]
    if name not in devices:
        raise InputError(f"--device: {name}; expected auto or {' or '.join(devices)}, which is what this machine has")
    return name


@contextmanager
def without_driver_warning() -> Iterator[None]:
    """Suppress the line on stderr that Warp finds no CUDA driver, which Python's settings can't suppress."""
    stderr = os.dup(2)
    with tempfile.TemporaryFile() as written:
        os.dup2(written.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
            written.seek(0)
            for line in written:
                if b"find or load the NVIDIA CUDA driver" not in line:
                    os.write(2, line)
