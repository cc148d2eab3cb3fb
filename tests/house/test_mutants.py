"""The list of mutants holds: each can be made, its tests are there; and the script tells what dies from what lives."""

from __future__ import annotations

import ast
import sys
from functools import cache
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

import mutants
from mutants import ROOT, Mutant

LISTED = mutants.read_mutants()


@cache
def names_in(path: Path) -> set[str]:
    return {node.name for node in ast.parse(path.read_text()).body if isinstance(node, ast.FunctionDef)}


@pytest.mark.parametrize("mutant", LISTED, ids=lambda mutant: f"{mutant.file}: {mutant.why}")
def test_every_mutant_can_be_made_and_names_tests_that_are_there(mutant):
    changed, original = mutant.apply(ROOT), (ROOT / mutant.file).read_text()
    differing = [pair for pair in zip(changed.splitlines(), original.splitlines(), strict=True) if pair[0] != pair[1]]
    assert len(differing) == 1
    ast.parse(changed)
    assert mutant.tests
    for test in mutant.tests:
        file, _, name = test.partition("::")
        assert name in names_in(ROOT / file), test


def test_the_list_is_long_broad_and_holds_nothing_twice():
    assert len(LISTED) >= 80
    assert len({(mutant.file, mutant.find, mutant.replace) for mutant in LISTED}) == len(LISTED)
    assert len({mutant.file for mutant in LISTED}) >= 25
    assert all(mutant.why for mutant in LISTED)
    unexplained = [mutant for mutant in LISTED if not mutant.survives]
    assert len(unexplained) >= 0.95 * len(LISTED)
    chosen = mutants.quick(LISTED)
    assert [mutant.file for mutant in chosen] == list(dict.fromkeys(mutant.file for mutant in LISTED))


@pytest.mark.parametrize(
    ("find", "replace", "said"),
    [
        ("b = 3", "b = 4", "0 times; expected once"),
        ("a", "c", "2 times; expected once"),
        ("b = 2", "b = 2", "expected a change within one line"),
        ("b = 2", "b = 2\nc = 3", "expected a change within one line"),
    ],
)
def test_lines_that_are_gone_or_not_alone_are_refused(tmp_path, find, replace, said):
    (tmp_path / "x.py").write_text("a = 1\nb = 2\na = 3\n")
    with pytest.raises(ValueError, match=said):
        Mutant("x.py", find, replace, ("t",), "why").apply(tmp_path)
    with pytest.raises(ValueError, match="0 times"):
        Mutant("gone.py", find, replace, ("t",), "why").apply(tmp_path)


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A project of one function and its tests, as a copy that can be mutated."""
    monkeypatch.setattr(mutants, "WORK", tmp_path)
    folder = tmp_path / "copy0"
    for name in ("tests", "warp_partdr"):
        (folder / name).mkdir(parents=True)
    (folder / "warp_partdr/__init__.py").write_text("")
    (folder / "warp_partdr/sums.py").write_text("def add(a, b):\n    return a + b\n")
    (folder / "warp_partdr/other.py").write_text("unused = 1\n")
    (folder / "tests/test_sums.py").write_text(
        "import warp_partdr.sums as sums\n\n"
        "def test_add():\n    assert sums.add(1, 2) == 3\n\n"
        "def test_nothing():\n    sums.add(1, 2)\n"
    )
    (folder / "guard.py").write_text(mutants.GUARD)
    return folder


@pytest.mark.parametrize(
    ("file", "find", "replace", "test", "kind", "said"),
    [
        ("sums", "a + b", "a - b", "test_add", "killed", "test_add"),
        ("sums", "a + b", "a - b", "test_nothing", "survived", "1 passed"),
        ("sums", "a * b", "a - b", "test_add", "error", "0 times"),
        ("sums", "a + b", "a - b", "test_gone", "error", "not found"),
        ("other", "unused", "used", "test_add", "error", "not imported"),
    ],
)
def test_what_becomes_of_a_mutant(project, file, find, replace, test, kind, said):
    mutant = Mutant(f"warp_partdr/{file}.py", find, replace, (f"tests/test_sums.py::{test}",), "")
    before = (project / mutant.file).read_text()
    became, told = mutants.try_mutant(mutant, project)
    assert (became, said in told) == (kind, True), told
    assert (project / mutant.file).read_text() == before
