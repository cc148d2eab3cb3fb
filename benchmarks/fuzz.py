"""Fuzz the public entry points: random shapes, types, values, devices and damaged files.

    python benchmarks/fuzz.py [--cases 10000] [--seed 0] [--only ENTRY_POINT] [--device cpu]

Every case must give a result of finite numbers or an error on purpose: ValueError or OSError from a line of this
package, or a TypeError. Anything else fails: an error out of torch, NumPy or Warp, a bare KeyError, NaN, a crash, or
more than ``PATIENCE`` seconds. Only ``ELEMENTARY`` functions may pass on what was NaN or infinite. Hypothesis draws the
cases, the same ones for the same seed, and shows the smallest case that fails, with its trace.
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
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import torch
import warp as wp
from fuzzing import bodies, files, fits, render, values
from fuzzing.case import Case
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from hypothesis.errors import HypothesisException
from rich.console import Console
from rich.progress import track
from rich.table import Table

PATIENCE = 60  # [s]

TARGETS: dict[str, Callable[[Case], Any]] = {
    name.removeprefix("try_"): function
    for module in (render, bodies, fits, files, values)
    for name, function in vars(module).items()
    if name.startswith("try_")
}
ELEMENTARY = {"rotations", "cameras", "prior", "model"}
# How often: the cheap and the much used more.
RATES = dict.fromkeys(TARGETS, 4) | {"fit_body": 2, "register": 1, "refine": 3}
RATES |= {"ellipsoid_label_loss": 8, "mesh_label_loss": 8, "draw_ellipsoids": 6}

PACKAGE = {
    Path(sys.modules[name].__file__ or "").resolve().parent
    for name in ("warp_partdr", "warp_partdr.body.template", "warp_partdr.kernels.launch")
}


class UnfitError(AssertionError):
    """A result that is none."""


@dataclass
class Outcome:
    """Cases of one entry point: how many were right, how many refused on purpose, and the trace of one that failed."""

    counts: Counter[str] = field(default_factory=Counter)
    trace: str = ""


def fuzz(name: str, cases: int, number: int, device: str) -> Outcome:
    """Try an entry point with cases of a seed."""
    outcome = Outcome()

    @seed(number)
    @settings(
        max_examples=cases,
        database=None,
        deadline=None,
        phases=[Phase.generate, Phase.shrink],
        suppress_health_check=list(HealthCheck),
    )
    @given(st.data())
    def run_cases(data: st.DataObject) -> None:
        with tempfile.TemporaryDirectory() as folder:
            outcome.counts[_run_case(name, Case(data.draw, Path(folder), device))] += 1

    try:
        run_cases()
    except BaseExceptionGroup as error:  # more than one fault
        outcome.trace = "".join(traceback.format_exception(error))
    except Exception:
        outcome.trace = traceback.format_exc()
    return outcome


def _run_case(name: str, case: Case) -> str:
    """Return "right" or "refused"; raise what is neither."""
    try:
        with _limited(), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            result = TARGETS[name](case)
    except Exception as error:
        if not on_purpose(error):
            raise
        return "refused"
    if not (name in ELEMENTARY and case.extreme):
        check_finite(result)
    return "right"


@contextmanager
def _limited() -> Iterator[None]:
    def give_up(signum: int, frame: FrameType | None) -> None:
        raise UnfitError(f"still running after {PATIENCE} s")

    signal.signal(signal.SIGALRM, give_up)
    signal.setitimer(signal.ITIMER_REAL, PATIENCE)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)


def check_finite(value: Any, name: str = "result") -> None:
    """Raise UnfitError where a result holds NaN, or infinity that is not the background's depth or a near plane."""
    if isinstance(value, torch.Tensor):
        if value.is_meta:  # it has none
            return
        value = value.detach().cpu()
        value = (value.float() if value.dtype == torch.bfloat16 else value).numpy()
    if isinstance(value, float | np.ndarray | np.generic):
        numbers = np.asarray(value)
        if numbers.dtype.kind in "fc":
            bad = np.isnan(numbers) if name.endswith(("depth", "maps", "near")) else ~np.isfinite(numbers)
            if bad.any():
                raise UnfitError(f"{name}: {numbers[bad][0]}")
    elif is_dataclass(value) and not isinstance(value, type):
        check_finite({each.name: getattr(value, each.name) for each in fields(value)}, name)
    elif isinstance(value, list | tuple):
        check_finite(dict(enumerate(value)), name)
    elif isinstance(value, dict):
        for key, each in value.items():
            check_finite(each, f"{name}.{key}")


def on_purpose(error: Exception) -> bool:
    """True if a line of this package raised it, or Python because of an argument's type."""
    if isinstance(error, HypothesisException):
        return False
    if isinstance(error, TypeError):
        return True
    if not isinstance(error, ValueError | OSError) or not str(error):
        return False
    last = traceback.extract_tb(error.__traceback__)[-1]
    return not PACKAGE.isdisjoint(Path(last.filename).resolve().parents)


def prepare() -> None:
    """Quiet and single-threaded, for tensors are small; a crash leaves its trace."""
    faulthandler.enable()
    wp.config.log_level = wp.LOG_WARNING
    torch.set_num_threads(1)
    np.seterr(all="ignore")


def run_apart(cases: dict[str, int], number: int, device: str, console: Console) -> dict[str, Outcome]:
    """All entry points in a process of their own, so that a crash is one more outcome."""
    outcomes, worker = {}, None
    for name, count in track(cases.items(), "fuzz", console=console, transient=True):
        worker = worker or ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), prepare)
        try:
            outcomes[name] = worker.submit(fuzz, name, count, number, device).result()
        except BrokenProcessPool:
            outcomes[name], worker = Outcome(trace="crashed; its trace is above"), None
    return outcomes


def main() -> int:
    """Run, show a bar and a table; the exit status is 1 where something failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=10_000, help="of all entry points together")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=TARGETS, metavar="ENTRY_POINT", help="its share of the cases alone")
    parser.add_argument("--device", default="cpu")
    options = parser.parse_args()
    console = Console(highlight=False)
    started = time.perf_counter()
    cases = {name: -(-options.cases * rate // sum(RATES.values())) for name, rate in RATES.items()}
    if options.only:
        cases = {options.only: cases[options.only]}
    outcomes = run_apart(cases, options.seed, options.device, console)
    failed = {name: outcome.trace for name, outcome in outcomes.items() if outcome.trace}
    table = Table("entry point", "right", "refused", "", title=f"{sum(cases.values())} cases, seed {options.seed}")
    for name, outcome in outcomes.items():
        right, refused = outcome.counts["right"], outcome.counts["refused"]
        table.add_row(name, str(right), str(refused), "failed" if name in failed else "")
    console.print(table)
    for name, trace in failed.items():
        console.print(f"{name}: {trace}", markup=False, soft_wrap=True)
    console.print(f"{len(failed)} of {len(outcomes)} entry points failed, {time.perf_counter() - started:.0f} s")
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
