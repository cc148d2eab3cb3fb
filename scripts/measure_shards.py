"""Measure and print how many people a second ``partdr dataset`` fits from JPEG shards, on one GPU and more; by stage.

    python scripts/measure_shards.py FOLDER [PEOPLE [QUALITY [GPUS...]]]

PartBench's people, 40 of them under PEOPLE names (default 20000), go into tar files in FOLDER as JPEG, keypoints and
labels. A run for each number of GPUS (default 1; 0: on the CPU) is a process a GPU with its share of the shards; each
GPU has as many cores, whatever their number. What is made before each one's second shard is written does not count:
starts, kernels that compile, and pictures read meanwhile; nor what a minute after that has not been written. Then the
stages alone, to tell what limits: pictures read and people cut out, by one process and by one a core; fits; rows, their
table, and Parquet.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import time
from collections.abc import Callable
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import torch
from measure_dataset import add_file, kept_samples
from PIL import Image

from warp_partdr.bulk.cutting import Cut, Cutter, read_picture
from warp_partdr.bulk.opening import open_source
from warp_partdr.bulk.people import PeopleFitter, kept_label_size, stages_of_quality
from warp_partdr.bulk.picture_files import PictureFiles
from warp_partdr.bulk.processes import read_in_processes, shared_memory
from warp_partdr.bulk.rows import PeopleRows, columns, people_table
from warp_partdr.inputs.cut_people import CutPeople
from warp_partdr.interop.devices import choose_device
from warp_partdr.interop.precision import multiplies_bfloat16
from warp_partdr.kernels.launch import get_num_threads
from warp_partdr.models.anny import anny
from warp_partdr.networks.regression.checkpoint import packaged_network

DISTINCT, IN_A_TAR, SHARD, BATCH, SOME = 40, 5_000, 1_000, 1_000, 256
FIRST, MOST_SECONDS = 2, 60  # shards that don't count, and seconds that do
LABELS = "ellipbody20"


def main(folder: str, people: str = "20000", quality: str = "fast", *gpus: str) -> None:
    root, count = Path(folder), int(people)
    if not (root / "shards").exists():
        write_shards(root / "shards", count)
    print(f"memory to share: {shared_memory() / 2**20:.0f} MiB free")
    rates = {}
    numbers = [int(each) for each in gpus or ("1",)]
    cores = len(os.sched_getaffinity(0)) // max(*numbers, 1)  # of a GPU
    for number in numbers:
        rates[number] = run(root, quality, number, cores)
        print(f"{quality}, {number} GPUs, {cores} cores each: {rates[number]:.0f} people a second", flush=True)
    if {1, 2} <= rates.keys():
        print(f"two GPUs: {rates[2] / rates[1]:.2f} times one")
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:cores])
    measure_stages(root, quality, "cpu" if set(rates) == {0} else choose_device("auto"))


def write_shards(folder: Path, people: int) -> None:
    samples = [as_jpeg(each) for each in kept_samples(folder.parent, DISTINCT)]
    folder.mkdir(parents=True)
    for first in range(0, people, IN_A_TAR):
        with tarfile.open(folder / f"{first // IN_A_TAR:03}.tar", "w") as tar:
            for index in range(first, min(first + IN_A_TAR, people)):
                for ending, data in samples[index % DISTINCT].items():
                    add_file(tar, f"{index:07}.{ending}", data)


def as_jpeg(files: dict[str, bytes]) -> dict[str, bytes]:
    buffer = BytesIO()
    with Image.open(BytesIO(files["png"])) as picture:
        picture.convert("RGB").save(buffer, "jpeg", quality=90)
    return {"jpg": buffer.getvalue()} | {ending: data for ending, data in files.items() if ending != "png"}


def run(root: Path, quality: str, gpus: int, share: int) -> float:
    """People a second of all processes, each from its second written shard on, with so many cores each."""
    cores, out = sorted(os.sched_getaffinity(0)), root / f"out-{quality}-{gpus}"
    line = [sys.executable, "-m", "warp_partdr", "dataset", str(root / "shards"), "--labels", LABELS]
    line += ["--quality", quality, "--shard", str(SHARD), "--out", str(out)]
    line += ["--device", "cuda" if gpus else "cpu", "--batch", str(BATCH if gpus else 16)]
    count = max(gpus, 1)
    shutil.rmtree(out, ignore_errors=True)
    logs = [root / f"errors-{number}.txt" for number in range(count)]
    runs = []
    for number in range(count):
        os.sched_setaffinity(0, cores[share * number : share * (number + 1)])  # which a process inherits
        runs.append(
            subprocess.Popen(
                [*line, "--share", f"{number}/{count}"],
                env=os.environ | ({"CUDA_VISIBLE_DEVICES": str(number)} if gpus else {}),
                stdout=subprocess.DEVNULL,
                stderr=logs[number].open("w"),
            )
        )
    os.sched_setaffinity(0, cores)
    ends: float | None = None
    while any(each.poll() is None for each in runs):
        if ends is None and all(len(found) > FIRST for found in shards_of(out, count)):
            ends = time.monotonic() + MOST_SECONDS
        if ends is not None and time.monotonic() > ends:
            for each in runs:
                each.kill()
        time.sleep(0.2)
    if ends is None:
        sys.exit(f"a run ended before its third shard: {logs[0].read_text()[-1000:]}")
    rate = 0.0
    for files in shards_of(out, count):
        seconds = files[-1].stat().st_mtime - files[FIRST - 1].stat().st_mtime
        bodies = [pq.read_table(file, columns=["camera_scale"])["camera_scale"] for file in files[FIRST:]]
        rate += sum(len(each) - each.null_count for each in bodies) / seconds
    return rate


def shards_of(out: Path, count: int) -> list[list[Path]]:
    """Shards of each process that are there, by the time when they were written."""
    files = sorted(out.glob("part-*"), key=lambda file: file.stat().st_mtime)
    return [[file for file in files if int(file.name.split("-")[1]) % count == number] for number in range(count)]


def measure_stages(root: Path, quality: str, device: str) -> None:
    """Each stage alone: microseconds a person, and people a second where more than one process works."""
    source = open_source(root / "shards", labels=LABELS)
    assert isinstance(source, PictureFiles)
    model = anny(device) if quality == "mesh" else None
    how = replace(stages_of_quality(quality), half=multiplies_bfloat16(device))  # type: ignore[arg-type]
    network, names = packaged_network(device), source.names[:SOME]
    cutter = Cutter(skeleton=source.skeleton, label_size=kept_label_size(how, network, meshes=model is not None))
    held = clocked("read, one process", SOME, lambda: [(name, read_picture(source, name)) for name in names])
    cut = clocked("cut out, one process", SOME, lambda: cutter.cut(held, {}))
    cores = get_num_threads()
    many = source.names[: min(len(source.names), 1000 * cores)]
    measure_reading(source, cutter, many, cores)
    people = CutPeople.joined([each for _, each in cut.people][:1])
    fitter = PeopleFitter(how, network, model, device, BATCH)
    clocked("copied to the device", len(people), lambda: people.to(device), device)
    there = people.to(device)
    parts = clocked(f"fitted and described, {len(people)} at a time", len(people), lambda: fitter.bodies(there), device)
    rows = PeopleRows(cut.rows.count, [*cut.rows.parts, *(part.at(cut.people[0][0]) for part in parts)])
    form = columns(source.skeleton, model)
    table = clocked("table", len(people), lambda: people_table(rows, form, {}))
    clocked("Parquet", len(people), lambda: pq.write_table(table, root / "one.parquet", compression="zstd"))


def measure_reading(source: PictureFiles, cutter: Cutter, names: Any, processes: int) -> None:
    (groups,) = read_in_processes(source, cutter, [names], processes)
    for _ in range(2 * processes):  # until all have started
        next(groups)
    began, count = time.perf_counter(), 0
    for group in groups:
        assert isinstance(group, Cut)
        count += len(group.pictures)
    print(f"  read and cut out by {processes} processes: {count / (time.perf_counter() - began):.0f} people a second")


def clocked(what: str, people: int, work: Callable[[], Any], device: str = "cpu") -> Any:
    """Do it three times; the fastest counts."""
    seconds = []
    for _ in range(3):
        began = time.perf_counter()
        result = work()
        if device != "cpu":
            torch.cuda.synchronize()
        seconds.append(time.perf_counter() - began)
    print(f"  {1e6 * min(seconds) / people:8.1f} us a person: {what}", flush=True)
    return result


if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1].startswith("-"):
        sys.exit(__doc__)
    main(*sys.argv[1:])
