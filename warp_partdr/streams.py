"""Where a Warp launch goes: the device of the tensors, on torch's current stream."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch
import warp as wp


@contextmanager
def on_torch_stream(device: torch.device) -> Iterator[str]:
    """Launch on torch's current stream of ``device``; yields the Warp device's alias.

    Raises:
        ValueError: If Warp has no such device.
    """
    if device.type not in ("cpu", "cuda"):
        raise ValueError(f"device: {device}; expected a cpu or cuda device")
    wp.init()  # does nothing the second time; device_from_torch relies on it
    warp_device = wp.device_from_torch(device)
    if warp_device.is_cpu:
        yield warp_device.alias
        return
    torch_stream = torch.cuda.current_stream(device)
    if wp.get_stream(warp_device).cuda_stream == torch_stream.cuda_stream:
        with wp.ScopedDevice(warp_device):
            yield warp_device.alias
    else:
        with wp.ScopedStream(wp.stream_from_torch(torch_stream), sync_enter=False):
            yield warp_device.alias
