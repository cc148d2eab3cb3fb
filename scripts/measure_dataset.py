"""Measure and print that ``partdr dataset`` loses nobody and repeats nobody, however it is ended; and how fast it is.

    python scripts/measure_dataset.py [--device cuda] FOLDER [PEOPLE] [KILLS] [SHARD] [SETTING=VALUE ...]

PartBench's people, 40 of them under PEOPLE names (default 1000), go into tar files in FOLDER with keypoints and labels;
two in a hundred are broken, and the last file is cut off. A run on a disk that is too small is followed by KILLS that
are killed at random times (default 5; the first while it starts), and by one that ends. Then rows are counted. The
small disk is a tmpfs where that may be mounted, else a limit on the size of files. Settings are of ``partdr dataset``.
On a GPU shards of 5000 pictures take seconds. People are kept in FOLDER/people.tar, where a machine may find them that
can't draw them, without a compiler for its CPU.
"""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import tarfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from PIL import Image

from warp_partdr.lab.synthetic.partbench_people import make_person

DISTINCT, IN_A_TAR, BROKEN_EVERY = 40, 10_000, 100
SMALL, LARGE = "96k", "2g"  # of the disk
SPEEDS = {"cpu": 30, "cuda": 2000}  # people a second, about: on two cores, and on a GPU with 16


def main(folder: str, *given: str, device: str = "cpu") -> None:
    people, kills, shard = map(int, (*given[:3], *("1000", "5", "500")[len(given[:3]) :]))
    found = measure(Path(folder), people, kills, shard, settings=given[3:], device=device)
    for name, value in found.items():
        print(f"{name}: {value}")
    if found["lost"] or found["twice"] or found["strange errors"] or found["made again"]:
        sys.exit("not as it should be")


def measure(
    folder: Path,
    people: int,
    kills: int,
    shard: int,
    distinct: int = DISTINCT,
    settings: Sequence[str] = (),
    device: str = "cpu",
) -> dict[str, Any]:
    """Numbers of what was asked for and of what was found."""
    names, broken = write_source(folder / "shards", people, distinct)
    out, rng = folder / "out", random.Random(0)
    times: dict[str, int] = {}
    seconds_of_a_shard = shard / SPEEDS[device]
    line = [sys.executable, "-m", "warp_partdr", "dataset", str(folder / "shards"), "--labels", "ellipbody20"]
    line += ["--quality", "network", "--device", device, "--shard", str(shard), "--out", str(out)]
    line += [word for setting in settings for word in ("--set", setting)]
    started = time.monotonic()
    with small_disk(out) as grow:
        full = subprocess.run([*grow.before, *line], capture_output=True, text=True)
        grow()
        times |= dict(shards(out))
        for number in range(kills):
            run = subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            if number:
                wait_for_another(out, times, run)
                time.sleep(rng.uniform(0.0, seconds_of_a_shard))
            else:
                time.sleep(rng.uniform(1.0, 5.0))
            run.send_signal(signal.SIGKILL)
            run.wait()
            times = {**dict(shards(out)), **times}
        last = subprocess.run(line, capture_output=True, text=True)
        seconds = time.monotonic() - started
        table = pq.read_table(out, columns=["picture", "person", "error", "joints"])
        after = dict(shards(out))
        left = [path.name for path in out.iterdir() if not path.name.startswith("part-")]
    counts = Counter(table["picture"].to_pylist())
    errors = {
        name for name, error in zip(table["picture"].to_pylist(), table["error"].to_pylist(), strict=True) if error
    }
    return {
        "people": people,
        "a full disk said": f"exit code {full.returncode}, {full.stderr.strip().splitlines()[-1]}",
        "killed": kills,
        "shards": f"{len(after)}, of which {len(times)} before the last run",
        "the last run said": f"exit code {last.returncode}, {last.stdout.strip().splitlines()[:1]}",
        "rows": table.num_rows,
        "lost": len(names - counts.keys()),
        "twice": sum(count - 1 for count in counts.values()),
        "broken": len(broken),
        "strange errors": len(errors ^ broken) + len(counts.keys() - names),
        "made again": sum(after.get(name) != when for name, when in times.items()),
        "left behind": left,
        "rows of a person differ by [m], at most": spread(table, distinct),
        "seconds, all runs": round(seconds, 1),
        "people a second, all runs with their starts": round(people / seconds, 1),
    }


def write_source(folder: Path, people: int, distinct: int) -> tuple[set[str], set[str]]:
    """Write the tar files; names of all rows that are expected, and of those with an error."""
    folder.mkdir(parents=True, exist_ok=True)
    samples = kept_samples(folder.parent, distinct)
    names, broken = set(), set()
    for first in range(0, people, IN_A_TAR):
        path = folder / f"{first // IN_A_TAR:03}.tar"
        with tarfile.open(path, "w") as tar:
            for index in range(first, min(first + IN_A_TAR, people)):
                name = f"{path.name}#{index:07}.png"
                names.add(name)
                files = dict(samples[index % distinct])
                if (bad := index % BROKEN_EVERY) in (1, 2):
                    broken.add(name)
                    ending = "png" if bad == 1 else "keypoints.json"
                    files[ending] = files[ending][: len(files[ending]) // 3]
                for ending, data in files.items():
                    add_file(tar, f"{index:07}.{ending}", data)
            end = tar.offset
    os.truncate(path, end)
    return names | {path.name}, broken | {path.name}


def kept_samples(folder: Path, count: int) -> list[dict[str, bytes]]:
    """Files of people by their endings, drawn unless they are kept in a folder."""
    path, kept = folder / "people.tar", defaultdict[str, dict[str, bytes]](dict)
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        with tarfile.open(path, "w") as tar:
            for index in range(count):
                for ending, data in sample(index).items():
                    add_file(tar, f"{index:03}.{ending}", data)
    with tarfile.open(path) as tar:
        for member in tar:
            number, _, ending = member.name.partition(".")
            kept[number][ending] = tar.extractfile(member).read()  # type: ignore[union-attr]  # a file
    if len(kept) < count:
        sys.exit(f"{path}: {len(kept)} people; expected {count}, or no such file")
    return [kept[number] for number in sorted(kept)[:count]]


def add_file(tar: tarfile.TarFile, name: str, data: bytes) -> None:
    info = tarfile.TarInfo(name)
    info.size = len(data)
    tar.addfile(info, BytesIO(data))


def sample(index: int) -> dict[str, bytes]:
    """Files of a person by their endings; the picture shows the labels."""
    person = make_person(index)
    points = [[float(x), float(y), 1.0] for x, y in person.keypoints()]
    files = {"keypoints.json": json.dumps({"format": "coco17", "keypoints": points}).encode()}
    for ending, image in (("png", Image.fromarray(person.parts * 12)), ("parts.png", Image.fromarray(person.parts))):
        buffer = BytesIO()
        image.save(buffer, "png")
        files[ending] = buffer.getvalue()
    return files


class Disk:
    """A small disk, until it is called."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        mount = ["mount", "-t", "tmpfs", "-o", f"size={SMALL}", "tmpfs", str(folder)]
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
            subprocess.run(["mount", "-o", f"remount,size={LARGE}", str(self.folder)], check=True)


@contextmanager
def small_disk(folder: Path) -> Iterator[Disk]:
    disk = Disk(folder)
    try:
        yield disk
    finally:
        if disk.mounted:
            # Lazily: readers' threads may close their files a moment later.
            subprocess.run(["umount", "-l", str(folder)], check=True)


def shards(out: Path) -> Iterator[tuple[str, int]]:
    """Shards that are there, and when they were written."""
    for path in sorted(out.glob("part-*")):
        yield path.name, path.stat().st_mtime_ns


def wait_for_another(out: Path, known: dict[str, int], run: subprocess.Popen[bytes]) -> None:
    """Wait until a run has written a shard, or ended."""
    while run.poll() is None and not dict(shards(out)).keys() - known.keys():
        time.sleep(0.02)


def spread(table: Any, distinct: int) -> float:
    """Largest difference of a joint between rows of one person."""
    bodies: dict[int, np.ndarray] = {}
    worst = 0.0
    fine = table.filter(table["joints"].is_valid())
    joints = fine["joints"].combine_chunks().flatten().to_numpy().reshape(fine.num_rows, -1)
    for name, each in zip(fine["picture"].to_pylist(), joints, strict=True):
        person = int(name.split("#")[1].split(".")[0]) % distinct
        worst = max(worst, float(np.abs(each - bodies.setdefault(person, each)).max()))
    return worst


if __name__ == "__main__":
    words = sys.argv[1:]
    if words[:1] == ["--device"]:
        main(*words[2:], device=words[1])
    else:
        main(*words)
