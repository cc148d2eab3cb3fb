"""How long a whole fit of the example takes, and one refinement of 50 iterations, on the fast path and through torch.

    python benchmarks/fit_speed.py [--device cpu] [--size 256] [--bodies 1 8 64] [--threads 1]

Times are medians of repeated runs, warm: kernels are compiled and loaded before the first one. The kernels alone:
``partdr bench kernels``.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from importlib import resources
from pathlib import Path

import torch
import warp as wp

from warp_partdr.bench.machine import about
from warp_partdr.body.labels import label_set
from warp_partdr.body.pose_prior import PosePrior
from warp_partdr.fit.fitting import fit_body
from warp_partdr.inputs.keypoint_files import read_keypoints
from warp_partdr.inputs.keypoints import choose_person
from warp_partdr.inputs.observation import observe
from warp_partdr.inputs.part_labels import read_parts
from warp_partdr.kernels.launch import set_num_threads
from warp_partdr.refinement.energy import Energy
from warp_partdr.refinement.refine import minimise, refine

EXAMPLE = Path(str(resources.files("warp_partdr"))) / "assets" / "example"


def median_ms(call: Callable[[], object], device: str, *, repeats: int, warmup: int = 2) -> float:
    """Median wall time of a call [ms], device work included."""
    times = []
    for index in range(warmup + repeats):
        started = time.perf_counter()
        call()
        if device != "cpu":
            torch.cuda.synchronize()
        if index >= warmup:
            times.append(1000 * (time.perf_counter() - started))
    return statistics.median(times)


def main() -> None:
    """Measure and print one table, and the same as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--size", type=int, default=256, help="side of the drawn crop [px]")
    parser.add_argument("--bodies", type=int, nargs="*", default=[1, 8, 64])
    parser.add_argument("--threads", type=int, default=0, help="CPU threads that share the bodies; 0: one a core")
    options = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING
    device = options.device
    if device == "cpu":
        torch.set_num_threads(1)  # the tensors are small

    keypoints = choose_person(read_keypoints(EXAMPLE / "keypoints.json"))
    parts = read_parts(EXAMPLE / "parts.png", label_set("cdcl14"))
    seen, _ = observe(keypoints, parts, device=device)
    prior = PosePrior().to(device)
    energy = Energy(seen, options.size, prior=prior)
    set_num_threads(options.threads)
    started = time.perf_counter()
    fitted = fit_body(keypoints, parts, device=device)
    first_fit = time.perf_counter() - started
    figures: dict[str, float] = {"first fit, compiling included [s]": round(first_fit, 2)}
    whole = median_ms(lambda: fit_body(keypoints, parts, device=device), device, repeats=5, warmup=0)
    figures["fit, all hypotheses [s]"] = round(whole / 1000, 2)
    for count in options.bodies:
        bodies = fitted.parameters.select(torch.zeros(count, dtype=torch.long, device=device))
        bodies = replace(bodies, shift=bodies.shift + 0.02)
        for name, function in (("one graph", minimise), ("through torch", refine)):
            ms = median_ms(lambda f=function, b=bodies: f(b, energy, iterations=50), device, repeats=5, warmup=1)
            figures[f"B = {count}: 50 iterations, {name} [s]"] = round(ms / 1000, 4)

    place = {**about(), "device": device, "size": options.size}
    if device != "cpu":
        place["device"] = torch.cuda.get_device_name()
    width = max(map(len, figures))
    print(", ".join(f"{key} {value}" for key, value in place.items()))
    for key, value in figures.items():
        print(f"{key:{width}}  {value}")
    print(json.dumps({**place, **figures}))


if __name__ == "__main__":
    main()
