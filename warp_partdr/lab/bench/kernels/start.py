"""Times from the start of a process: of the first call, with an empty kernel cache and a full one, and of commands.

``python -m warp_partdr.lab.bench.kernels.start DEVICE`` prints the seconds of imports and of the first call in a fresh
process.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

_TIMES = 3  # that a command runs, of which the fastest counts


def time_starts(device: str) -> dict[str, float]:
    """Durations by name [s]: of imports, and of the first call after them, a body's label loss and its gradient.

    Raises:
        RuntimeError: If a process fails.
    """
    with tempfile.TemporaryDirectory() as cache:
        (_, cold), (imports, warm) = (_time_process(device, cache) for _ in range(2))
    return {"imports": imports, "first call, no kernel compiled": cold, "first call, kernels compiled before": warm}


def time_commands(device: str) -> dict[str, float]:
    """Durations by name of commands on the packaged example [s], from start to files, kernels compiled before.

    Raises:
        RuntimeError: If a command fails.
    """
    example = Path(__file__).resolve().parents[3] / "assets" / "example"
    found = {"command, from start to end: --help": _fastest(["--help"])}
    given = [example / "photo.png", "--keypoints", example / "keypoints.json", "--parts", example / "parts.png"]
    with tempfile.TemporaryDirectory() as out:
        fit = ["fit", *map(str, given), "--labels", "cdcl14", "--device", device, "--out", out]
        for name, model in (("with", "anny"), ("without", "none")):
            found[f"command, from start to files: fit {name} the mesh"] = _fastest([*fit, "--model", model])
    return found


def _fastest(words: Sequence[str]) -> float:
    """Least of some durations [s]: what else runs on the machine adds to the others, a first one reads from disk."""
    durations = []
    for _ in range(_TIMES):
        begin = time.perf_counter()
        _run([sys.executable, "-m", __name__.partition(".")[0], *words], os.environ)
        durations.append(time.perf_counter() - begin)
    return min(durations)


def _run(command: Sequence[str], environment: Mapping[str, str]) -> str:
    """Standard output of a command."""
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr.strip()}")
    return done.stdout


def _time_process(device: str, cache: str) -> tuple[float, float]:
    """Seconds of imports and of the first call in a fresh process with a kernel cache."""
    printed = _run([sys.executable, "-m", __name__, device], {**os.environ, "WARP_CACHE_PATH": cache})
    imports, first_call = json.loads(printed.splitlines()[-1])
    return imports, first_call


def time_this_process() -> None:
    """Print the seconds of imports and of the first call, as JSON."""
    begin = time.perf_counter()
    import torch
    import warp as wp

    from ....body.parameters import BodyParameters
    from ....render.ellipsoids import ellipsoid_label_loss

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
