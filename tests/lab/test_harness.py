"""The harness lists all measurements, reads their options, and shows and writes what they find."""

from __future__ import annotations

import ast
import importlib
import inspect
import json
import sys
from collections.abc import Iterator
from types import ModuleType
from typing import get_type_hints

import pytest

from warp_partdr import __version__
from warp_partdr.errors import InputError
from warp_partdr.lab import harness, options
from warp_partdr.lab.tables import Estimate, FigureTable


def measure_small(
    *,
    people: options.People = range(200, 300),
    levels: options.Levels = ("realistic",),
    settings: options.Settings = (),
    jobs: options.Jobs = 1,
    device: options.Device = "cpu",
    network: options.NetworkFile = None,
) -> Iterator[FigureTable | str]:
    """Measure nothing.

    Args:
        people: People.
        levels: Levels.
        settings: Settings.
        jobs: Jobs.
        device: Device.
        network: Network.
    """
    table = FigureTable("Found", {"level": "", "people": "d", "error [mm]": ".1f"})
    for level in levels:
        table.add(level, len(people), Estimate(3.25, 2, 4.5))
    yield table
    yield f"{settings} {jobs} {device} {network}"


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> str:
    """Name of a measurement whose module is this one's."""
    module = ModuleType("warp_partdr.lab.measurements.small", "A small one.\n\nIt says [mm] what it does.")
    module.measure_small = measure_small  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    return "small"


def call(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    monkeypatch.setattr(sys, "argv", ["lab", *words])
    try:
        harness.run_lab()
    except SystemExit as left:
        return int(left.code or 0)
    return 0


@pytest.mark.parametrize("name", harness.measurements())
def test_a_measurement_has_a_line_and_typed_options_that_are_explained(name: str) -> None:
    line = harness.measurements()[name]
    assert len(line) > 20
    assert line.endswith(".")
    stem = name.replace("-", "_")
    module = importlib.import_module(f"warp_partdr.lab.measurements.{stem}")
    function = getattr(module, f"measure_{stem}")
    parameters = inspect.signature(function).parameters
    assert set(parameters) <= set(get_type_hints(function))
    explained = inspect.getdoc(function) or ""
    assert [each for each in parameters if f"\n    {each}: " not in explained] == []
    if all(each.default is not each.empty for each in parameters.values()):
        assert function() is not None  # a generator, which has done nothing yet


def test_measurements_leave_parsing_and_printing_to_the_harness() -> None:
    for path in harness._FOLDER.glob("*.py"):
        tree = ast.parse(path.read_text())
        names = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
        modules = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
        assert "print" not in names, path.name
        assert "argparse" not in modules, path.name


def test_the_list_has_each_measurement_with_its_line(monkeypatch, capsys) -> None:
    assert call(monkeypatch) == 0
    shown = capsys.readouterr().out
    for name, line in harness.measurements().items():
        assert f"{name} " in shown
        assert line in shown
    assert {"settings", "beside-real", "network"} <= harness.measurements().keys()


def test_help_teaches_the_measurement_and_its_options(small, monkeypatch, capsys) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    harness.run_measurement(small, ["--help"])
    shown = capsys.readouterr().out
    for told in ("It says [mm] what it does.", "--people", "200 299", "--set", "--json", "--markdown", "--jobs"):
        assert told in shown


def test_common_options_reach_the_measurement(small, capsys) -> None:
    words = "--people 3 5 --levels realistic hard --set a=1 --set b.c=2 --jobs 2 --network net.bin --markdown"
    harness.run_measurement(small, words.split())
    lines = capsys.readouterr().out.splitlines()
    assert "| hard | 3 | 3.2 (2.0–4.5) |" in lines
    assert lines[-1] == "('a=1', 'b.c=2') 2 cpu net.bin"


def test_json_has_the_same_figures_with_machine_and_options(small, tmp_path, capsys) -> None:
    file = tmp_path / "new" / "figures.json"
    harness.run_measurement(small, ["--json", str(file), "--people", "7", "7"])
    assert "3.2 (2.0–4.5)" in capsys.readouterr().out
    written = json.loads(file.read_text())
    assert written["measurement"] == "small"
    assert written["options"]["people"] == [7, 7]
    assert written["machine"]["warp-partdr"] == __version__
    assert {"date", "machine", "torch", "warp", "python"} <= written["machine"].keys()
    row = {"level": "realistic", "people": 1, "error [mm]": {"value": 3.25, "interval_95": [2, 4.5]}}
    assert written["results"] == [{"title": "Found", "rows": [row]}, "() 1 cpu None"]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["nothing"], "nothing: no measurement; expected one of "),
        (["settings", "--people", "3"], "requires 2"),
        (["settings", "--people", "4", "3"], "people: 4 3; expected the first and the last"),
        (["settings", "--levels", "harder"], "level: harder; expected clean"),
        (["settings", "--sett", "a=1"], "Unknown option"),
        (["scenes", "--levels", "pairs", "--jobs", "0"], "--jobs"),
        (["scenes", "--levels", "pairs", "--device", "abacus"], "abacus; expected auto or cpu"),
    ],
)
def test_wrong_words_are_one_line_and_exit_code_2(words, told, monkeypatch, capsys) -> None:
    assert call(monkeypatch, *words) == 2
    shown = capsys.readouterr()
    assert told in shown.err
    assert shown.err.startswith("lab: ")
    assert shown.err.count("\n") == 1
    assert shown.out == ""


def test_a_file_that_cant_be_written_is_refused_before_measuring(small, tmp_path, capsys) -> None:
    with pytest.raises(InputError, match=r"--json: .*expected a file to write"):
        harness.run_measurement(small, ["--json", str(tmp_path)])
    assert capsys.readouterr().out == ""


def test_a_setting_that_a_fit_lacks_is_refused() -> None:
    from warp_partdr import FitOptions

    assert options.with_setting(FitOptions(), "mirror=false").mirror is False
    with pytest.raises(InputError, match="expected key=value"):
        options.with_setting(FitOptions(), "mirror")
    with pytest.raises(InputError, match="unknown"):
        options.with_setting(FitOptions(), "miror=false")


def test_figures_before_a_failure_are_written(small, monkeypatch, tmp_path) -> None:
    def measure_broken(*, people: options.People = range(2)) -> Iterator[FigureTable]:
        """Measure, and fail."""
        table = FigureTable("Half", {"people": "d"})
        table.add(len(people))
        yield table
        raise RuntimeError("the machine is gone")

    monkeypatch.setattr(sys.modules["warp_partdr.lab.measurements.small"], "measure_small", measure_broken)
    file = tmp_path / "half.json"
    with pytest.raises(RuntimeError, match="gone"):
        harness.run_measurement(small, ["--json", str(file)])
    written = json.loads(file.read_text())
    assert written["finished"] is False
    assert written["results"] == [{"title": "Half", "rows": [{"people": 2}]}]


def test_a_script_reads_its_options_by_the_harness(capsys) -> None:
    seen = []

    def run(first: int, /, *, device: options.Device = "cpu") -> None:
        seen.append((first, device))

    run.__module__ = __name__
    harness.run_script(run, ["3", "--device", "cpu"])
    assert seen == [(3, "cpu")]
    with pytest.raises(SystemExit) as left:
        harness.run_script(run, ["three"])
    assert left.value.code == 2
    assert capsys.readouterr().err.startswith("test_harness.py: ")


def test_a_missing_package_is_named(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    monkeypatch.delitem(sys.modules, "warp_partdr.lab.measurements.shards", raising=False)
    with pytest.raises(InputError, match=r"shards: .*pyarrow.*; expected that package"):
        harness.run_measurement("shards", ["folder"])
