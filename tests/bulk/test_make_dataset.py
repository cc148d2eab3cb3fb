"""Data sets made in Python, without the command."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers.shards import members, write_tar

from warp_partdr import PeopleFitter, Shards, make_dataset, open_source
from warp_partdr.bulk.people import stages_of_quality
from warp_partdr.bulk.shards import Tally
from warp_partdr.networks.regression.checkpoint import packaged_network

pq = pytest.importorskip("pyarrow.parquet", reason="needs pyarrow, the extra dataset")
pytestmark = pytest.mark.usefixtures("here")


def test_shards_and_columns_need_not_be_named() -> None:
    """All shards are made that are not whole in the folder, with the columns that the fitter makes."""
    write_tar(Path("s/a.tar"), {**members("000"), **members("001"), **members("002")})
    source = open_source(Path("s"), labels="cdcl14")
    fitter = PeopleFitter(stages_of_quality("network"), packaged_network("cpu"))
    shards = Shards(Path("out"), source.names, size=2, options={})
    made: list[int] = []

    def written(index: int, tally: Tally) -> None:
        made.append(index)

    assert make_dataset(source, shards, fitter, todo=[1], written=written).pictures == 1
    assert make_dataset(source, shards, fitter, written=written).pictures == 2
    assert make_dataset(source, shards, fitter, written=written).pictures == 0
    assert made == [1, 0]
    rows = pq.read_table("out").to_pylist()
    assert [row["picture"] for row in rows] == [f"a.tar#00{number}.jpg" for number in range(3)]
    assert all(len(row["joints"]) == 63 for row in rows)
