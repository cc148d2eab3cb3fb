"""Data sets are read as docs/reference/outputs.md shows it: by other packages, and without this one."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.people_rows import body_row, write_shards

from warp_partdr.body.template import JOINT_NAMES

PAGE = Path(__file__).resolve().parents[2] / "docs/reference/outputs.md"

pytest.importorskip("pyarrow", reason="needs pyarrow, the extra dataset")
pytestmark = pytest.mark.skipif(not PAGE.exists(), reason="needs the pages beside the tests")


@pytest.fixture(autouse=True)
def _people(here: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HF_HOME", str(tmp_path / "cache"))
    rows = [body_row(f"{index}.png", 3.0 + index, keypoint_error=0.02 * index) for index in range(3)]
    write_shards(Path("people"), [rows[:2], [{"picture": "none.png", "error": "broken"}, rows[2]]])


def shown(package: str) -> dict[str, Any]:
    """Names that the page's block about a package leaves behind."""
    pytest.importorskip(package.partition(".")[0], reason=f"needs {package}, of which the page shows the use")
    (block,) = (each for each in re.findall(r"```py\n(.*?)```", PAGE.read_text(), re.DOTALL) if package in each)
    assert "warp_partdr" not in block
    names: dict[str, Any] = {}
    exec(block, names)
    return names


def test_pyarrow_reads_the_shards_as_the_docs_show() -> None:
    names = shown("pyarrow.parquet")
    assert names["names"] == list(JOINT_NAMES)
    assert names["joints"].shape == (3, 21, 3)
    np.testing.assert_allclose(names["joints"][:, 0, 2], [3, 4, 5], atol=1e-5)
    assert names["table"]["picture"].to_pylist() == ["0.png", "1.png", "2.png"]


def test_no_column_is_of_lists_that_older_readers_can_not_read() -> None:
    """Null lists of a fixed size: "Expected all lists to be of size=63 but index 2 had size=0", before Arrow 26."""
    schema = pytest.importorskip("pyarrow.parquet").read_schema(next(Path("people").iterdir()))
    kinds = [schema.field(name).type for name in ("joints", "box", "keypoints")]
    assert [str(kind).partition("<")[0] for kind in kinds] == ["list", "list", "list"]


def test_pandas_reads_the_shards_as_the_docs_show() -> None:
    assert shown("pandas")["good"]["picture"].tolist() == ["0.png", "1.png"]


def test_hugging_face_datasets_read_the_shards_as_the_docs_show() -> None:
    people = shown("datasets")["people"]
    assert len(people) == 4
    assert people[3]["joints"].reshape(21, 3)[0, 2] == pytest.approx(5.0, abs=1e-5)
