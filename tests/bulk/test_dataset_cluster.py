"""``partdr dataset --ray``: a local cluster writes what one machine writes, also when a process of it is killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from conftest import HANG
from helpers import commands
from helpers.commands import Run
from helpers.datasets import write_coco

pq = pytest.importorskip("pyarrow.parquet", reason="needs pyarrow, the extra dataset")
pytest.importorskip("ray.data", reason="needs Ray Data, the extra ray")
psutil = pytest.importorskip("psutil")
pytestmark = pytest.mark.usefixtures("here")

run = commands.run  # fixture
COCO = "dataset coco/people.json --quality fast --shard 2 --device cpu"
COUNT = 12


def workers(process: int) -> list[psutil.Process]:
    """The cluster's processes that make shards."""
    found = []
    for each in psutil.Process(process).children(recursive=True):
        try:
            if "MapWorker" in " ".join(each.cmdline()):
                found.append(each)
        except psutil.Error:
            continue
    return found


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="needs SIGKILL")
def test_a_killed_process_loses_nothing_and_repeats_nothing(run: Run) -> None:
    """One of two workers is killed when the first shard is there. Every row is that of one machine, bit for bit."""
    write_coco(Path("coco"), count=COUNT)
    (Path("coco") / "003.jpg").write_bytes(b"broken")
    assert run(f"{COCO} --out whole")[0] == 0
    line = [sys.executable, "-m", "warp_partdr", *COCO.split(), "--out", "out", "--ray", "local", "--workers", "2"]
    cluster = subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    end = time.monotonic() + HANG
    while not list(Path("out").glob("part-*")):
        assert cluster.poll() is None, cluster.communicate()
        assert time.monotonic() < end
        time.sleep(0.02)
    before = workers(cluster.pid)
    assert len(before) == 2
    busy = max(before, key=lambda each: each.cpu_times().user)  # the other may be starting yet
    os.kill(busy.pid, signal.SIGKILL)
    said, complaint = cluster.communicate(timeout=HANG)
    assert cluster.returncode == 0, complaint
    assert f"{COUNT - 1} people in {COUNT} pictures; " in said
    assert f"out has {COUNT // 2} of {COUNT // 2} shards" in said
    assert "warning: 1 row with an error, first 003.jpg: " in complaint
    names = sorted(path.name for path in Path("out").iterdir() if not path.name.startswith("."))
    assert names == sorted(path.name for path in Path("whole").iterdir())
    out, whole = pq.read_table("out"), pq.read_table("whole")
    assert out["picture"].to_pylist() == [f"{index:03}.jpg" for index in range(COUNT)]
    assert out.equals(whole)
    assert run(f"{COCO} --out out")[1] == "out has 6 of 6 shards; nothing to do\n"  # the same options, by what it says


def test_a_cluster_goes_on_where_one_machine_ended(run: Run) -> None:
    """It also tells a fault of the disk as one machine does."""
    write_coco(Path("coco"), count=6)
    assert run(f"{COCO} --out out --share 0/2")[0] == 0
    first = Path("out/part-00000-of-00003.parquet").stat().st_mtime_ns
    line = f"{COCO} --out out --ray local --workers 1"
    code, said, complaint = run(line)
    assert code == 0
    assert "2 of 3 shards are there; going on" in complaint
    assert "2 people in 2 pictures" in said
    assert Path("out/part-00000-of-00003.parquet").stat().st_mtime_ns == first
    assert "out has 3 of 3 shards; nothing to do\n" in run(line)[1]


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("--workers 2", "--workers, --cores: without a cluster; expected --ray with it"),
        ("--ray 127.0.0.1:1", "--ray: 127.0.0.1:1: "),
    ],
)
def test_faults_are_one_line(line: str, says: str, run: Run) -> None:
    write_coco(Path("coco"), count=1)
    code, said, complaint = run(f"{COCO} --out out {line}")
    assert (code, said) == (2, "")
    assert complaint.splitlines()[-1].startswith(f"partdr: {says}")
    assert not Path("out").exists()


def test_without_ray_it_says_what_to_install(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    from warp_partdr.cli import dataset

    known = dataset.find_spec
    monkeypatch.setattr(dataset, "find_spec", lambda name: None if name == "ray" else known(name))
    packages = "'ray>=2.50' 'pandas>=2' 'pyarrow>=20' 'webdataset>=1.0.2'"
    told = f"partdr: --ray: without Ray Data; expected it: pip install {packages}\n"
    assert run("dataset photos --ray local")[2] == told
