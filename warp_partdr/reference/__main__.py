"""``python -m warp_partdr.reference [N]``: the formula book's index, or one of its equations."""

from __future__ import annotations

import argparse
import inspect
import sys
from importlib import import_module

from .index import EQUATIONS


def print_equations(arguments: list[str] | None = None) -> int:
    """Print what is asked for; the exit code is 2 where there is no such equation."""
    parser = argparse.ArgumentParser(prog="python -m warp_partdr.reference", description=__doc__)
    parser.add_argument("number", metavar="N", nargs="?", help="3 to 6 or 8 to 19; by default, the table of all")
    parser.add_argument("--markdown", action="store_true", help="the table of docs/reference/formula_book.md")
    options = parser.parse_args(arguments)
    if options.number is None:
        print(markdown() if options.markdown else table())
        return 0
    numbers = {str(number): number for number in EQUATIONS}
    if options.number not in numbers:
        print(f"N: {options.number}; expected 3 to 6 or 8 to 19 (1, 2 and 7 only name functions)", file=sys.stderr)
        return 2
    print(page(numbers[options.number]))
    return 0


def table() -> str:
    """All equations, a line each."""
    rows = [f"{number:>2}  {each.title:<26}{each.formula}" for number, each in EQUATIONS.items()]
    return "\n".join([*rows, "", "python -m warp_partdr.reference N leads to function, kernels, torch and tests."])


def page(number: int) -> str:
    """One equation: formula, the function's docstring, and the names that the index has."""
    each = EQUATIONS[number]
    module, _, name = each.book.partition(".")
    function = getattr(import_module(f"{__package__}.{module}"), name)
    entries = {
        "function": [f"{function.__module__}.{name}, line {inspect.getsourcelines(function)[1]}"],
        "kernels": [f"warp_partdr.{name}" for name in each.kernels],
        "torch": [f"warp_partdr.{name}" for name in each.torch],
        "tests": each.tests,
    }
    lines = [f"Equation {number}: {each.title}", "", f"    {each.formula}", "", inspect.getdoc(function) or "", ""]
    for name, values in entries.items():
        lines += [f"{name if k == 0 else '':<10}{value}" for k, value in enumerate(values)]
    return "\n".join(lines)


def markdown() -> str:
    """All equations as a table with links, as docs/reference/formula_book.md has it."""
    lines = ["| eq. | formula | book | kernels | torch | tests |", "|---|---|---|---|---|---|"]
    for number, each in EQUATIONS.items():
        module, _, name = each.book.partition(".")
        cells = [
            str(number),
            f"{each.title}: `{each.formula}`",
            f"[`{name}`](../../warp_partdr/reference/{module}.py)",
            *(", ".join(f"`{entry}`" for entry in entries) for entries in (each.kernels, each.torch)),
            ", ".join(f"[`{test.partition('::')[2]}`](../../{test.partition('::')[0]})" for test in each.tests),
        ]
        lines.append(f"| {' | '.join(cell or 'none' for cell in cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(print_equations())
