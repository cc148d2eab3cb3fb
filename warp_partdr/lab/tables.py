"""Tables of measurements: means with their intervals, written for the screen, for Markdown and for JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..metrics import bootstrap_sum

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

TABLE_WIDTH = 165  # [characters]; narrower ones lose columns


@dataclass(frozen=True)
class Estimate:
    """A figure and its interval of 95 %.

    Formatted, it reads "41 (38–45)", and a difference (the format begins with "+") "-1.2 (-2.1 to -0.4)".
    """

    value: float
    low: float
    high: float

    def __format__(self, form: str) -> str:
        between = " to " if form.startswith("+") else "–"
        return f"{self.value:{form}} ({self.low:{form}}{between}{self.high:{form}})"

    def scaled(self, factor: float) -> Estimate:
        """Return the same figure in another unit."""
        return Estimate(factor * self.value, factor * self.low, factor * self.high)

    def to_json(self) -> dict[str, Any]:
        """Return the figure and the ends of its interval."""
        return {"value": self.value, "interval_95": [self.low, self.high]}


def estimate_mean(values: Sequence[float] | np.ndarray) -> Estimate:
    """Mean of independent people, with its interval by bootstrap.

    Args:
        values: Values of N people, shape (N,). Those that are NaN or infinite are left out.

    Raises:
        ValueError: If no value is finite.
    """
    known = np.asarray(values, dtype=np.float64)
    known = known[np.isfinite(known)]
    low, high = bootstrap_sum(known, lambda sums: sums / len(known))
    return Estimate(float(known.mean()), low, high)


def pooled_estimate(row: Mapping[str, Any], name: str) -> Estimate:
    """A figure of ``summarise`` with its interval."""
    return Estimate(row[name], *row["interval_95"][name])


Cell = str | int | float | Estimate | None


@dataclass
class FigureTable:
    """Table of figures.

    Attributes:
        title: Text above it.
        columns: Format of the numbers in each column by its heading, such as ".1f"; empty for words.
        rows: A cell for each column. None and NaN are figures that are not known.
    """

    title: str
    columns: Mapping[str, str]
    rows: list[tuple[Cell, ...]] = field(default_factory=list)

    def add(self, *cells: Cell) -> None:
        """Add a row.

        Raises:
            ValueError: If there are more or fewer cells than columns.
        """
        if len(cells) != len(self.columns):
            raise ValueError(f"cells: {len(cells)}; expected {len(self.columns)}, one for each column")
        self.rows.append(cells)

    def texts(self) -> list[list[str]]:
        """Return the rows as texts; what is not known is empty."""
        return [[_text(cell, form) for cell, form in zip(row, self.columns.values(), strict=True)] for row in self.rows]

    def on_screen(self) -> Table:
        """Return the table for the screen."""
        words = [index for index, form in enumerate(self.columns.values()) if form == ""]
        return make_table(self.title, [*self.columns], self.texts(), left=words)

    def markdown(self) -> str:
        """Return the table as a page of the documentation has it."""
        rules = ["---" if form == "" else "---:" for form in self.columns.values()]
        return "\n".join(f"| {' | '.join(row)} |" for row in ([*self.columns], rules, *self.texts()))

    def to_json(self) -> dict[str, Any]:
        """Return the title, and each row's known cells by their headings."""
        rows = [
            {name: _plain(cell) for name, cell in zip(self.columns, row, strict=True) if not _is_unknown(cell)}
            for row in self.rows
        ]
        return {"title": self.title, "rows": rows}


def _is_unknown(cell: Cell) -> bool:
    return cell is None or (isinstance(cell, float) and math.isnan(cell))


def _text(cell: Cell, form: str) -> str:
    if _is_unknown(cell):
        return ""
    return cell if isinstance(cell, str) else format(cell, form)


def _plain(cell: Cell) -> Any:
    if isinstance(cell, Estimate):
        return cell.to_json()
    return cell.item() if isinstance(cell, np.generic) else cell


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
        title: Above it.
        headings: Headings of the columns.
        rows: A cell for each heading.
        left: Columns with words in them, which are set left; numbers are set right.
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


@dataclass(frozen=True)
class RecordColumn:
    """Column of a table of records.

    Attributes:
        heading: Text above it.
        name: Name of the figure in each record.
        text: Format in which the figure is written.
    """

    heading: str
    name: str
    text: Callable[[Any], str] = str


def record_table(
    title: str, columns: Sequence[RecordColumn], records: Iterable[Mapping[str, Any]], left: Collection[int] = (0,)
) -> Table:
    """A table for the screen of records, a row each; figures that are None are left empty.

    Args:
        title: Above it.
        columns: Columns of the table.
        records: Figures by name.
        left: Columns with words in them, as of ``make_table``.
    """
    rows = [
        ["" if record[each.name] is None else each.text(record[each.name]) for each in columns] for record in records
    ]
    return make_table(title, [each.heading for each in columns], rows, left=left)


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
