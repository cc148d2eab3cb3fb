"""The index of the formula book, index.toml: from an equation to its function, kernels, torch functions and tests."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Equation:
    """One numbered equation of the paper.

    Attributes:
        title: Title of a few words.
        formula: Formula of the paper, as plain text.
        latex: Formula of the paper in LaTeX.
        book: The function of this book, whose docstring tells the letters and the differences from the paper.
        kernels: Warp kernels and device functions; none where torch alone does it.
        torch: The functions that users call.
        tests: File and name of each test that holds kernels and torch functions to the book.
    """

    title: str
    formula: str
    latex: str
    book: str
    kernels: list[str]
    torch: list[str]
    tests: list[str]


_ENTRIES = tomllib.loads(Path(__file__).with_name("index.toml").read_text(encoding="utf-8"))
EQUATIONS = {int(number): Equation(**entry) for number, entry in _ENTRIES.items()}
