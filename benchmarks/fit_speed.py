"""How long fitting takes: one refinement of 50 iterations, the steps inside it, and a whole fit of the example.

    python benchmarks/fit_speed.py [--device cpu] [--size 256] [--bodies 1 8 64]

Times are medians of repeated runs, warm: kernels are compiled and loaded before the first one.
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from importlib import resources
from pathlib import Path

import torch
import warp as wp

from warp_partdr.body.labels import label_set
from warp_partdr.energy import Energy
from warp_partdr.fitting import fit_body, observe
from warp_partdr.inputs import choose_person, read_keypoints, read_parts
from warp_partdr.mesh import ellipbody_mesh
from warp_partdr.pose_prior import PosePrior
from warp_partdr.refinement import refine
from warp_partdr.render import label_loss, rasterize_parts

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
    parser.add_argument("--fit", action=argparse.BooleanOptionalAction, default=True, help="also a whole fit")
    options = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING
    device = options.device
    if device == "cpu":
        torch.set_num_threads(1)  # the tensors are small

    keypoints = choose_person(read_keypoints(EXAMPLE / "keypoints.json"))
    parts = read_parts(EXAMPLE / "parts.png", label_set("cdcl14"))
    seen, _ = observe(keypoints, parts, device=device)
    prior = PosePrior().to(device)
    energy = Energy(seen, options.size, 1, prior=prior)
    started = time.perf_counter()
    fitted = fit_body(keypoints, parts, device=device)
    first_fit = time.perf_counter() - started
    figures: dict[str, float] = {"first fit, compiling included [s]": round(first_fit, 2)}
    if options.fit:
        whole = median_ms(lambda: fit_body(keypoints, parts, device=device), device, repeats=3, warmup=0)
        figures["fit, all hypotheses [s]"] = round(whole / 1000, 2)
    target = energy._target
    assert target is not None
    mesh = ellipbody_mesh(1, device=device).relabel(label_set("cdcl14").part_groups)
    for count in options.bodies:
        bodies = fitted.parameters.select(torch.zeros(count, dtype=torch.long, device=device))
        bodies = replace(bodies, shift=bodies.shift + 0.02)
        vertices = bodies.camera(options.size).project(bodies.posed().vertices(1)).detach().requires_grad_()
        batch_target = target.expand(count, -1, -1).contiguous()

        def forward(v: torch.Tensor = vertices) -> object:
            return rasterize_parts(v, mesh, (options.size, options.size), validate=False)

        def forward_backward(v: torch.Tensor = vertices, t: torch.Tensor = batch_target) -> object:
            return torch.autograd.grad(label_loss(v, mesh, t, validate=False)[0].sum(), v)

        name = f"B = {count}: "
        figures[name + "render E1 [ms]"] = round(median_ms(forward, device, repeats=20), 3)
        figures[name + "render, L_seg, gradient [ms]"] = round(median_ms(forward_backward, device, repeats=20), 3)
        ms = median_ms(lambda b=bodies: refine(b, energy, iterations=50), device, repeats=5, warmup=1)
        figures[name + "50 iterations of refinement [s]"] = round(ms / 1000, 3)

    place = platform.processor() or platform.machine()
    if device != "cpu":
        place = torch.cuda.get_device_name()
    about = {"device": place, "size": options.size, "warp": wp.config.version, "torch": torch.__version__}
    width = max(map(len, figures))
    print(", ".join(f"{key} {value}" for key, value in about.items()))
    for key, value in figures.items():
        print(f"{key:{width}}  {value}")
    print(json.dumps({**about, **figures}))


if __name__ == "__main__":
    main()
