"""Time of whole programs, from their start to their files, over the time that their imports alone take.

Programs take turns, so that a machine that is faster or slower for a while is so for all of them. Shown are medians of
rounds, and medians of the rounds' ratios to importing torch, Warp and NumPy. The first round, which compiles kernels
and fills caches, does not count. CPU seconds are those of all threads. ``PYTHONDONTWRITEBYTECODE`` is taken out of the
programs' environment: with it, each start would compile all sources anew.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import InputError, check_whole
from ..options import tracked
from ..tables import FigureTable

_EXAMPLE = Path(__file__).resolve().parents[2] / "assets" / "example"
_PARTDR = ("-m", "warp_partdr")
_COLUMNS = {"program": "", "time [s]": ".2f", "times the imports": ".2f", "CPU [s]": ".2f", "times theirs": ".2f"}


@dataclass(frozen=True)
class _Seconds:
    """Time of one run of a program [s]."""

    wall: float
    cpu: float


def measure_start_to_files(*, rounds: int = 5) -> Iterator[FigureTable]:
    """Run the programs.

    Args:
        rounds: Runs of each program that count.
    """
    check_whole("rounds", rounds, 1)
    with tempfile.TemporaryDirectory() as folder:
        programs = _programs(Path(folder))
        runs = [[_run(program) for program in programs.values()] for _ in tracked(range(rounds + 1))][1:]
    wall = np.array([[run.wall for run in row] for row in runs])  # (rounds, programs)
    cpu = np.array([[run.cpu for run in row] for row in runs])
    wall_ratios, cpu_ratios = wall / wall[:, :1], cpu / cpu[:, :1]
    table = FigureTable(f"{os.cpu_count()} CPU cores, {rounds} rounds", _COLUMNS)
    for index, name in enumerate(programs):
        medians = [float(np.median(each[:, index])) for each in (wall, wall_ratios, cpu, cpu_ratios)]
        table.add(name, *medians)
    yield table


def _programs(folder: Path) -> dict[str, Sequence[str]]:
    """Arguments of Python for each program; the first one is what the others are compared with."""
    photo = str(_EXAMPLE / "photo.png")
    keypoints = str(_EXAMPLE / "keypoints.json")
    parts = str(_EXAMPLE / "parts.png")
    labels = ("--keypoints", keypoints, "--parts", parts, "--labels", "cdcl14")
    return {
        "import torch, warp, numpy": ("-c", "import torch, warp, numpy"),
        "import warp_partdr": ("-c", "import warp_partdr"),
        "partdr --help": (*_PARTDR, "--help"),
        "partdr fit, the photo alone": (*_PARTDR, "fit", photo, "--out", str(folder / "photo")),
        "partdr fit, with keypoints and labels": (*_PARTDR, "fit", photo, *labels, "--out", str(folder / "labels")),
    }


def _run(arguments: Sequence[str]) -> _Seconds:
    """Run a program, which keeps its compiled modules as those of users do."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    before, start = os.times(), time.perf_counter()
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, env=environment)
    wall, after = time.perf_counter() - start, os.times()
    if done.returncode:
        raise InputError(f"{' '.join(arguments)}: exit code {done.returncode}: {done.stderr.strip()[-500:]}")
    user, system = after.children_user - before.children_user, after.children_system - before.children_system
    return _Seconds(wall, user + system)
