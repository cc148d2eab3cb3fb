"""The layout holds: each wing imports from those below it alone, and a name is defined once.

``LEVELS`` is the order of the wings, lowest first.
"""

from __future__ import annotations

import ast
import re
import sys
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from importlib.util import resolve_name
from pathlib import Path

import pytest

import warp_partdr

ROOT = Path(__file__).resolve().parents[2]
# Folder of the repository: its place in the package.
SOURCES = {"warp_partdr": "", "kernels": "kernels.", "body": "body.", "demos/viewer": "viewer."}
LEVELS = (
    "reference",
    "errors",
    "kernels",
    "interop",
    "files",
    "cameras",
    "body",
    "metrics",
    "inputs",
    "render",
    "models",
    "networks",
    "solve",
    "pipelines",
    "results",
    "bulk",
    "lab",
    "cli",
    "viewer",
)
BESIDE_THE_WINGS = {"__init__", "__main__", "cameras", "errors", "metrics"}
QUESTIONS = r"(What|Which|How|Whether|Where|Whose)\b"

pytestmark = pytest.mark.skipif(not (ROOT / "pyproject.toml").exists(), reason="needs the repository around the tests")


@cache
def modules() -> dict[str, Path]:
    """Files by their dotted name in the package; of a folder, that of its ``__init__.py``."""
    found = {}
    for folder, prefix in SOURCES.items():
        for path in (ROOT / folder).rglob("*.py"):
            name = prefix + path.relative_to(ROOT / folder).with_suffix("").as_posix().replace("/", ".")
            found[re.sub(r"\.?__init__$", "", name)] = path
    return found


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def imports() -> dict[str, set[str]]:
    """Imports of each module from the package, also inside functions and for type checkers alone."""
    graph: dict[str, set[str]] = {}
    for name, path in modules().items():
        graph[name] = {target for node in ast.walk(tree(path)) for target in _targets(name, path, node)}
    return graph


def _targets(name: str, path: Path, node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.Import):
        yield from (alias.name.partition("warp_partdr.")[2] for alias in node.names if "warp_partdr." in alias.name)
    if isinstance(node, ast.ImportFrom):
        package = name if path.name == "__init__.py" else name.rpartition(".")[0]
        source = resolve_name("." * node.level + (node.module or ""), f"warp_partdr.{package}".rstrip("."))
        top, _, source = source.partition(".")
        inner = [f"{source}.{alias.name}".lstrip(".") for alias in node.names if top == "warp_partdr"]
        yield from (each if each in modules() else source for each in inner)


def level(name: str) -> int:
    return LEVELS.index(wing(name))


def product_files() -> list[Path]:
    folders = ("warp_partdr", "kernels", "body", "demos", "benchmarks", "scripts")
    return [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]


def short(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def test_few_modules_lie_beside_the_wings():
    assert {path.stem for path in (ROOT / "warp_partdr").glob("*.py")} == BESIDE_THE_WINGS


def test_every_wing_has_its_level_and_says_what_it_holds():
    wings = {wing(name) for name in modules()} - {"", "__main__"}
    assert wings == set(LEVELS)
    for name, path in modules().items():
        assert ast.get_docstring(tree(path)), f"{name}: no docstring"


def test_imports_go_down():
    top = {"", "__main__"}  # the table of public names, and the launcher
    upward = [
        f"{name} -> {target}"
        for name, targets in imports().items()
        for target in targets
        if name not in top and target and level(target) > level(name)
    ]
    assert sorted(upward) == []


def wing(name: str) -> str:
    return name.partition(".")[0]


def test_the_formula_book_is_read_by_tests_alone():
    readers = {name for name, targets in imports().items() if "reference" in map(wing, targets)}
    assert sorted(name for name in readers if wing(name) != "reference") == []
    tools = set(product_files()) - set(modules().values())
    assert {"benchmarks", "demos", "scripts"} <= {path.parent.name for path in tools}
    assert [short(path) for path in tools if "warp_partdr.reference" in path.read_text(encoding="utf-8")] == []


def test_the_formula_book_needs_numpy_alone():
    foreign = set()
    for name, path in modules().items():
        for node in ast.walk(tree(path)) if wing(name) == "reference" else ():
            if isinstance(node, ast.Import):
                foreign |= {wing(alias.name) for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                foreign.add(wing(node.module or ""))
    assert foreign - set(sys.stdlib_module_names) == {"numpy"}
    assert {wing(target) for name, targets in imports().items() if wing(name) == "reference" for target in targets} == {
        "reference"
    }


def test_no_circles():
    graph = {name: targets - {""} for name, targets in imports().items() if name}  # "": a lazy table of names
    done: set[str] = set()
    path: list[str] = []

    def visit(name: str) -> None:
        assert name not in path, f"circle: {' -> '.join([*path[path.index(name) :], name])}"
        if name in done:
            return
        path.append(name)
        for target in sorted(graph.get(name, ())):
            visit(target)
        done.add(path.pop())

    for name in sorted(graph):
        visit(name)


def public_definitions() -> dict[str, set[str]]:
    """Modules that define each public top-level function and class, type aliases and constants aside."""
    where: dict[str, set[str]] = defaultdict(set)
    for name, path in modules().items():
        for node in tree(path).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
                where[node.name].add(name)
    return where


def test_a_name_is_defined_once():
    twice = {name: sorted(where) for name, where in public_definitions().items() if len(where) > 1}
    assert twice == {}


def test_each_public_name_is_shown_at_work():
    """In the code of a page, in a tutorial script, or in the notebook."""
    names = [name for name in warp_partdr.__all__ if not name.startswith("_")]
    pages = [*(ROOT / "docs").glob("*.md"), ROOT / "README.md"]
    blocks = [block for page in pages for block in re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL)]
    code = "\n".join([*blocks, *(path.read_text() for path in (ROOT / "demos").glob("*.py"))])
    code += (ROOT / "demos" / "partdr.ipynb").read_text()
    assert [name for name in names if not re.search(rf"\b{name}\b", code)] == []


def test_docstrings_begin_with_a_noun_or_a_verb():
    texts = []
    for path in [*product_files(), *sorted((ROOT / "tests").rglob("*.py"))]:
        for node in ast.walk(tree(path)):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                text = ast.get_docstring(node)
                if text:
                    texts.append((short(path), text.splitlines()[0]))
    questions = [text for text in texts if re.match(QUESTIONS, text[1])]
    assert len(questions) <= 0.02 * len(texts), questions
