"""The notebook runs from top to bottom, shows what it tells of, and is kept without outputs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from conftest import HANG

nbformat = pytest.importorskip("nbformat", reason="needs nbformat, of the extra test")
nbclient = pytest.importorskip("nbclient", reason="needs nbclient, of the extra test")

NOTEBOOK = Path(__file__).resolve().parents[2] / "demos" / "partdr.ipynb"


def read() -> Any:
    return nbformat.read(NOTEBOOK, as_version=4)


def test_the_notebook_is_kept_without_outputs():
    notebook = read()
    nbformat.validate(notebook)
    assert NOTEBOOK.stat().st_size < 50_000
    for cell in notebook.cells:
        if cell.cell_type == "code":
            assert cell.outputs == []
            assert cell.execution_count is None


@pytest.mark.slow
def test_the_notebook_runs_anywhere(monkeypatch, tmp_path):
    """It needs no files beside it, and leaves none behind."""
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    notebook = read()
    nbclient.NotebookClient(notebook, timeout=HANG, resources={"metadata": {"path": str(tmp_path)}}).execute()
    assert list(tmp_path.iterdir()) == []
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    faults = [output.text for output in outputs if output.output_type == "stream" and output.name == "stderr"]
    assert faults == []
    said = "".join(output.text for output in outputs if output.output_type == "stream")
    for words in ("upper leg 39", "exact, partdr", "mesh E1, partdr"):
        assert words in said
    errors = [float(line.split(": ")[1].split("°")[0]) for line in said.splitlines() if "training: " in line]
    before, after = errors
    assert after < 0.75 * before
    pictures = [output for output in outputs if "image/png" in output.get("data", {})]
    assert len(pictures) == 12
