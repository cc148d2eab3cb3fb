"""The list of mutants holds: each can be made, its tests are there; and the script tells what dies from what lives."""

from __future__ import annotations

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

import mutants
from find_code import Project, comparable
from mutants import ROOT, Mutant

LISTED = mutants.read_mutants()
PROJECT = Project(ROOT)


@cache
def names_in(path: Path) -> set[str]:
    return {node.name for node in ast.parse(path.read_text()).body if isinstance(node, ast.FunctionDef)}


@pytest.mark.parametrize("mutant", LISTED, ids=lambda mutant: f"{mutant.definition or mutant.file}: {mutant.why}")
def test_every_mutant_can_be_made_and_names_tests_that_are_there(mutant):
    assert mutant.apply(PROJECT) != (ROOT / mutant.path(PROJECT)).read_text()
    assert mutant.tests
    for test in mutant.tests:
        file, _, name = test.partition("::")
        assert name in names_in(ROOT / file), test


def test_the_list_is_long_broad_and_holds_nothing_twice():
    assert len(LISTED) >= 80
    faults = {
        (mutant.path(PROJECT), mutant.definition, mutant.find, mutant.occurrence, mutant.replace) for mutant in LISTED
    }
    assert len(faults) == len(LISTED)
    paths = [mutant.path(PROJECT) for mutant in LISTED]
    assert len(set(paths)) >= 25
    assert all(mutant.why for mutant in LISTED)
    unexplained = [mutant for mutant in LISTED if not mutant.survives]
    assert len(unexplained) >= 0.95 * len(LISTED)
    assert [mutant.path(PROJECT) for mutant in mutants.quick(LISTED, PROJECT)] == list(dict.fromkeys(paths))


SOURCE = '''"""A module."""

RATIO = 0.6  # of a stature
SIDES = {"left": -1, "right": 1}


def twice(x, factor=2, *, shift=0.5):
    """Both."""
    y = scale * (
        x + shift  # é is two bytes
    ) - factor
    print(f"{y + 1}"); print('y')
    if y > 0:
        return y
    elif y < -1:
        return -y
    return y[1:-1]


class Body:
    size: float = 1.5

    @cached(limit=3)
    def height(self):
        def inner(z):
            return z + 1

        return inner(2) + self.size * RATIO

    def width(self): return self.size + self.size
'''


@pytest.fixture
def small(tmp_path):
    """A project of one module."""
    (tmp_path / "body").mkdir()
    (tmp_path / "body/one.py").write_text(SOURCE, encoding="utf-8")
    (tmp_path / "body/table.json").write_text('{"left": 1, "right": 2}')
    return tmp_path


@pytest.mark.parametrize(
    ("definition", "find", "replace", "line", "changed"),
    [
        ("RATIO", "0.6", "0.7", 3, "RATIO = 0.7  # of a stature"),
        ("RATIO", "RATIO = 0.6", "RATIO = 1", 3, "RATIO = 1  # of a stature"),
        ("SIDES", "'right'", "'left'", 4, "SIDES = {\"left\": -1, 'left': 1}"),
        ("twice.factor", "2", "3", 7, "def twice(x, factor=3, *, shift=0.5):"),
        ("twice.shift", "0.5", "0", 7, "def twice(x, factor=2, *, shift=0):"),
        ("twice", "x+shift", "x - shift", 10, "        x - shift  # é is two bytes"),
        ("twice", "print( 'y' )", "pass", 12, '    print(f"{y + 1}"); pass'),
        ("twice", "y > 0", "y >= 0", 13, "    if y >= 0:"),
        ("twice", "return -y", "return y", 16, "        return y"),
        ("twice", "1:-1", "1:", 17, "    return y[1:]"),
        ("Body.size", "1.5", "1.6", 21, "    size: float = 1.6"),
        ("Body.height", "limit=3", "limit=4", 23, "    @cached(limit=4)"),
        ("Body.height", "z + 1", "z", 26, "            return z"),
        ("Body.height.inner", "z + 1", "z", 26, "            return z"),
        ("Body.height", "self.size * RATIO", "self.size, RATIO", 28, "        return inner(2) + (self.size, RATIO)"),
    ],
)
def test_code_is_found_by_its_definition_and_what_it_says_and_the_rest_of_the_file_stays(
    small, definition, find, replace, line, changed
):
    text = Mutant(find, replace, ("t",), "why", definition).apply(Project(small))
    differing = [
        n for n, pair in enumerate(zip(text.splitlines(), SOURCE.splitlines(), strict=True), 1) if len(set(pair)) > 1
    ]
    assert differing == [line]
    assert text.splitlines()[line - 1] == changed


def test_a_statement_becomes_several_and_a_call_keeps_its_precedence(small):
    text = Mutant("return y", "y = 2\nreturn y", ("t",), "why", "twice").apply(Project(small))
    assert "    if y > 0:\n        y = 2\n        return y\n    elif" in text
    source = "def f(a, b, c):\n    return a - b * c\n"
    (small / "body/two.py").write_text(source)
    text = Mutant("b * c", "b + c", ("t",), "why", "f").apply(Project(small))
    assert text == source.replace("b * c", "(b + c)")


def test_one_of_several_is_told_by_its_occurrence(small):
    first = Mutant("self.size", "0", ("t",), "why", "Body.width", occurrence=1)
    assert "return 0 + self.size\n" in first.apply(Project(small))
    second = Mutant("self.size", "0", ("t",), "why", "Body.width", occurrence=2)
    assert "return self.size + 0\n" in second.apply(Project(small))
    for definition, occurrence in (("Body.width", 3), ("Body.size", 1)):
        with pytest.raises(ValueError, match="times; expected"):
            Mutant("self.size", "0", ("t",), "why", definition, occurrence=occurrence).apply(Project(small))


def test_an_entry_outlives_a_new_layout_and_a_move(small):
    fault = Mutant("x + shift", "x - shift", ("t",), "why", "twice")
    before = fault.apply(Project(small))
    moved = small / "kernels/deep/elsewhere.py"
    moved.parent.mkdir(parents=True)
    rewritten = ast.unparse(ast.parse(SOURCE))  # on other lines, with other quotes and without comments
    moved.write_text(rewritten)
    (small / "body/one.py").unlink()
    project = Project(small)
    assert fault.path(project) == "kernels/deep/elsewhere.py"
    assert comparable(ast.parse(fault.apply(project))) == comparable(ast.parse(before))


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ({"find": "x * shift"}, "0 times; expected once"),
        ({"find": "y"}, "6 times; expected once, or an occurrence"),
        ({"find": "y + 1"}, "0 times"),  # within an f-string
        ({"find": "x +"}, "expected two expressions"),
        ({"find": "x + shift", "replace": "(x)  +  shift"}, "the same as before; expected a change"),
        ({"find": "y > 0", "replace": "pass"}, "0 times"),
        ({"definition": "thrice"}, "thrice: found in none; expected in one file"),
        ({"definition": "Body.size", "file": "two.py"}, "Body.size in two.py: found in none"),
        ({"definition": "", "file": "body/gone.py"}, "no such file"),
    ],
)
def test_code_that_is_gone_or_not_alone_is_refused(small, entry, said):
    fault = Mutant(**{"find": "y", "replace": "x", "tests": ("t",), "why": "", "definition": "twice", **entry})
    with pytest.raises(ValueError, match=said):
        fault.apply(Project(small))


def test_definitions_of_one_name_are_told_apart_by_their_files(small):
    (small / "kernels").mkdir()
    (small / "kernels/one.py").write_text("RATIO = 0.6\n")
    project = Project(small)
    with pytest.raises(ValueError, match=r"RATIO: found in body/one.py, kernels/one.py; expected in one file"):
        project.file_with("RATIO")
    with pytest.raises(ValueError, match=r"RATIO in one.py: found in body"):
        project.file_with("RATIO", "one.py")
    with pytest.raises(ValueError, match=r"RATIO in kern: found in none"):
        project.file_with("RATIO", "kern")
    assert project.file_with("RATIO", "kernels") == project.file_with("RATIO", "kernels/one.py") == "kernels/one.py"


def test_files_that_are_no_python_are_changed_as_text(small):
    fault = Mutant('"right": 2', '"right": 1', ("t",), "why", file="body/table.json")
    assert fault.apply(Project(small)) == '{"left": 1, "right": 1}'
    for find, replace, said in (('"up"', "", "0 times"), (": ", "", "2 times"), ("1", "1", "expected a change")):
        with pytest.raises(ValueError, match=said):
            Mutant(find, replace, ("t",), "why", file="body/table.json").apply(Project(small))


def test_only_what_has_changed_since_a_commit_is_tried(small, monkeypatch):
    monkeypatch.setattr(mutants, "ROOT", small)
    (small / "scripts").mkdir()
    listed = [Mutant("0.6", "1", ("t",), "", "RATIO"), Mutant("1.5", "1", ("t",), "", "Body.size")]
    entry = "[[mutant]]\ndefinition = '{0.definition}'\nfind = '{0.find}'\nreplace = '{0.replace}'\n"
    (small / "scripts/mutants.toml").write_text("".join(entry.format(mutant) for mutant in listed))
    for command in (
        ["init", "-q"],
        ["add", "."],
        ["-c", "user.name=t", "-c", "user.email=t@t", "commit", "-qm", "one"],
    ):
        subprocess.run(["git", *command], cwd=small, check=True)
    assert mutants.changed_since("HEAD", listed, Project(small)) == []
    new = Mutant("0.5", "0", ("t",), "", "twice.shift")
    assert mutants.changed_since("HEAD", [*listed, new], Project(small)) == [new]
    (small / "body/one.py").write_text(SOURCE.replace("0.6", "(0.6)").replace("size: float = 1.5", "size: int = 1.5"))
    assert mutants.changed_since("HEAD", listed, Project(small)) == [listed[1]]
    (small / "body/one.py").rename(small / "body/two.py")
    assert mutants.changed_since("HEAD", listed, Project(small)) == listed
    with pytest.raises(subprocess.CalledProcessError):
        mutants.changed_since("nothing", listed, Project(small))


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
    ("definition", "find", "replace", "test", "kind", "said"),
    [
        ("add", "a + b", "a - b", "test_add", "killed", "test_add"),
        ("add", "a + b", "a - b", "test_nothing", "survived", "1 passed"),
        ("add", "a * b", "a - b", "test_add", "error", "0 times"),
        ("add", "a + b", "a - b", "test_gone", "error", "not found"),
        ("unused", "1", "2", "test_add", "error", "not imported"),
    ],
)
def test_a_mutant_is_killed_survives_or_is_an_error(project, definition, find, replace, test, kind, said):
    mutant = Mutant(find, replace, (f"tests/test_sums.py::{test}",), "", definition)
    files = Project(project)
    path = project / mutant.path(files)
    before = path.read_text()
    became, told = mutants.try_mutant(mutant, project, files)
    assert (became, said in told) == (kind, True), told
    assert path.read_text() == before
