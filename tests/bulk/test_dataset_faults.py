"""``scripts/measure_dataset.py`` in small: a full disk, random kills and broken files lose and repeat nothing."""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "scripts" / "measure_dataset.py"

pytest.importorskip("pyarrow", reason="needs pyarrow, the extra dataset")
pytest.importorskip("webdataset", reason="needs webdataset, the extra dataset")


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="needs SIGKILL")
@pytest.mark.skipif(not SCRIPT.is_file(), reason="needs the repository around the tests")
def test_nothing_is_lost_and_nothing_twice(tmp_path: Path) -> None:
    spec = importlib.util.spec_from_file_location("measure_dataset", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    found = script.measure(tmp_path, people=24, kills=2, shard=4, distinct=3)
    assert "exit code 2" in found["a full disk said"] or "of 7 shards" in found["a full disk said"]
    assert found["shards"].startswith("7, ")
    assert (found["rows"], found["broken"]) == (25, 3)  # one of the file that was cut off
    assert [found[name] for name in ("lost", "twice", "strange errors", "made again", "left behind")] == [
        0,
        0,
        0,
        0,
        [],
    ]
    assert found["rows of a person differ by [m], at most"] < 1e-4
