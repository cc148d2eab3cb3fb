"""Pictures read, and their people cut out, in processes: the same rows as by threads."""

from __future__ import annotations

import os
import shutil
import signal
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import Mock

import pytest
from helpers import commands
from helpers.commands import Run
from helpers.datasets import write_coco
from helpers.shards import members, write_tar

from warp_partdr.bulk import run as bulk_run
from warp_partdr.bulk.cutting import Cutter
from warp_partdr.bulk.opening import open_source
from warp_partdr.bulk.people import PeopleFitter, stages_of_quality
from warp_partdr.bulk.processes import read_in_processes, shared_memory
from warp_partdr.bulk.run import Readers, source_readers
from warp_partdr.bulk.sources import SourcePicture
from warp_partdr.errors import InputError
from warp_partdr.inputs.observation import LABEL_SIZE
from warp_partdr.networks.regression.checkpoint import packaged_network

pq = pytest.importorskip("pyarrow.parquet", reason="needs pyarrow, the extra dataset")
pytest.importorskip("webdataset", reason="needs webdataset, the extra dataset")
pytestmark = pytest.mark.usefixtures("here")

run = commands.run  # fixture
HOW = "--quality network --device cpu --fov 50"


def by_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bulk_run, "source_readers", lambda *given: Readers(1, 1))


def fitter(device: str, batch: int, label_size: int = LABEL_SIZE) -> PeopleFitter:
    how = stages_of_quality("fast")
    return PeopleFitter(how, packaged_network("cpu"), None, device, batch, cutter=Cutter(label_size=label_size))


def test_rows_are_those_of_threads(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Some pictures are broken, some lack labels, some people are to be found, and shards end within a group."""
    torn = members("001")
    torn["001.jpg"] = torn["001.jpg"][:200]
    found = members("003", keypoints=False, parts=False)
    write_tar(Path("s/a.tar"), {**members("000"), **torn, **members("002", parts=False), **found, **members("004")})
    line = f"dataset s --labels cdcl14 {HOW} --shard 3"
    assert run(f"{line} --out threads")[0] == 0
    by_processes(monkeypatch)
    code, said, _ = run(f"{line} --out processes")
    assert code == 0
    assert "4 people in 5 pictures" in said
    assert pq.read_table("processes").equals(pq.read_table("threads"))


def test_rows_of_annotations_are_those_of_threads(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    write_coco(Path("coco"))
    line = f"dataset coco/people.json {HOW}"
    assert run(f"{line} --out threads")[0] == 0
    by_processes(monkeypatch)
    assert run(f"{line} --out processes")[0] == 0
    assert pq.read_table("processes").equals(pq.read_table("threads"))


def test_processes_read_for_a_gpu_where_people_are_known(monkeypatch: pytest.MonkeyPatch) -> None:
    """There must be enough shared memory, too: a container has 64 MB by default."""
    write_tar(Path("known.tar"), members("000"))
    write_tar(Path("unknown.tar"), members("000", keypoints=False, parts=False))
    known, unknown = open_source(Path("known.tar"), labels="cdcl14"), open_source(Path("unknown.tar"))
    monkeypatch.setattr(bulk_run, "shared_memory", lambda: 2**30)
    assert source_readers(known, fitter("cuda", 256), 16) == (16, 16)
    assert source_readers(known, fitter("cpu", 256), 16) == (16, 0)
    assert source_readers(unknown, fitter("cuda", 256), 16) == (16, 0)
    assert source_readers(known, fitter("cuda", 4096), 16) == (16, 0)
    monkeypatch.setattr(bulk_run, "shared_memory", lambda: 2**26)
    assert source_readers(known, fitter("cuda", 256), 16) == (16, 0)
    assert source_readers(known, fitter("cuda", 256, 128), 16) == (16, 16)


def test_free_memory_is_known_where_it_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    there = shutil.disk_usage(".")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: there)
    assert shared_memory() == there.free
    monkeypatch.setattr(shutil, "disk_usage", Mock(side_effect=FileNotFoundError))
    assert shared_memory() > 2**60


@dataclass(frozen=True)
class Deadly:
    """A source that ends the process that reads it."""

    names: Sequence[str] = ("a", "b")
    skeleton: str = "coco17"
    digest: str | None = "0"
    finds: bool = False

    def photo(self, name: str) -> Path:
        raise AssertionError

    def read(self, name: str) -> SourcePicture:
        os.kill(os.getpid(), signal.SIGKILL)
        raise AssertionError


@pytest.mark.skipif(os.name != "posix", reason="needs SIGKILL")
def test_a_process_that_is_killed_is_one_line() -> None:
    (shard,) = read_in_processes(Deadly(), Cutter(), [["a", "b"]], 1)
    with pytest.raises(
        InputError, match=r"reading pictures: a process ended \(DataLoader worker .*\); expected memory"
    ):
        next(shard)
