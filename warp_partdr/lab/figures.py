"""Figures of a measurement: means with their intervals, and tables for the screen, for Markdown and for JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..metrics import bootstrap_sum


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
