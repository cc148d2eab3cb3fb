"""Time per body on a logarithmic axis: a line for each run and each kernel, a mark for each B."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import TYPE_CHECKING

from ..drawing import BLACK, SHAPES, WHITE, Canvas, log_ticks
from ..machine import in_words
from .report import KERNELS, OTHERS, TARGETS, KernelReport, TimedRow

if TYPE_CHECKING:
    from PIL.Image import Image

_LINE, _MARK, _FONT = 19, 4, 13  # [px] height of a line, half a mark, letters
_STEP = 3  # [px] from the marks of one B down to those of the next, which they would hide
_NAMES, _AXIS, _MARGIN, _REST = 250, 420, 16, 44  # [px] width of names, of the axis, and left and right of them
_PANEL = _MARGIN + _NAMES + _AXIS + _REST
_TOP, _BOTTOM = 88, 58  # [px]
_GRID, _GREY = (210, 210, 210), (150, 150, 150)
_FILLS = (BLACK, WHITE, _GREY, BLACK)  # of the marks of each B, with their shapes told apart in grey


@dataclass(frozen=True)
class _Line:
    """A name and its marks; a heading has none."""

    name: str
    marks: dict[int, float]  # B: time per body [s]


def draw_kernel_chart(report: KernelReport) -> Image:
    """Whole runs on the left, their kernels on the right.

    Pictures of another size than most have no marks.
    """
    rows = [row for row in report.rows if row.group in (TARGETS, OTHERS, KERNELS) and row.timing.median > 0]
    sizes = [row.size for row in rows]
    rows = [row for row in rows if row.size == max(set(sizes), key=sizes.count)]
    runs = sorted((row for row in rows if row.group != KERNELS), key=attrgetter("renderer"))
    kernels = [row for row in rows if row.group == KERNELS]
    panels = [_lines(runs, "name", "renderer"), _lines(kernels, "renderer", "name")]
    batches = sorted({row.batch for row in rows})
    canvas = Canvas(len(panels) * _PANEL, _TOP + _LINE * max(map(len, panels)) + _BOTTOM, _FONT)

    names = list(report.machine.items())
    for line, part in enumerate((names[:3], names[3:])):
        canvas.text(_MARGIN, 8 + 18 * line, in_words(dict(part)), "la")
    x: float = _MARGIN
    for index, batch in enumerate(batches):
        _draw_mark(canvas, x + _MARK, 62, index)
        x += 3 * _MARK + round(canvas.text(x + 3 * _MARK, 62, f"B = {batch}")) + 24
    if rows:
        canvas.text(x, 62, f"pictures of {rows[0].size} by {rows[0].size} px")
    for index, lines in enumerate(panels):
        _draw_panel(canvas, index * _PANEL + _MARGIN, lines, batches)
    return canvas.image()


def _lines(rows: Sequence[TimedRow], heading: str, name: str) -> list[_Line]:
    """Rows that differ in B alone share a line; those with one heading stand together."""
    headings: dict[str, dict[str, dict[int, float]]] = {}
    for row in rows:
        marks = headings.setdefault(getattr(row, heading), {}).setdefault(getattr(row, name), {})
        marks[row.batch] = row.timing.median / row.batch
    lines = []
    for title, group in headings.items():
        lines.append(_Line(title, {}))
        lines += [_Line(f"   {label}", marks) for label, marks in group.items()]
    return lines


def _draw_panel(canvas: Canvas, left: int, lines: Sequence[_Line], batches: Sequence[int]) -> None:
    values = [value for line in lines for value in line.marks.values()]
    if not values:
        return
    low, high = math.floor(math.log10(min(values))), math.ceil(math.log10(max(values)))
    high = max(high, low + 1)
    start, bottom = left + _NAMES, _TOP + _LINE * len(lines)

    def place(seconds: float) -> float:
        return start + _AXIS * (math.log10(seconds) - low) / (high - low)

    for digit, value in log_ticks(low, high):
        x = place(value)
        if digit == 1:
            canvas.line([(x, _TOP), (x, bottom)], _GREY)
            canvas.text(x, bottom + 6, f"{1e6 * value:,.9g}", "ma")
        else:
            canvas.line([(x, _TOP), (x, bottom)], _GRID, 0.5)
    canvas.text(start + _AXIS / 2, bottom + 28, "median time per body [microseconds]", "ma")
    for index, line in enumerate(lines):
        y = _TOP + _LINE * (index + 0.5)
        canvas.text(left, y, line.name, bold=not line.marks)
        xs = [place(value) for value in line.marks.values()]
        if xs:
            canvas.line([(start, y), (max(xs), y)], _GRID)
        for batch, x in zip(line.marks, xs, strict=True):
            index = batches.index(batch)
            _draw_mark(canvas, x, y + _STEP * (index - (len(batches) - 1) / 2), index)


def _draw_mark(canvas: Canvas, x: float, y: float, index: int) -> None:
    """The mark of one B, of which four differ."""
    canvas.mark((x, y), SHAPES[index % len(SHAPES)], _MARK, _FILLS[index % len(_FILLS)], BLACK)
