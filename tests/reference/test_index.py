"""The formula book's index: what it leads to is there, and what it prints can be read."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path
from pkgutil import resolve_name

import pytest

from warp_partdr.reference.__main__ import markdown, print_equations
from warp_partdr.reference.index import EQUATIONS

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs/reference/formula_book.md"


@cache
def functions_in(file: str) -> set[str]:
    return {
        node.name
        for node in ast.parse((ROOT / file).read_text(encoding="utf-8")).body
        if isinstance(node, ast.FunctionDef)
    }


def test_all_equations_are_listed_except_those_that_only_name_a_function():
    assert list(EQUATIONS) == [*range(3, 7), *range(8, 20)]


@pytest.mark.parametrize("number", EQUATIONS)
def test_names_lead_somewhere(number):
    equation = EQUATIONS[number]
    assert equation.title
    assert f"eq. {number}" in resolve_name(f"warp_partdr.reference.{equation.book}").__doc__.lower()
    for name in (*equation.kernels, *equation.torch):
        found = resolve_name(f"warp_partdr.{name}")
        assert callable(found)
        module = getattr(found, "func", found).__module__  # of a kernel, its Python function's
        assert f"warp_partdr.{name}".startswith(f"{module}."), f"{name} is defined in {module}"
    assert equation.torch
    assert equation.tests
    for test in equation.tests:
        file, _, name = test.partition("::")
        assert name in functions_in(file), test


def test_each_equation_has_a_function_of_its_own():
    assert len({equation.book for equation in EQUATIONS.values()}) == len(EQUATIONS)


@pytest.mark.parametrize("arguments", [[], *([str(number)] for number in EQUATIONS)], ids=str)
def test_pages_are_readable(capsys, arguments):
    assert print_equations(arguments) == 0
    said = capsys.readouterr().out
    assert max(map(len, said.splitlines())) <= 100
    for number, equation in EQUATIONS.items():
        if arguments in ([], [str(number)]):
            assert equation.formula in said
    if arguments:
        equation = EQUATIONS[int(arguments[0])]
        for name in (equation.book, *equation.kernels, *equation.torch, *equation.tests):
            assert name in said
        # Where the function stands.
        module, _, function = equation.book.partition(".")
        line = int(re.search(r"line (\d+)", said).group(1))
        text = (ROOT / "warp_partdr" / "reference" / f"{module}.py").read_text(encoding="utf-8").splitlines()
        assert text[line - 1].startswith(f"def {function}(")


@pytest.mark.parametrize("number", ["7", "20", "x", "", "12.0"])
def test_other_numbers_are_refused_in_a_line(capsys, number):
    assert print_equations([number]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert f"N: {number};" in captured.err


def test_the_page_is_up_to_date():
    command = "python -m warp_partdr.reference --markdown"
    assert markdown() in PAGE.read_text(encoding="utf-8"), f"{PAGE.name}: table out of date; expected that of {command}"
