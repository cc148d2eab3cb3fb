"""Figures of measurements: means with intervals, and tables as texts, Markdown and JSON."""

import numpy as np
import pytest

from warp_partdr.lab.tables import Estimate, FigureTable, RecordColumn, estimate_mean, format_time, record_table
from warp_partdr.metrics import bootstrap_sum


def test_a_mean_leaves_out_what_is_not_known_and_has_the_packages_interval():
    values = np.array([1.0, np.nan, 4.0, 2.0, np.inf, 9.0])
    known = np.array([1.0, 4.0, 2.0, 9.0])
    found = estimate_mean(values)
    assert found.value == 4.0
    assert (found.low, found.high) == bootstrap_sum(known, lambda sums: sums / 4)
    assert found.low < found.value < found.high
    with pytest.raises(ValueError, match="values"):
        estimate_mean([np.nan])


def test_differences_and_figures_read_as_the_pages_have_them():
    estimate = Estimate(-1.26, -2.14, 0.41)
    assert f"{estimate:+.1f}" == "-1.3 (-2.1 to +0.4)"
    assert f"{estimate.scaled(-10):.0f}" == "13 (21–-4)"
    assert estimate.to_json() == {"value": -1.26, "interval_95": [-2.14, 0.41]}


def test_a_table_is_the_same_in_texts_markdown_and_json():
    table = FigureTable("Two fits", {"fit": "", "error [mm]": ".1f", "change": "+.1f", "people": "d"})
    table.add("plain", 41.26, None, 3)
    table.add("other", float("nan"), Estimate(1, 0, 2), np.int64(4))
    assert table.texts() == [["plain", "41.3", "", "3"], ["other", "", "+1.0 (+0.0 to +2.0)", "4"]]
    assert table.markdown().splitlines() == [
        "| fit | error [mm] | change | people |",
        "| --- | ---: | ---: | ---: |",
        "| plain | 41.3 |  | 3 |",
        "| other |  | +1.0 (+0.0 to +2.0) | 4 |",
    ]
    assert table.to_json() == {
        "title": "Two fits",
        "rows": [
            {"fit": "plain", "error [mm]": 41.26, "people": 3},
            {"fit": "other", "change": {"value": 1, "interval_95": [0, 2]}, "people": 4},
        ],
    }
    with pytest.raises(ValueError, match=r"cells: 2; expected 4"):
        table.add("short", 1.0)


def test_records_leave_empty_what_is_not_known():
    columns = (RecordColumn("name", "name"), RecordColumn("time", "seconds", format_time), RecordColumn("MB", "size"))
    records = [{"name": "one", "seconds": 2.0, "size": None}, {"name": "other", "seconds": None, "size": None}]
    table = record_table("All", columns, records)
    assert [column.header for column in table.columns] == ["name", "time"]  # no record has a size
    assert [list(column.cells) for column in table.columns] == [["one", "other"], ["2 s", ""]]


def test_a_table_of_figures_has_words_at_the_left_of_the_screen():
    table = FigureTable("All", {"fit": "", "error": ".1f"}, [("one", 1.25)]).on_screen()
    assert [column.justify for column in table.columns] == ["left", "right"]
    assert [list(column.cells) for column in table.columns] == [["one"], ["1.2"]]
