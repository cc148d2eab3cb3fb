"""Finds an expression or a statement of a function by what it says, wherever the function stands, and replaces it.

Two pieces of code are the same here if their syntax trees are: spaces, line breaks, quotes, redundant parentheses and
comments do not count. ``mutants.py`` uses this for its faults.

A *definition* is a function (``function``, ``outer.inner``), a method (``Class.method``), a class, a variable of a
module or a class (``_RATIO``, ``Class.attribute``), or a parameter that has a default (``function.parameter``). It
holds its decorators, too. Code within f-strings is not looked at: before Python 3.12 their parts have no positions.
"""

from __future__ import annotations

import ast
import os
import textwrap
from collections import defaultdict
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

FOLDERS = ("benchmarks", "body", "demos", "kernels", "warp_partdr")  # where definitions are looked for


@dataclass(frozen=True)
class Place:
    """Node of a syntax tree, and where its parent keeps it."""

    node: ast.AST
    parent: ast.AST
    field: str
    index: int | None  # in the parent's list, if it keeps one

    def put(self, nodes: list[ast.AST]) -> None:
        """Put other nodes there: one, or several statements for a statement."""
        kept = getattr(self.parent, self.field)
        if self.index is None:
            setattr(self.parent, self.field, nodes[0])
        else:
            setattr(self.parent, self.field, [*kept[: self.index], *nodes, *kept[self.index + 1 :]])


@dataclass(frozen=True)
class Match:
    """Piece of code that was looked for, and what is to stand there."""

    place: Place
    replacement: list[ast.AST]

    @property
    def span(self) -> tuple[int, int, int, int]:
        """First and last line, and the bytes of them, in the order of the source."""
        node = self.place.node
        return node.lineno, node.col_offset, node.end_lineno, node.end_col_offset


def places_below(node: ast.AST) -> Iterator[Place]:
    """All nodes below a node, but for those within f-strings."""
    for field, value in ast.iter_fields(node):
        children = list(enumerate(value)) if isinstance(value, list) else [(None, value)]
        for index, child in children:
            if isinstance(child, ast.AST):
                yield Place(child, node, field, index)
                if not isinstance(child, ast.JoinedStr):
                    yield from places_below(child)


def comparable(node: ast.AST) -> str:
    """A node's code, without positions; ``x`` that is read and ``x`` that is assigned are the same."""
    return ast.dump(node).replace("ctx=Store()", "ctx=Load()").replace("ctx=Del()", "ctx=Load()")


def readings(code: str) -> dict[str, list[ast.AST]]:
    """The nodes that a piece of code can be, by kind: ``x = 1`` is a keyword argument of a call, or a statement."""
    found: dict[str, list[ast.AST]] = {}
    code = textwrap.dedent(code).strip()
    for kind, text in (("expression", f"(\n{code}\n)"), ("argument", f"_(\n{code}\n)"), ("slice", f"_[{code}]")):
        try:
            tree = ast.parse(text, mode="eval").body
        except SyntaxError:
            continue
        if kind == "expression":
            found[kind] = [tree]
        elif kind == "argument" and isinstance(tree, ast.Call):
            found[kind] = [*tree.args, *tree.keywords]
        elif kind == "slice" and isinstance(tree, ast.Subscript):
            found[kind] = [tree.slice]
    with suppress(SyntaxError):
        found["statement"] = list(ast.parse(code).body)
    return found


def matches(roots: list[Place], find: str, replace: str) -> list[Match]:
    """The places where a piece of code stands, in the order of the source.

    Raises:
        ValueError: If one can't replace the other.
    """
    wanted, others = readings(find), readings(replace)
    searched: list[tuple[type, str, list[ast.AST]]] = []
    for kind, nodes in wanted.items():
        if len(nodes) == 1 and kind in others and (kind == "statement" or len(others[kind]) == 1):
            searched.append((type(nodes[0]), comparable(nodes[0]), others[kind]))
    if not searched:
        raise ValueError(f"{find!r}, {replace!r}; expected two expressions, two statements or two arguments")
    found: dict[tuple[int, int, int, int], Match] = {}
    for root in roots:
        for place in [root, *places_below(root.node)]:
            for kind_of_node, code, replacement in searched:
                if type(place.node) is kind_of_node and comparable(place.node) == code:
                    match = Match(place, replacement)
                    found.setdefault(match.span, match)  # `f(x)` is an expression and a statement at one place
    return [found[span] for span in sorted(found)]


class Module:
    """One Python file: its text, its tree, and its definitions by name."""

    def __init__(self, text: str) -> None:
        """Keep the text; it is parsed when something is asked for."""
        self.text = text

    @cached_property
    def tree(self) -> ast.Module:
        """The file's syntax tree."""
        return ast.parse(self.text)

    @cached_property
    def definitions(self) -> dict[str, list[Place]]:
        """Definitions by qualified name; overloads, and getter and setter of a property, are one definition."""
        found: dict[str, list[Place]] = defaultdict(list)
        self._define(self.tree, "", True, found)
        return dict(found)

    def _define(self, node: ast.AST, prefix: str, variables: bool, found: dict[str, list[Place]]) -> None:
        for field, value in ast.iter_fields(node):
            for index, child in enumerate(value) if isinstance(value, list) else ():
                place = Place(child, node, field, index)
                if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                    found[prefix + child.name].append(place)
                    if not isinstance(child, ast.ClassDef):
                        self._define_parameters(child.args, f"{prefix}{child.name}.", found)
                    self._define(child, f"{prefix}{child.name}.", isinstance(child, ast.ClassDef), found)
                elif isinstance(child, ast.Assign | ast.AnnAssign | ast.AugAssign):
                    if variables:
                        for name in self._assigned(child):
                            found[prefix + name].append(place)
                elif isinstance(child, ast.stmt | ast.ExceptHandler):  # if, try, with and loops hold definitions, too
                    self._define(child, prefix, variables, found)

    @staticmethod
    def _define_parameters(arguments: ast.arguments, prefix: str, found: dict[str, list[Place]]) -> None:
        named = [*arguments.posonlyargs, *arguments.args]
        for index, argument in enumerate(named[len(named) - len(arguments.defaults) :]):
            found[prefix + argument.arg].append(Place(arguments.defaults[index], arguments, "defaults", index))
        for index, (argument, default) in enumerate(zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True)):
            if default is not None:
                found[prefix + argument.arg].append(Place(default, arguments, "kw_defaults", index))

    @staticmethod
    def _assigned(statement: ast.Assign | ast.AnnAssign | ast.AugAssign) -> list[str]:
        targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
        return [node.id for target in targets for node in ast.walk(target) if isinstance(node, ast.Name)]

    @property
    def statements(self) -> list[Place]:
        """All of the file, definitions or not."""
        return [Place(node, self.tree, "body", index) for index, node in enumerate(self.tree.body)]

    def code(self, definition: str) -> list[str]:
        """A definition's code, to be compared; empty if there is none of that name."""
        return [comparable(place.node) for place in self.definitions.get(definition, [])]

    def replaced(self, match: Match, replace: str) -> str:
        """The file's text with other code in one place; all else stays as it is.

        Raises:
            ValueError: If the code cannot stand there, or is what stands there already.
        """
        source = self.text.encode()
        lines = source.splitlines(keepends=True)
        line, column, last_line, last_column = match.span
        start = sum(map(len, lines[: line - 1])) + column
        end = sum(map(len, lines[: last_line - 1])) + last_column
        ends = [(node.end_lineno, node.end_col_offset) for node in self.tree.body]
        outer = next(index for index, position in enumerate(ends) if position >= (line, column))
        before = comparable(self.tree.body[outer])
        intended = self._statements_with(match, outer)
        if intended == [before]:
            raise ValueError(f"{replace!r}: the same as before; expected a change")
        indented = textwrap.indent(textwrap.dedent(replace).strip(), " " * column).strip()
        for code in (indented, f"({indented})"):  # `a * b` that becomes `a + b` needs parentheses in `a * b * c`
            text = (source[:start] + code.encode() + source[end:]).decode()
            try:
                statements = ast.parse(text).body
            except SyntaxError:
                continue
            as_many = len(statements) == len(self.tree.body) - 1 + len(intended)
            if as_many and [comparable(node) for node in statements[outer : outer + len(intended)]] == intended:
                return text
        raise ValueError(f"{replace!r}: can't stand in line {line}; expected what can replace the code there")

    def _statements_with(self, match: Match, outer: int) -> list[str]:
        """Return one of the module's statements with the code within it replaced."""
        kept = getattr(match.place.parent, match.place.field)
        count = len(self.tree.body)
        match.place.put(match.replacement)
        try:
            added = len(self.tree.body) - count
            return [comparable(node) for node in self.tree.body[outer : outer + 1 + added]]
        finally:
            setattr(match.place.parent, match.place.field, kept)


class Project:
    """The Python files of a project, read once."""

    def __init__(self, folder: Path) -> None:
        """Look for the files; links to folders are not followed."""
        self.folder = folder
        self.modules: dict[str, Module] = {}  # by the path from the project's folder
        for name in FOLDERS:
            for parent, _, names in os.walk(folder / name):
                for path in (Path(parent) / name for name in sorted(names) if name.endswith(".py")):
                    self.modules[path.relative_to(folder).as_posix()] = Module(path.read_text(encoding="utf-8"))

    @cached_property
    def files_of(self) -> dict[str, list[str]]:
        """The files that have a definition, by its name."""
        found: dict[str, list[str]] = defaultdict(list)
        for path, module in sorted(self.modules.items()):
            for name in module.definitions:
                found[name].append(path)
        return dict(found)

    def file_with(self, definition: str, part: str = "") -> str:
        """The one file that has a definition.

        Args:
            definition: The definition's qualified name.
            part: Part of a path that tells files apart if several have such a definition: folders or the file's name,
                or both.

        Raises:
            ValueError: If no file has it, or several have.
        """
        files = self.files_of.get(definition, [])
        files = [path for path in files if not part or f"/{part}/" in f"/{path}/"]
        if len(files) != 1:
            where = f" in {part}" if part else ""
            found = ", ".join(files) or "none"
            raise ValueError(f"{definition}{where}: found in {found}; expected in one file")
        return files[0]
