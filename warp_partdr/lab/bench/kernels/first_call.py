"""Times of ``fit_photo`` in fresh processes: its first call, a photo of another size, and later calls.

``python -m warp_partdr.lab.bench.kernels.first_call DEVICE`` prints the durations in its own process, as JSON.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

EXAMPLE = Path(__file__).resolve().parents[3] / "assets" / "example" / "photo.png"
_TIMES = 3  # fresh processes, after one that compiles the kernels and does not count
_LATER = 5  # later calls with the photos that are known
FIRST, OTHER, LATER = "first call", "first photo of another size and number of people", "later call"


def time_first_calls(device: str) -> dict[str, list[float]]:
    """Durations of ``fit_photo`` by name [s], one of each fresh process; kernels were compiled before.

    Imports of torch, Warp and ``fit_photo`` count as a row of their own, "imports".

    Raises:
        RuntimeError: If a process fails.
    """
    processes = [_time_process(device) for _ in range(1 + _TIMES)][1:]
    return {name: [each[name] for each in processes] for name in processes[0]}


def _time_process(device: str) -> dict[str, float]:
    command = [sys.executable, "-m", __name__, device]
    done = subprocess.run(command, env=os.environ, capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr.strip()}")
    durations: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return durations


def time_calls_here(device: str) -> dict[str, float]:
    """Durations of imports and calls in this process by name [s]."""
    begin = time.perf_counter()
    import torch
    import warp as wp

    from ....inputs.part_labels import read_photo
    from ....pipelines.photo import fit_photo

    wp.config.log_level = wp.LOG_ERROR

    def timed(photo: np.ndarray) -> float:
        start = time.perf_counter()
        fit_photo(photo, device=device)
        if torch.device(device).type == "cuda":
            torch.cuda.synchronize(device)
        return time.perf_counter() - start

    durations = {"imports": time.perf_counter() - begin}
    one = read_photo(EXAMPLE)
    three = np.concatenate([one, one[:, ::-1], one], axis=1)  # three people
    durations[FIRST] = timed(one)
    durations[OTHER] = timed(three)
    timed(one)  # what is captured is captured at the second call
    durations[LATER] = float(np.median([timed(one) for _ in range(_LATER)]))
    return durations


if __name__ == "__main__":
    print(json.dumps(time_calls_here(sys.argv[1])))
