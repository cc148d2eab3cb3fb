"""Time of the first call: with an empty kernel cache, which compiles, and with what that left behind.

``python -m warp_partdr.bench.kernels.start DEVICE`` prints the seconds of imports and of the first call in a fresh
process.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time


def time_starts(device: str) -> dict[str, float]:
    """Durations by name [s]: of imports, and of the first call after them, a body's label loss and its gradient.

    Raises:
        RuntimeError: If a process fails.
    """
    with tempfile.TemporaryDirectory() as cache:
        (_, cold), (imports, warm) = (_time_process(device, cache) for _ in range(2))
    return {"imports": imports, "first call, no kernel compiled": cold, "first call, kernels compiled before": warm}


def _time_process(device: str, cache: str) -> tuple[float, float]:
    """Seconds of imports and of the first call in a fresh process with a kernel cache."""
    command = [sys.executable, "-m", __name__, device]
    done = subprocess.run(command, env={**os.environ, "WARP_CACHE_PATH": cache}, capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr.strip()}")
    imports, first_call = json.loads(done.stdout.splitlines()[-1])
    return imports, first_call


def time_this_process() -> None:
    """Print the seconds of imports and of the first call, as JSON."""
    begin = time.perf_counter()
    import torch
    import warp as wp

    from ...body.parameters import BodyParameters
    from ...render.ellipsoids import ellipsoid_label_loss

    wp.config.log_level = wp.LOG_ERROR
    imported = time.perf_counter()
    device = sys.argv[1]
    bodies = BodyParameters.mean(1, device=device).leaves()
    target = torch.zeros(1, 256, 256, dtype=torch.uint8, device=device)
    loss, _ = ellipsoid_label_loss(bodies.posed(), bodies.camera(256), target)
    loss.sum().backward()
    wp.synchronize_device(wp.device_from_torch(bodies.shift.device))
    print(json.dumps([imported - begin, time.perf_counter() - imported]))


if __name__ == "__main__":
    time_this_process()
