"""Speed of `partdr dataset` on JPEG shards, on one GPU and more, and by stage.

PartBench's people, 40 of them under many names, go into tar files in FOLDER as JPEG, keypoints and labels. Each run is
a process a GPU with its share of the shards; each GPU has as many cores, whatever their number. What is made before
each one's second shard is written does not count: starts, kernels that compile, and pictures read meanwhile; nor what a
minute after that has not been written. Then the stages alone, to tell what limits: pictures read and people cut out, by
one process and by one a core; fits; rows, their table, and Parquet. Of three times, the fastest counts.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
from PIL import Image

from ...bulk.cutting import Cut, Cutter, read_picture
from ...bulk.opening import open_source
from ...bulk.people import BulkQuality, PeopleFitter, kept_label_size, stages_of_quality
from ...bulk.picture_files import PictureFiles
from ...bulk.processes import read_in_processes, shared_memory
from ...bulk.rows import PeopleRows, columns, people_table
from ...errors import InputError
from ...inputs.cut_people import CutPeople
from ...interop.devices import choose_device
from ...interop.precision import multiplies_bfloat16
from ...kernels.launch import get_num_threads
from ...models.anny import anny
from ...networks.regression.checkpoint import packaged_network
from ..clocks import synchronize
from ..options import Counts
from ..people_files import add_file, kept_people
from ..tables import FigureTable

_DISTINCT, _IN_A_TAR, _SHARD, _BATCH, _SOME = 40, 5_000, 1_000, 1_000, 256
_FIRST, _MOST_SECONDS = 2, 60  # shards that don't count, and seconds that do
_LABELS = "ellipbody20"


def measure_shards(
    folder: Path,
    /,
    *,
    count: int = 20_000,
    quality: BulkQuality = "fast",
    gpus: Counts = (1,),
) -> Iterator[FigureTable | str]:
    """Time the command with each number of GPUs, then its stages.

    Args:
        folder: Folder for the shards, which are kept, and the results.
        count: Number of people.
        quality: Quality of the fits.
        gpus: Numbers of GPUs; 0 is the CPU.
    """
    if not (folder / "shards").exists():
        _write_shards(folder / "shards", count)
    yield f"Memory to share: {shared_memory() / 2**20:.0f} MiB free"
    cores = len(os.sched_getaffinity(0)) // max(*gpus, 1)  # of a GPU
    rates: dict[int, float] = {}
    for number in gpus:
        rates[number] = _run(folder, quality, number, cores)
        yield f"{quality}, {number} GPUs, {cores} cores each: {rates[number]:.0f} people a second"
    if {1, 2} <= rates.keys():
        yield f"Two GPUs: {rates[2] / rates[1]:.2f} times one"
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:cores])
    yield from _stages(folder, quality, "cpu" if set(rates) == {0} else choose_device("auto"))


def _write_shards(folder: Path, people: int) -> None:
    samples = [_as_jpeg(each) for each in kept_people(folder.parent, _DISTINCT)]
    folder.mkdir(parents=True)
    for first in range(0, people, _IN_A_TAR):
        with tarfile.open(folder / f"{first // _IN_A_TAR:03}.tar", "w") as tar:
            for index in range(first, min(first + _IN_A_TAR, people)):
                for ending, data in samples[index % _DISTINCT].items():
                    add_file(tar, f"{index:07}.{ending}", data)


def _as_jpeg(files: dict[str, bytes]) -> dict[str, bytes]:
    buffer = BytesIO()
    with Image.open(BytesIO(files["png"])) as picture:
        picture.convert("RGB").save(buffer, "jpeg", quality=90)
    return {"jpg": buffer.getvalue()} | {ending: data for ending, data in files.items() if ending != "png"}


def _run(root: Path, quality: str, gpus: int, share: int) -> float:
    """People a second of all processes, each from its second written shard on, with so many cores each."""
    cores, out = sorted(os.sched_getaffinity(0)), root / f"out-{quality}-{gpus}"
    line = [sys.executable, "-m", "warp_partdr", "dataset", str(root / "shards"), "--labels", _LABELS]
    line += ["--quality", quality, "--shard", str(_SHARD), "--out", str(out)]
    line += ["--device", "cuda" if gpus else "cpu", "--batch", str(_BATCH if gpus else 16)]
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
        if ends is None and all(len(found) > _FIRST for found in _shards_of(out, count)):
            ends = time.monotonic() + _MOST_SECONDS
        if ends is not None and time.monotonic() > ends:
            for each in runs:
                each.kill()
        time.sleep(0.2)
    if ends is None:
        raise InputError(f"a run ended before its third shard: {logs[0].read_text()[-1000:]}")
    rate = 0.0
    for files in _shards_of(out, count):
        seconds = files[-1].stat().st_mtime - files[_FIRST - 1].stat().st_mtime
        bodies = [pq.read_table(file, columns=["camera_scale"])["camera_scale"] for file in files[_FIRST:]]
        rate += sum(len(each) - each.null_count for each in bodies) / seconds
    return rate


def _shards_of(out: Path, count: int) -> list[list[Path]]:
    """Shards of each process that are there, by the time when they were written."""
    files = sorted(out.glob("part-*"), key=lambda file: file.stat().st_mtime)
    return [[file for file in files if int(file.name.split("-")[1]) % count == number] for number in range(count)]


def _stages(root: Path, quality: BulkQuality, device: str) -> Iterator[FigureTable | str]:
    """Each stage alone: microseconds a person, and people a second where more than one process works."""
    source = open_source(root / "shards", labels=_LABELS)
    assert isinstance(source, PictureFiles)
    model = anny(device) if quality == "mesh" else None
    options = replace(stages_of_quality(quality), half=multiplies_bfloat16(device))
    network, names = packaged_network(device), source.names[:_SOME]
    cutter = Cutter(skeleton=source.skeleton, label_size=kept_label_size(options, network, meshes=model is not None))
    table = FigureTable("Stages alone", {"stage": "", "µs a person": ".1f"})

    def clocked(stage: str, people: int, work: Callable[[], Any], device: str = "cpu") -> Any:
        seconds = []
        for _ in range(3):
            began = time.perf_counter()
            result = work()
            synchronize(device)
            seconds.append(time.perf_counter() - began)
        table.add(stage, 1e6 * min(seconds) / people)
        return result

    held = clocked("read, one process", _SOME, lambda: [(name, read_picture(source, name)) for name in names])
    cut = clocked("cut out, one process", _SOME, lambda: cutter.cut(held, {}))
    cores = get_num_threads()
    many = source.names[: min(len(source.names), 1000 * cores)]
    yield _reading_speed(source, cutter, many, cores)
    people = CutPeople.joined([each for _, each in cut.people][:1])
    fitter = PeopleFitter(options, network, model, device, _BATCH)
    clocked("copied to the device", len(people), lambda: people.to(device), device)
    there = people.to(device)
    parts = clocked(f"fitted and described, {len(people)} at a time", len(people), lambda: fitter.bodies(there), device)
    rows = PeopleRows(cut.rows.count, [*cut.rows.parts, *(part.at(cut.people[0][0]) for part in parts)])
    form = columns(source.skeleton, model)
    arrow = clocked("table", len(people), lambda: people_table(rows, form, {}))
    clocked("Parquet", len(people), lambda: pq.write_table(arrow, root / "one.parquet", compression="zstd"))
    yield table


def _reading_speed(source: PictureFiles, cutter: Cutter, names: Any, processes: int) -> str:
    (groups,) = read_in_processes(source, cutter, [names], processes)
    for _ in range(2 * processes):  # until all have started
        next(groups)
    began, count = time.perf_counter(), 0
    for group in groups:
        assert isinstance(group, Cut)
        count += len(group.pictures)
    speed = count / (time.perf_counter() - began)
    return f"Read and cut out by {processes} processes: {speed:.0f} people a second"
