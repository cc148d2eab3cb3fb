"""Test that `partdr dataset` loses nobody and repeats nobody, however it is ended; and its speed.

PartBench's people, 40 of them under many names, go into tar files in FOLDER with keypoints and labels. Two in a hundred
are broken, and the last file is cut off. A run on a disk that is too small is followed by runs that are killed at
random times (the first while it starts), and by one that ends. Then rows are counted. The small disk is a tmpfs where
that may be mounted, else a limit on the size of files. On a GPU shards of 5000 pictures take seconds. People are kept
in FOLDER/people.tar, where a machine may find them that can't draw them, without a compiler for its CPU.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import tarfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pyarrow.parquet as pq
from cyclopts import Parameter

from ..options import Device, Settings
from ..people_files import add_file, kept_people
from ..tables import FigureTable

_DISTINCT, _IN_A_TAR, _BROKEN_EVERY = 40, 10_000, 100
_SMALL, _LARGE = "96k", "2g"  # of the disk
_SPEEDS = {"cpu": 30, "cuda": 2000}  # people a second, about: on two cores, and on a GPU with 16


def measure_dataset(
    folder: Path,
    /,
    *,
    count: int = 1000,
    kills: int = 5,
    shard: int = 500,
    settings: Annotated[Settings, Parameter(help="Settings, as `partdr dataset --set` takes them.")] = (),
    device: Device = "cpu",
) -> Iterator[FigureTable]:
    """Run ``partdr dataset`` again and again until it ends.

    Args:
        folder: Folder for the data set and its results.
        count: Number of people.
        kills: Runs that are killed.
        shard: Pictures in a shard of results.
        settings: Settings of each run.
        device: Device of the runs.

    Raises:
        SystemExit: If the rows are not as they should be.
    """
    found = kill_runs(folder, count, kills, shard, settings=settings, device=device)
    table = FigureTable("The data set after all runs", {"": "", "found": ""})
    for name, value in vars(found).items():
        table.add(name.replace("_", " "), str(value))
    yield table
    if found.lost or found.twice or found.strange_errors or found.made_again:
        raise SystemExit("dataset: somebody is lost, there twice, made again, or has an error without a reason")


@dataclass(frozen=True)
class RunsFound:
    """Numbers of what was asked of the runs and of what was found.

    Attributes:
        people: Names of people in the source.
        a_full_disk_said: Exit code and last line of the run on the small disk.
        killed: Runs that were killed.
        shards: Shards of results, and how many of them are from before the last run.
        the_last_run_said: Exit code and first line of the last run.
        rows: Rows of all shards.
        lost: Names without a row.
        twice: Rows beyond the first of a name.
        broken: Names whose files are broken.
        strange_errors: Names that have an error without being broken, or the other way round, or that nobody has.
        made_again: Shards that a later run wrote again.
        left_behind: Other files in the folder of results.
        rows_of_a_person_differ_by: Largest difference of a joint [m].
        seconds: Time of all runs.
        people_a_second: Speed of all runs with their starts.
    """

    people: int
    a_full_disk_said: str
    killed: int
    shards: str
    the_last_run_said: str
    rows: int
    lost: int
    twice: int
    broken: int
    strange_errors: int
    made_again: int
    left_behind: list[str]
    rows_of_a_person_differ_by: float
    seconds: float
    people_a_second: float


def kill_runs(
    folder: Path,
    people: int,
    kills: int,
    shard: int,
    distinct: int = _DISTINCT,
    settings: Sequence[str] = (),
    device: str = "cpu",
) -> RunsFound:
    """Run ``partdr dataset`` on a small disk, kill some runs, let one end, and look at the rows.

    Args:
        folder: Folder for the data set and its results.
        people: Number of people.
        kills: Runs that are killed.
        shard: Pictures in a shard of results.
        distinct: Number of different people.
        settings: Settings of each run.
        device: Device of the runs.
    """
    names, broken = _write_source(folder / "shards", people, distinct)
    out, rng = folder / "out", random.Random(0)
    times: dict[str, int] = {}
    seconds_of_a_shard = shard / _SPEEDS[device.partition(":")[0]]
    line = [sys.executable, "-m", "warp_partdr", "dataset", str(folder / "shards"), "--labels", "ellipbody20"]
    line += ["--quality", "network", "--device", device, "--shard", str(shard), "--out", str(out)]
    line += [word for setting in settings for word in ("--set", setting)]
    started = time.monotonic()
    with _small_disk(out) as grow:
        full = subprocess.run([*grow.before, *line], capture_output=True, text=True)
        grow()
        times |= dict(_shards(out))
        for number in range(kills):
            run = subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            if number:
                _wait_for_another(out, times, run)
                time.sleep(rng.uniform(0.0, seconds_of_a_shard))
            else:
                time.sleep(rng.uniform(1.0, 5.0))
            run.send_signal(signal.SIGKILL)
            run.wait()
            times = {**dict(_shards(out)), **times}
        last = subprocess.run(line, capture_output=True, text=True)
        seconds = time.monotonic() - started
        table = pq.read_table(out, columns=["picture", "person", "error", "joints"])
        after = dict(_shards(out))
        left = [path.name for path in out.iterdir() if not path.name.startswith("part-")]
    pictures = table["picture"].to_pylist()
    counts = Counter(pictures)
    errors = {name for name, error in zip(pictures, table["error"].to_pylist(), strict=True) if error}
    return RunsFound(
        people=people,
        a_full_disk_said=f"exit code {full.returncode}, {full.stderr.strip().splitlines()[-1]}",
        killed=kills,
        shards=f"{len(after)}, of which {len(times)} before the last run",
        the_last_run_said=f"exit code {last.returncode}, {last.stdout.strip().splitlines()[:1]}",
        rows=table.num_rows,
        lost=len(names - counts.keys()),
        twice=sum(count - 1 for count in counts.values()),
        broken=len(broken),
        strange_errors=len(errors ^ broken) + len(counts.keys() - names),
        made_again=sum(after.get(name) != when for name, when in times.items()),
        left_behind=left,
        rows_of_a_person_differ_by=_largest_difference(table, distinct),
        seconds=round(seconds, 1),
        people_a_second=round(people / seconds, 1),
    )


def _write_source(folder: Path, people: int, distinct: int) -> tuple[set[str], set[str]]:
    """Write the tar files; names of all rows that are expected, and of those with an error."""
    folder.mkdir(parents=True, exist_ok=True)
    samples = kept_people(folder.parent, distinct)
    names, broken = set(), set()
    for first in range(0, people, _IN_A_TAR):
        path = folder / f"{first // _IN_A_TAR:03}.tar"
        with tarfile.open(path, "w") as tar:
            for index in range(first, min(first + _IN_A_TAR, people)):
                name = f"{path.name}#{index:07}.png"
                names.add(name)
                files = dict(samples[index % distinct])
                if (bad := index % _BROKEN_EVERY) in (1, 2):
                    broken.add(name)
                    ending = "png" if bad == 1 else "keypoints.json"
                    files[ending] = files[ending][: len(files[ending]) // 3]
                for ending, data in files.items():
                    add_file(tar, f"{index:07}.{ending}", data)
            end = tar.offset
    os.truncate(path, end)
    return names | {path.name}, broken | {path.name}


class _Disk:
    """A small disk, until it is called."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        mount = ["mount", "-t", "tmpfs", "-o", f"size={_SMALL}", "tmpfs", str(folder)]
        self.folder = folder
        self.before: list[str] = []  # of a command that is to find it full
        try:
            self.mounted = subprocess.run(mount, capture_output=True).returncode == 0
        except OSError:
            self.mounted = False
        if not self.mounted:
            # By a shell, for a forked child of torch can hang; in blocks of 512 bytes.
            self.before = ["sh", "-c", 'ulimit -f 8 && exec "$@"', "sh"]

    def __call__(self) -> None:
        """Make it large."""
        if self.mounted:
            subprocess.run(["mount", "-o", f"remount,size={_LARGE}", str(self.folder)], check=True)


@contextmanager
def _small_disk(folder: Path) -> Iterator[_Disk]:
    disk = _Disk(folder)
    try:
        yield disk
    finally:
        if disk.mounted:
            # Lazily: readers' threads may close their files a moment later.
            subprocess.run(["umount", "-l", str(folder)], check=True)


def _shards(out: Path) -> Iterator[tuple[str, int]]:
    """Shards that are there, and when they were written."""
    for path in sorted(out.glob("part-*")):
        yield path.name, path.stat().st_mtime_ns


def _wait_for_another(out: Path, known: dict[str, int], run: subprocess.Popen[bytes]) -> None:
    """Wait until a run has written a shard, or ended."""
    while run.poll() is None and not dict(_shards(out)).keys() - known.keys():
        time.sleep(0.02)


def _largest_difference(table: Any, distinct: int) -> float:
    """Largest difference of a joint between rows of one person [m]."""
    bodies: dict[int, np.ndarray] = {}
    worst = 0.0
    fine = table.filter(table["joints"].is_valid())
    joints = fine["joints"].combine_chunks().flatten().to_numpy().reshape(fine.num_rows, -1)
    for name, each in zip(fine["picture"].to_pylist(), joints, strict=True):
        person = int(name.split("#")[1].split(".")[0]) % distinct
        worst = max(worst, float(np.abs(each - bodies.setdefault(person, each)).max()))
    return worst
