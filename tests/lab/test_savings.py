"""``partdr bench savings``: every row has its times, and figures are the same on the screen and on disk."""

from __future__ import annotations

import json

from warp_partdr.cli import bench
from warp_partdr.lab.bench import savings


def test_savings_are_timed(device, tmp_path, capsys, monkeypatch):
    rows = savings.run_savings("cpu" if device == "cpu" else "cuda:0", budget=0.0)
    assert {row["name"] for row in rows} >= {"L_seg against labels", "region of interest", "parts of a scene, edges"}
    assert all(row["whole_s"] > 0 and row["needed_s"] > 0 for row in rows)
    assert all(row["nothing_s"] > 0 for row in rows if row["name"].startswith("parts"))
    assert all((row["whole_bytes"] is None) == (device == "cpu") for row in rows)
    monkeypatch.setattr(savings, "run_savings", lambda device, progress: rows)
    monkeypatch.setenv("COLUMNS", "200")  # or headings wrap
    bench.bench_savings(device=device, out=tmp_path)
    said = capsys.readouterr().out
    assert "region of interest" in said
    assert "whole [ms]" in said
    (file,) = tmp_path.iterdir()
    assert json.loads(file.read_text())["rows"] == rows
