"""Figures as a picture: time per body on a logarithmic axis, a line for each run and each kernel, a mark for each B."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from .report import KERNELS, OTHERS, TARGETS, Report, Row

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw
    from PIL.ImageFont import FreeTypeFont, ImageFont

    _Font = FreeTypeFont | ImageFont

_SMOOTH = 2  # drawn so much larger, for smooth marks
_LINE, _MARK, _FONT = 19, 4, 13  # [px] height of a line, half a mark, letters
_STEP = 3  # [px] from the marks of one B down to those of the next, which they would hide
_NAMES, _AXIS, _MARGIN, _REST = 250, 420, 16, 44  # [px] width of names, of the axis, and left and right of them
_TOP, _BOTTOM = 88, 58  # [px]
_GRID, _BLACK, _GREY = (210, 210, 210), (0, 0, 0), (150, 150, 150)
_FILLS = (_BLACK, "white", _GREY, _BLACK)  # of the marks of each B, with their shapes told apart in grey


@dataclass(frozen=True)
class _Line:
    """A name and its marks; a heading has none."""

    name: str
    marks: dict[int, float]  # B: time per body [s]


def draw_chart(report: Report) -> Image:
    """Whole runs on the left, their kernels on the right.

    Pictures of another size than most have no marks.
    """
    from PIL import Image as PilImage
    from PIL import ImageDraw, ImageFont

    rows = [row for row in report.rows if row.group in (TARGETS, OTHERS, KERNELS) and row.timing.median > 0]
    sizes = [row.size for row in rows]
    rows = [row for row in rows if row.size == max(set(sizes), key=sizes.count)]
    panels = [
        _lines(sorted((row for row in rows if row.group != KERNELS), key=_renderer), "name", "renderer"),
        _lines([row for row in rows if row.group == KERNELS], "renderer", "name"),
    ]
    batches = sorted({row.batch for row in rows})
    width = len(panels) * (_MARGIN + _NAMES + _AXIS + _REST)
    height = _TOP + _LINE * max(map(len, panels)) + _BOTTOM
    image = PilImage.new("RGB", (width * _SMOOTH, height * _SMOOTH), "white")
    draw = ImageDraw.Draw(image)
    font, bold = (ImageFont.load_default(size * _SMOOTH) for size in (_FONT, _FONT + 2))

    names = list(report.machine.items())
    for line, part in enumerate((names[:3], names[3:])):
        text = ", ".join(value if key == "machine" else f"{key} {value}" for key, value in part)
        draw.text(_at(_MARGIN, 8 + 18 * line), text, "black", font)
    x = _MARGIN
    for index, batch in enumerate(batches):
        _draw_mark(draw, x + _MARK, 62, index)
        text = f"B = {batch}"
        draw.text(_at(x + 3 * _MARK, 62), text, "black", font, anchor="lm")
        x += 3 * _MARK + round(font.getlength(text) / _SMOOTH) + 24
    draw.text(
        _at(x, 62), f"pictures of {rows[0].size} by {rows[0].size} px" if rows else "", "black", font, anchor="lm"
    )
    for index, lines in enumerate(panels):
        _draw_panel(draw, index * (_MARGIN + _NAMES + _AXIS + _REST), lines, batches, font, bold)
    return image.resize((width, height), PilImage.Resampling.BOX)


def _renderer(row: Row) -> str:
    return row.renderer


def _lines(rows: Sequence[Row], heading: str, name: str) -> list[_Line]:
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


def _draw_panel(
    draw: ImageDraw, left: int, lines: Sequence[_Line], batches: Sequence[int], font: _Font, bold: _Font
) -> None:
    values = [value for line in lines for value in line.marks.values()]
    if not values:
        return
    low, high = math.floor(math.log10(min(values))), math.ceil(math.log10(max(values)))
    high = max(high, low + 1)
    start = left + _MARGIN + _NAMES
    bottom = _TOP + _LINE * len(lines)

    def place(seconds: float) -> float:
        return start + _AXIS * (math.log10(seconds) - low) / (high - low)

    for power in range(low, high + 1):
        x = place(10.0**power)
        draw.line([*_at(x, _TOP), *_at(x, bottom)], fill=_GREY, width=_SMOOTH)
        draw.text(_at(x, bottom + 6), f"{10.0 ** (power + 6):,.9g}", "black", font, anchor="ma")
        for digit in range(2, 10) if power < high else ():
            x = place(digit * 10.0**power)
            draw.line([*_at(x, _TOP), *_at(x, bottom)], fill=_GRID, width=1)
    draw.text(_at(start + _AXIS / 2, bottom + 28), "median time per body [microseconds]", "black", font, anchor="ma")
    for index, line in enumerate(lines):
        y = _TOP + _LINE * (index + 0.5)
        draw.text(_at(left + _MARGIN, y), line.name, "black", font if line.marks else bold, anchor="lm")
        xs = [place(value) for value in line.marks.values()]
        if xs:
            draw.line([*_at(start, y), *_at(max(xs), y)], fill=_GRID, width=_SMOOTH)
        for batch, x in zip(line.marks, xs, strict=True):
            index = batches.index(batch)
            _draw_mark(draw, x, y + _STEP * (index - (len(batches) - 1) / 2), index)


def _draw_mark(draw: ImageDraw, x: float, y: float, index: int) -> None:
    """Circle, square, triangle, diamond."""
    fill = _FILLS[index % len(_FILLS)]
    r = _MARK
    if index % 4 == 0:
        draw.ellipse([*_at(x - r, y - r), *_at(x + r, y + r)], fill=fill, outline="black", width=_SMOOTH)
        return
    corners = (
        ((x - r, y - r), (x + r, y - r), (x + r, y + r), (x - r, y + r)),
        ((x, y - r), (x + r, y + r), (x - r, y + r)),
        ((x, y - r), (x + r, y), (x, y + r), (x - r, y)),
    )[index % 4 - 1]
    draw.polygon([_at(*corner) for corner in corners], fill=fill, outline="black", width=_SMOOTH)


def _at(x: float, y: float) -> tuple[float, float]:
    return x * _SMOOTH, y * _SMOOTH
