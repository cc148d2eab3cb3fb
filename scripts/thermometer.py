"""Figures of the house's health, of revisions side by side: python scripts/thermometer.py [REVISION ...].

The last column is the working tree. Figures are no limits; they tell where to look. All lines of Python files count.

* Laboratory: ``synthetic``, ``evaluation``, ``benchmark``, ``training``, ``bench``, ``lab``, and the folders scripts/
  and benchmarks/. The product is the rest of the package.
* Rooms: folders and modules directly in the package; a room is on the floor above all rooms that it imports from. An
  arrow leads from a room to one that it imports from; imports inside functions count.
* Carriers: untyped tuples and dict splats that carry arguments, as ``tests/house/carriers.py`` finds them.
* Clever lines: statements of the package that are an assignment to a tuple of three names or more, an assignment of
  several values to several names at once, an unpacked generator or comprehension, or a call with a splatted local.
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import subprocess
import sys
import tarfile
import tempfile
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from importlib.util import resolve_name
from pathlib import Path
from typing import TypeGuard

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests" / "house"))

from carriers import find_carriers  # noqa: E402

PACKAGE = "warp_partdr"
LABORATORY = {"bench", "benchmark", "evaluation", "lab", "synthetic", "training"}
TOOLS = ("scripts", "benchmarks")
FLAGSHIPS = (
    "fit_body",
    "fit_photo",
    "fit_film",
    "fit_scene",
    "refine_mesh",
    "predict_bodies",
    "make_dataset",
    "evaluate",
)


@dataclass(frozen=True)
class House:
    """A checkout of the repository."""

    root: Path

    @cached_property
    def modules(self) -> dict[str, Path]:
        """Files of the package by their dotted names in it; of a folder, its ``__init__.py``."""
        project = tomllib.loads((self.root / "pyproject.toml").read_text(encoding="utf-8"))
        folders = project["tool"]["setuptools"]["package-dir"]
        found = {}
        for package, folder in folders.items():
            for path in (self.root / folder).rglob("*.py"):
                inner = path.relative_to(self.root / folder).with_suffix("").as_posix().replace("/", ".")
                name = f"{package}.{inner}".removeprefix(f"{PACKAGE}.")
                found[re.sub(r"\.?\b__init__$", "", name)] = path
        return found

    @cached_property
    def trees(self) -> dict[str, ast.Module]:
        """Parsed modules of the package."""
        return {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in self.modules.items()}

    @cached_property
    def arrows(self) -> set[tuple[str, str]]:
        """Pairs of rooms, of which the first one imports from the second one."""
        pairs = set()
        for name in self.modules:
            for target in self.imports(name):
                pairs.add((room(name), room(target)))
        return {(one, other) for one, other in pairs if one != other and one not in ("", "__main__") and other}

    def imports(self, name: str) -> Iterator[str]:
        """Modules of the package that a module imports from."""
        is_folder = self.modules[name].name == "__init__.py"
        package = f"{PACKAGE}.{name if is_folder else name.rpartition('.')[0]}".rstrip(".")
        for node in ast.walk(self.trees[name]):
            if isinstance(node, ast.Import):
                sources = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                source = resolve_name("." * node.level + (node.module or ""), package)
                sources = [f"{source}.{alias.name}" for alias in node.names]
            else:
                continue
            for source in sources:
                if source.startswith(f"{PACKAGE}."):
                    yield source.removeprefix(f"{PACKAGE}.")

    def floors(self) -> int:
        """Number of floors."""
        below: dict[str, set[str]] = {each: set() for each in self.rooms()}
        for one, other in self.arrows:
            below[one].add(other)
        floors = 0
        while below:
            lowest = {each for each, others in below.items() if not others & below.keys()}
            if not lowest:
                raise SystemExit(f"a circle of rooms: {', '.join(sorted(below))}")
            below = {each: others for each, others in below.items() if each not in lowest}
            floors += 1
        return floors

    def rooms(self) -> set[str]:
        """Rooms of the package."""
        return {room(name) for name in self.modules} - {"", "__main__"}

    def lines(self, *folders: str) -> int:
        """Lines of the Python files in folders of the repository."""
        paths = [path for folder in folders for path in (self.root / folder).rglob("*.py")]
        return sum(map(count_lines, paths))

    def figures(self) -> dict[str, str]:
        """All figures, by their names."""
        of_laboratory = [path for name, path in self.modules.items() if room(name) in LABORATORY]
        laboratory = sum(map(count_lines, of_laboratory))
        package = sum(map(count_lines, self.modules.values()))
        carriers = [carrier for tree in self.trees.values() for carrier in find_carriers(tree)]
        clever = sum(count_clever(tree) for tree in self.trees.values())
        public = self.public_names()
        return {
            "product, lines": f"{package - laboratory:,}",
            "laboratory, lines": f"{laboratory + self.lines(*TOOLS):,}",
            "tests, lines": f"{self.lines('tests'):,}",
            "carriers of arguments": f"{len(carriers)}",
            "flagship calls that are public": f"{sum(name in public for name in FLAGSHIPS)} of {len(FLAGSHIPS)}",
            "public names": f"{len(public)}",
            "clever lines in a thousand": f"{1000 * clever / package:.1f}",
            "rooms": f"{len(self.rooms())}",
            "floors": f"{self.floors()}",
            "modules": f"{len(self.modules)}",
            "arrows between rooms": f"{len(self.arrows)}",
        }

    def public_names(self) -> set[str]:
        """Names in the lists ``__all__`` and the tables ``_EXPORTS`` of the package and of modules directly in it."""
        names: set[str] = set()
        for name, path in self.modules.items():
            if name and (room(name) != name or path.name == "__init__.py"):
                continue
            for node in self.trees[name].body:
                if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) in ("__all__", "_EXPORTS"):
                    if isinstance(node.value, ast.Dict):
                        names |= {key.value for key in node.value.keys if is_text(key)}
                    elif isinstance(node.value, ast.List):
                        names |= {name.value for name in node.value.elts if is_text(name)}
        return names


def is_text(node: ast.expr | None) -> TypeGuard[ast.Constant]:
    """True for a text that is written out."""
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def room(module: str) -> str:
    """The room of a module."""
    return module.partition(".")[0]


def count_lines(path: Path) -> int:
    """Lines of a file."""
    return len(path.read_text(encoding="utf-8").splitlines())


def count_clever(tree: ast.Module) -> int:
    """Statements that do several things at once."""
    return sum(is_clever(node) for node in ast.walk(tree) if isinstance(node, ast.stmt))


def is_clever(statement: ast.stmt) -> bool:
    """True for a clever line, as the module's docstring says."""
    if isinstance(statement, ast.Assign):
        for target in statement.targets:
            if isinstance(target, ast.Tuple | ast.List):
                many = len(target.elts) >= 3
                if many or isinstance(statement.value, ast.Tuple | ast.GeneratorExp | ast.ListComp):
                    return True
    return any(map(is_splat, own_expressions(statement)))


def is_splat(node: ast.expr) -> bool:
    """True for a call with a splatted local or an unpacked generator."""
    if not isinstance(node, ast.Call):
        return False
    splatted = [argument.value for argument in node.args if isinstance(argument, ast.Starred)]
    splatted += [keyword.value for keyword in node.keywords if keyword.arg is None]
    return any(isinstance(value, ast.Name | ast.GeneratorExp | ast.ListComp) for value in splatted)


def own_expressions(node: ast.AST) -> Iterator[ast.expr]:
    """Expressions of a statement, without those of statements in it."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.expr):
            yield child
        if not isinstance(child, ast.stmt):
            yield from own_expressions(child)


def checkout(revision: str, folder: Path) -> House:
    """The files of a revision, in a folder."""
    done = subprocess.run(["git", "archive", revision], cwd=ROOT, capture_output=True)
    if done.returncode:
        raise SystemExit(done.stderr.decode().strip())
    with tarfile.open(fileobj=io.BytesIO(done.stdout)) as archive:
        archive.extractall(folder, filter="data")
    return House(folder)


def main(given: list[str] | None = None) -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description="Figures of the house's health, of revisions and the working tree.")
    parser.add_argument("revisions", nargs="*", metavar="REVISION", help="such as main, or 361dc54")
    revisions = parser.parse_args(given).revisions
    columns = {}
    for revision in revisions:
        with tempfile.TemporaryDirectory() as folder:
            columns[revision] = checkout(revision, Path(folder)).figures()
    columns["here"] = House(ROOT).figures()
    print(f"| | {' | '.join(columns)} |")
    print("|---|" + "---:|" * len(columns))
    for name in columns["here"]:
        print(f"| {name} | {' | '.join(figures[name] for figures in columns.values())} |")


if __name__ == "__main__":
    main()
