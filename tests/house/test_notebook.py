"""The notebook runs from top to bottom anywhere, shows what it tells of, and keeps outputs with pictures."""

from __future__ import annotations

import re
import runpy
from pathlib import Path
from typing import Any

import pytest

from warp_partdr.kernels.messages import COMPILING

nbformat = pytest.importorskip("nbformat", reason="needs nbformat, of the extra test")
pytest.importorskip("nbclient", reason="needs nbclient, of the extra test")

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOK = ROOT / "demos" / "partdr.ipynb"
PICTURES = 12


def read() -> Any:
    return nbformat.read(NOTEBOOK, as_version=4)


def code_cells(notebook: Any) -> list[Any]:
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def kinds(notebook: Any) -> list[list[str]]:
    """Outputs of each code cell: the name of a stream, or the type of what is shown."""
    return [
        [output.get("name", "picture" if "image/png" in output.get("data", {}) else "") for output in cell.outputs]
        for cell in code_cells(notebook)
    ]


def test_the_notebook_keeps_its_outputs_and_is_small() -> None:
    """A page of the repository shows its pictures. `python scripts/run_notebook.py` makes them."""
    notebook = read()
    nbformat.validate(notebook)
    assert NOTEBOOK.stat().st_size < 1_500_000
    cells = code_cells(notebook)
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1)), "not run from top to bottom"
    shown = [kind for outputs in kinds(notebook) for kind in outputs]
    assert set(shown) == {"stdout", "picture"}
    assert shown.count("picture") == PICTURES


def test_the_notebook_installs_the_package_before_it_is_used() -> None:
    first, *others = (cell.source for cell in code_cells(read()))
    assert "warp_partdr" in re.findall(r'find_spec\("(\w+)"\)', first)
    assert '"--find-links", ".", "warp-partdr"' in first
    assert not re.search(r"(?m)^(?:from|import) (?:warp|torch|numpy|matplotlib)", first)
    assert not any("pip" in source for source in others)


def test_the_notebook_puts_its_tensors_where_the_bodies_are() -> None:
    """Without a GPU here, what stays on the CPU is found in the code alone."""
    code = "\n".join(cell.source for cell in code_cells(read()))
    made = re.findall(r"(?m)^.*(?:torch\.(?:zeros|tensor|rand)|BodyParameters\.mean|LimbNetwork|\banny)\(.*$", code)
    assert len(made) > 12
    assert [line for line in made if "device" not in line and not line.startswith("class ")] == []


def test_links_of_the_notebook_lead_somewhere() -> None:
    text = "\n".join(cell.source for cell in read().cells if cell.cell_type == "markdown")
    links = re.findall(r"\]\(([^)]+)\)", text)
    assert links
    assert [link for link in links if not (NOTEBOOK.parent / link).exists()] == []
    named = re.findall(r"`((?:docs|demos)/[^`]+)`", text)
    assert named
    assert [path for path in named if not (ROOT / path).exists()] == []


@pytest.mark.slow
def test_the_notebook_runs_anywhere(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """It needs no files beside it, and leaves none behind; its kept outputs are of the same kinds."""
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    notebook = runpy.run_path(str(ROOT / "scripts" / "run_notebook.py"))["executed"](tmp_path)
    assert list(tmp_path.iterdir()) == []
    outputs = [output for cell in code_cells(notebook) for output in cell.outputs]
    streams = {
        name: "".join(each.text for each in outputs if each.get("name") == name) for name in ("stdout", "stderr")
    }
    assert [line for line in streams["stderr"].splitlines() if COMPILING not in line] == []
    for words in ("upper leg 39", "exact, partdr", "mesh E1, partdr"):
        assert words in streams["stdout"]
    errors = [
        float(line.split(": ")[1].split("°")[0]) for line in streams["stdout"].splitlines() if "training: " in line
    ]
    before, after = errors
    assert after < 0.75 * before
    assert [[kind for kind in cell if kind != "stderr"] for cell in kinds(notebook)] == kinds(read())
