"""Long runs: a refinement of many iterations, threads and CUDA streams that use the library at once.

    python benchmarks/endurance.py [--iterations 100000] [--device cpu] [--threads 8] [--out endurance.json]

* A refinement on the fast path against a small label image, in rounds that go on from where the last one ended:
  resident memory may not grow once the first rounds are over, every energy on the way must be finite, and the best may
  never rise.
* Threads that draw, find losses with every gradient, and refine, all at once: results equal those of one thread to the
  bit.
* On CUDA, the same on two streams.

The exit status is 1 where one of these fails.
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import json
import math
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import torch
import warp as wp
from rich.console import Console
from rich.progress import track

from warp_partdr import label_set, skeleton_arrays
from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.pose_prior import PosePrior
from warp_partdr.body.posing import LandmarkGather
from warp_partdr.cameras import WeakPerspective
from warp_partdr.inputs.observation import Observation
from warp_partdr.refinement.captured import CapturedRefinement
from warp_partdr.refinement.energy import Energy
from warp_partdr.refinement.refine import minimise
from warp_partdr.render.ellipsoids import Ellipsoids, draw_ellipsoids, ellipsoid_label_loss
from warp_partdr.render.mesh import mesh_label_loss
from warp_partdr.render.part_mesh import ellipbody_mesh

ROUND = 500  # iterations
SIZE = 32  # [px]
SETTLED = 0.2  # share of the rounds after which memory may not grow
ALLOWED = 4.0  # [MB] that it may, for allocators keep a little
GRADIENTS = ("edges", "coverage", "partdr")


def observed(device: str, seed: int = 0) -> tuple[BodyParameters, Energy]:
    """A start, and the energy of a body some way off that was seen whole."""
    generator = torch.Generator().manual_seed(seed)
    start = BodyParameters.mean(1, device=device)
    turns = 0.2 * torch.randn(1, 20, 3, generator=generator).to(device)
    truth = replace(start, rotations=turns, shift=torch.tensor([[0.1, -0.05]], device=device))
    names = skeleton_arrays("coco17").landmarks
    points = truth.camera(2).project(LandmarkGather(names, device)(truth.posed()))[0, :, :2] - 1
    labels = draw_ellipsoids(truth.posed(), truth.camera(SIZE), (SIZE, SIZE)).labels[0]
    confidence = torch.ones(len(names), device=device)
    observation = Observation(names, points, confidence, labels, label_set("ellipbody20"))
    return start, Energy(observation, size=SIZE, prior=PosePrior().to(device))


def resident() -> float:
    """Memory of this process [MB], on Linux; freed memory is handed back first."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def memory(device: str) -> float:
    """Resident memory, and on CUDA what this process's allocators hold there [MB]."""
    on_device = 0 if device == "cpu" else torch.cuda.memory_reserved() + wp.get_mempool_used_mem_current(device)
    return resident() + on_device / 1e6


@dataclass(frozen=True)
class Refinement:
    """A long refinement.

    Attributes:
        iterations: Steps in all.
        seconds: Wall time.
        megabytes: Memory after each round.
        energies: The best energy after each round.
    """

    iterations: int
    seconds: float
    megabytes: tuple[float, ...]
    energies: tuple[float, ...]

    @property
    def growth(self) -> float:
        """Of memory, after the first rounds [MB]."""
        settled = int(SETTLED * len(self.megabytes))
        return max(self.megabytes[settled:]) - self.megabytes[settled]

    @property
    def is_steady(self) -> bool:
        """Whether memory stays, and the energy stays finite and never rises."""
        pairs = zip(self.energies[:-1], self.energies[1:], strict=True)
        return self.growth <= ALLOWED and all(after <= before * (1 + 1e-6) for before, after in pairs)


def refine_long(iterations: int, device: str, rounds: Callable[[range], Iterator[int]] = iter) -> Refinement:
    """Refine in rounds of ``ROUND`` iterations, each from the best body of the one before."""
    bodies, energy = observed(device)
    fused = CapturedRefinement(energy, 1, iterations=ROUND)
    megabytes, energies = [], []
    started = time.perf_counter()
    for _ in rounds(range(max(iterations // ROUND, 1))):
        refined = fused.refine(bodies)
        bodies = refined.parameters
        energies.append(float(refined.energy) if torch.isfinite(refined.history).all() else math.nan)
        megabytes.append(memory(device))
    return Refinement(ROUND * len(energies), time.perf_counter() - started, tuple(megabytes), tuple(energies))


def everything(device: str, seed: int) -> list[torch.Tensor]:
    """What a thread does: both renderers' losses and gradients, a picture, and a refinement, of a body of its own."""
    start, energy = observed(device, seed)
    assert energy.target is not None
    camera = WeakPerspective(torch.full((1,), 14.0 + seed, device=device), torch.full((1, 2), 15.0, device=device))
    posed = start.posed()
    found = [draw_ellipsoids(posed, camera, (SIZE, SIZE)).labels]
    for gradient in GRADIENTS:
        leaves = [getattr(posed, name).detach().requires_grad_() for name in ("centres", "axes", "semi_axes")]
        loss, _ = ellipsoid_label_loss(Ellipsoids(*leaves), camera, energy.target[None], gradient=gradient)
        found += [loss.detach(), *torch.autograd.grad(loss.sum(), leaves)]
    vertices = posed.vertices(1).detach().requires_grad_()
    loss, _ = mesh_label_loss(vertices, ellipbody_mesh(1, device=device), camera, energy.target[None])
    found.append(loss.detach())
    if device == "cpu":  # on CUDA, atomics add in any order
        found += torch.autograd.grad(loss.sum(), vertices)
    refined = minimise(start, energy, iterations=5)
    return [*found, refined.energy, *refined.parameters.tensors().values()]


def side_by_side(device: str, threads: int, rounds: int) -> int:
    """How many results of threads differ from those of one thread; on CUDA every thread has a stream of its own."""
    want = [everything(device, seed) for seed in range(threads)]
    if device != "cpu":
        torch.cuda.synchronize()

    def work(seed: int) -> int:
        different = 0
        stream = None if device == "cpu" else torch.cuda.Stream()
        for _ in range(rounds):
            with torch.cuda.stream(stream):
                have = everything(device, seed)
                different += not all(torch.equal(a, b) for a, b in zip(have, want[seed], strict=True))
        return different

    with ThreadPoolExecutor(threads) as pool:
        return sum(pool.map(work, range(threads)))


def main() -> int:
    """Run and report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--iterations", type=int, default=100_000)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--threads", type=int, default=8, help="on CUDA two, a stream each")
    parser.add_argument("--rounds", type=int, default=20, help="of each thread")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING
    torch.set_num_threads(1)
    console = Console()
    run = refine_long(
        options.iterations,
        options.device,
        lambda rounds: iter(track(rounds, description="refining", console=console, transient=True)),
    )
    console.print(
        f"{run.iterations} iterations in {run.seconds:.0f} s: energy {run.energies[0]:.4f} to {run.energies[-1]:.4f}, "
        f"memory {run.megabytes[0]:.1f} to {run.megabytes[-1]:.1f} MB, {run.growth:.2f} MB more after the first rounds:"
        f" {'steady' if run.is_steady else 'NOT STEADY'}"
    )
    threads = options.threads if options.device == "cpu" else 2
    different = side_by_side(options.device, threads, options.rounds)
    console.print(f"{threads} threads, {options.rounds} rounds each: {different} differ from one thread's")
    if options.out:
        options.out.write_text(json.dumps({**asdict(run), "threads": threads, "different": different}))
    return int(not run.is_steady or different > 0)


if __name__ == "__main__":
    sys.exit(main())
