"""Fuzz the public entry points: random shapes, types, values, devices and damaged files.

    python benchmarks/fuzz.py [--cases 10000] [--seed 0] [--only CASE] [--device cpu]

Every case must give a result of finite numbers or an error on purpose: ValueError or OSError from a line of this
package, or a TypeError. Anything else fails: an error out of torch, NumPy or Warp, a bare KeyError, NaN, a crash, or
more than ``PATIENCE`` seconds. Only ``ELEMENTARY`` functions may pass on what was NaN or infinite. A case is told by
seed and number; ``--only`` runs it again, with the trace.
"""

from __future__ import annotations

import argparse
import faulthandler
import multiprocessing
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import torch
import warp as wp
from fuzzing import bodies, files, fits, render, values
from fuzzing.chance import Chance
from fuzzing.outcome import Outcome, UnfitError, check_finite, on_purpose
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

PATIENCE = 60  # [s]

TARGETS: dict[str, Callable[[Chance], Any]] = {
    name.removeprefix("try_"): function
    for module in (render, bodies, fits, files, values)
    for name, function in vars(module).items()
    if name.startswith("try_")
}
ELEMENTARY = {"rotations", "cameras", "prior", "model"}
# How often: the cheap and the much used more.
RATES = {
    "fit_body": 2,
    "register": 1,
    "refine": 3,
    "ellipsoid_label_loss": 8,
    "mesh_label_loss": 8,
    "draw_ellipsoids": 6,
}
TURNS = [name for name in TARGETS for _ in range(RATES.get(name, 4))]


def run_case(seed: int, case: int, device: str) -> Outcome:
    """One case, from its number."""
    rng = np.random.default_rng([seed, case])
    target = TURNS[int(rng.integers(len(TURNS)))]

    def give_up(signum: int, frame: FrameType | None) -> None:
        raise UnfitError(f"still running after {PATIENCE} s")

    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        signal.signal(signal.SIGALRM, give_up)
        signal.alarm(PATIENCE)
        try:
            chance = Chance(rng, Path(folder), device)
            result = TARGETS[target](chance)
            if not (target in ELEMENTARY and chance.extreme):
                check_finite(result)
        except Exception as error:
            if on_purpose(error):
                return Outcome(target, "refused")
            return Outcome(target, f"{type(error).__name__}: {str(error)[:100]}", traceback.format_exc())
        finally:
            signal.alarm(0)
    return Outcome(target, "right")


def _work(seed: int, first: int, cases: int, device: str, results: Any) -> None:
    faulthandler.enable()
    prepare()
    for case in range(first, cases):
        results.put((case, None))
        results.put((case, run_case(seed, case, device)))


def prepare() -> None:
    """Quiet and single-threaded, for tensors are small."""
    wp.config.log_level = wp.LOG_WARNING
    torch.set_num_threads(1)
    np.seterr(all="ignore")


def run_apart(seed: int, cases: int, device: str, tell: Callable[[int, Outcome], None]) -> None:
    """All cases in a process of their own, so that a crash is one more outcome."""
    context = multiprocessing.get_context("spawn")
    first = 0
    while first < cases:
        results = context.SimpleQueue()
        worker = context.Process(target=_work, args=(seed, first, cases, device, results))
        worker.start()
        while worker.is_alive() or not results.empty():
            if results.empty():
                time.sleep(0.001)
                continue
            case, outcome = results.get()
            first = case
            if outcome is not None:
                tell(case, outcome)
                first += 1
        worker.join()
        if first < cases:
            tell(first, Outcome("?", f"crashed, exit code {worker.exitcode}"))
            first += 1


def main() -> int:
    """Run, show a bar and a table; the exit status is 1 where something failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", type=int, metavar="CASE", help="this case alone, in this process, with its trace")
    parser.add_argument("--device", default="cpu")
    options = parser.parse_args()
    console = Console()
    if options.only is not None:
        prepare()
        outcome = run_case(options.seed, options.only, options.device)
        console.print(f"{outcome.target}: {outcome.kind}\n{outcome.trace}", markup=False, highlight=False)
        return int(not outcome.passed)
    started = time.perf_counter()
    counts: dict[str, Counter[str]] = {name: Counter() for name in (*TARGETS, "?")}
    failures: list[tuple[int, Outcome]] = []
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("fuzz", total=options.cases)

        def tell(case: int, outcome: Outcome) -> None:
            counts[outcome.target][outcome.kind if outcome.passed else "failed"] += 1
            if not outcome.passed:
                failures.append((case, outcome))
            bar.update(task, advance=1, description=f"{len(failures)} failed")

        run_apart(options.seed, options.cases, options.device, tell)
    table = Table("entry point", "right", "refused", "failed", title=f"{options.cases} cases, seed {options.seed}")
    for name, count in counts.items():
        if count:
            table.add_row(name, *(str(count[kind]) for kind in ("right", "refused", "failed")))
    console.print(table)
    for case, outcome in failures:
        console.print(f"case {case}: {outcome.target}: {outcome.kind}", markup=False, highlight=False, soft_wrap=True)
    console.print(f"{len(failures)} of {options.cases} failed, {time.perf_counter() - started:.0f} s")
    return int(bool(failures))


if __name__ == "__main__":
    sys.exit(main())
