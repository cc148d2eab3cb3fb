"""The measurement of `partdr dataset` in small: a full disk, random kills and broken files lose and repeat nothing."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

pytest.importorskip("pyarrow", reason="needs pyarrow, the extra dataset")
pytest.importorskip("webdataset", reason="needs webdataset, the extra dataset")

from warp_partdr.lab.measurements.dataset import kill_runs


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="needs SIGKILL")
def test_nothing_is_lost_and_nothing_twice(tmp_path: Path) -> None:
    found = kill_runs(tmp_path, people=24, kills=2, shard=4, distinct=3)
    assert "exit code 2" in found.a_full_disk_said or "of 7 shards" in found.a_full_disk_said
    assert found.shards.startswith("7, ")
    assert (found.rows, found.broken) == (25, 3)  # one of the file that was cut off
    assert (found.lost, found.twice, found.strange_errors, found.made_again) == (0, 0, 0, 0)
    assert found.left_behind == []
    assert found.rows_of_a_person_differ_by < 1e-4
