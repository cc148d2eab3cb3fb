"""Figures as tables on the screen, and as JSON on disk."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

TABLE_WIDTH = 165  # [characters]; narrower ones lose columns


def wide_console() -> Console:
    """A console as wide as the tables, whatever the screen is."""
    from rich.console import Console

    return Console(width=max(Console().width, TABLE_WIDTH), highlight=False)


def save_figures(figures: Mapping[str, Any], path: Path) -> None:
    """Write JSON, in a folder made if it is not there; arrays, shape (N,), with five digits."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(figures, indent=1, default=_rounded) + "\n", encoding="utf-8")


def _rounded(values: np.ndarray) -> list[float]:
    return [float(f"{value:.5g}") for value in values]


def make_table(
    title: str,
    headings: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    left: Collection[int] = (0,),
    sections: bool = False,
) -> Table:
    """A table for the screen, without the columns that are empty in every row.

    Args:
        title: Title above the table.
        headings: Headings of the columns.
        rows: Rows with a cell for each heading.
        left: Columns with words in them, which are set left. Numbers are set right.
        sections: True puts a space between rows with different first cells.
    """
    from rich.box import SIMPLE_HEAD
    from rich.markup import escape  # "[ms]" is a unit
    from rich.table import Table

    table = Table(title=escape(title), title_justify="left", title_style="bold", box=SIMPLE_HEAD, pad_edge=False)
    used = [index for index in range(len(headings)) if any(row[index] for row in rows)]
    for index in used:
        table.add_column(escape(headings[index]), justify="left" if index in left else "right", no_wrap=index in left)
    for index, row in enumerate(rows):
        is_last = index + 1 == len(rows) or rows[index + 1][0] != row[0]
        table.add_row(*(escape(row[column]) for column in used), end_section=sections and is_last)
    return table


def print_tables(
    head: Iterable[str], tables: Iterable[Table], remarks: Iterable[str], notes: Iterable[str], console: Console
) -> None:
    """Tables that have rows, between lines of text; notes say how to read them."""
    for line in head:
        console.print(line, markup=False)
    for table in tables:
        if table.row_count:
            console.print()
            console.print(table)
    console.print()
    for line in remarks:
        console.print(line, markup=False)
    for line in notes:
        console.print(line, markup=False, style="dim")


def format_time(seconds: float) -> str:
    """A duration in the unit that suits: "12.3 µs", "4.56 ms", "7.89 s"."""
    for unit, scale in (("s", 1.0), ("ms", 1e-3)):
        if abs(seconds) >= scale:
            return f"{seconds / scale:.3g} {unit}" if abs(seconds) < 1e3 * scale else f"{seconds / scale:.0f} {unit}"
    return f"{max(seconds, 0.0) * 1e6:.3g} µs"
