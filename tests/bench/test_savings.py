"""``partdr bench savings``: every row has its times, and figures are the same on the screen and on disk."""

from __future__ import annotations

import json

from rich.console import Console

from warp_partdr.bench.report import save_figures
from warp_partdr.bench.savings import print_savings, run_savings, savings_as_dict


def test_savings_are_timed(device, tmp_path, capsys):
    rows = run_savings("cpu" if device == "cpu" else "cuda:0", budget=0.0)
    assert {row.name for row in rows} >= {"L_seg against labels", "region of interest", "parts of a scene, edges"}
    assert all(row.before.median > 0 and row.after.median > 0 for row in rows)
    assert all(row.base.median > 0 for row in rows if row.name.startswith("parts"))
    assert all((row.memory_before is None) == (device == "cpu") for row in rows)
    print_savings(rows, {"machine": "any"}, Console(width=200))
    assert "region of interest" in capsys.readouterr().out
    save_figures(savings_as_dict(rows, {"machine": "any"}), tmp_path / "savings.json")
    assert len(json.loads((tmp_path / "savings.json").read_text())["rows"]) == len(rows)
