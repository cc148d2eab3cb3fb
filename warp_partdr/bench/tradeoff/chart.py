"""The trade as one picture: time an iteration against what is wrong after it, a line for each renderer and gradient."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from ...synthetic.tradeoff_people import ANNY, ELLIPBODY
from ..renderers import COVERAGE, EXACT, PARTDR
from .plan import DISTANCE, ITERATIONS, NAMES, SIZE, Setting
from .report import Report, front

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw
    from PIL.ImageFont import FreeTypeFont, ImageFont

    _Font = FreeTypeFont | ImageFont

_SMOOTH = 2  # drawn so much larger, for smooth marks
_WIDTH, _HEIGHT = 470, 360  # [px] of a panel's axes
_LEFT, _TOP, _RIGHT, _BOTTOM = 64, 44, 22, 58  # [px] around them
_HEAD = 112  # [px] above all panels
_FONT = 14  # [px]
_GRID, _GREY, _FRONT = (225, 225, 225), (120, 120, 120), (200, 200, 200)
_MARKS = (4.0, 5.5, 7.0, 8.5)  # [px] half sizes, from the smallest picture or the fewest iterations


@dataclass(frozen=True)
class _Style:
    """How a line looks: told apart by colour, and without it by shape, filling and dashes."""

    colour: tuple[int, int, int]
    shape: str
    filled: bool
    dash: tuple[int, ...] = ()  # [px] on, off, ...


_STYLES = {
    "mesh E0": _Style((170, 170, 170), "circle", False, (2, 5)),
    "mesh E1": _Style((120, 94, 160), "square", False, (7, 5)),
    "mesh E2": _Style((0, 120, 90), "triangle", False, (12, 5)),
    "mesh E3": _Style((90, 50, 0), "diamond", False, (12, 4, 3, 4)),
    PARTDR: _Style((200, 60, 0), "square", True),
    COVERAGE: _Style((0, 90, 200), "triangle", True),
    EXACT: _Style((0, 0, 0), "circle", True),
}


@dataclass(frozen=True)
class _Panel:
    """Marks by line, from the smallest to the largest picture or from the fewest to the most iterations."""

    title: str
    across: str
    lines: dict[str, list[tuple[float, float]]]  # time [ms], what is wrong or right
    sizes: tuple[int, ...]
    higher_is_better: bool
    logarithmic: bool = False  # the upright axis


def draw_chart(report: Report) -> Image:
    """Part F1, joint error and gradient error over time: EllipBodies above, Annys and whole refinements below."""
    from PIL import Image as PilImage
    from PIL import ImageDraw, ImageFont

    panels = _panels(report)
    columns = 3
    width = columns * (_LEFT + _WIDTH + _RIGHT)
    height = _HEAD + math.ceil(len(panels) / columns) * (_TOP + _HEIGHT + _BOTTOM)
    image = PilImage.new("RGB", (width * _SMOOTH, height * _SMOOTH), "white")
    draw = ImageDraw.Draw(image)
    font, bold = (ImageFont.load_default(size * _SMOOTH) for size in (_FONT, _FONT + 2))
    _draw_head(draw, report, panels, font)
    for index, panel in enumerate(panels):
        left = (index % columns) * (_LEFT + _WIDTH + _RIGHT) + _LEFT
        _draw_panel(draw, (left, _HEAD + index // columns * (_TOP + _HEIGHT + _BOTTOM) + _TOP), panel, font, bold)
    return image.resize((width, height), PilImage.Resampling.BOX)


def _panels(report: Report) -> list[_Panel]:
    sizes = tuple(sorted({size for _, size in report.times}))
    counts = tuple(sorted({fit.setting.iterations for fit in report.fits}))
    across = "time an iteration, one body [ms]"

    def by_size(value: Callable[[Setting], float | None]) -> dict[str, list[tuple[float, float]]]:
        lines: dict[str, list[tuple[float, float]]] = {}
        for setting in report.settings():
            found = value(setting)
            if found is not None:
                lines.setdefault(setting.name, []).append((1e3 * report.time(setting), found))
        return lines

    def part_f1(truth: str) -> Callable[[Setting], float | None]:
        def value(setting: Setting) -> float | None:
            fit = report.fit(truth, setting)
            return None if fit is None else float(fit.scores.part_f1.mean())

        return value

    def joint_error(truth: str) -> Callable[[Setting], float | None]:
        def value(setting: Setting) -> float | None:
            fit = report.fit(truth, setting)
            return None if fit is None else float(fit.scores.joint_error.mean())

        return value

    def angle(setting: Setting) -> float | None:
        error = report.gradient(setting)
        return None if error is None else float(np.median(error.angle))

    after = f"after {ITERATIONS} iterations"
    whole: dict[str, list[tuple[float, float]]] = {}
    for name in NAMES:
        for count in counts:
            setting = Setting(name, SIZE, count)
            fit = report.fit(ELLIPBODY, setting)
            if fit is not None:
                whole.setdefault(name, []).append((1e3 * count * report.time(setting), fit.scores.part_f1.mean()))
    return [
        _Panel(f"EllipBody: part F1 {after}", across, by_size(part_f1(ELLIPBODY)), sizes, True),
        _Panel(
            f"EllipBody: joint error, PA-MPJPE [mm], {after}", across, by_size(joint_error(ELLIPBODY)), sizes, False
        ),
        _Panel(f"EllipBody: gradient's error [°], {DISTANCE} rad off", across, by_size(angle), sizes, False, True),
        _Panel(f"Anny: part F1 {after}", across, by_size(part_f1(ANNY)), sizes, True),
        _Panel(f"Anny: joint error, PA-MPJPE [mm], {after}", across, by_size(joint_error(ANNY)), sizes, False),
        _Panel(
            f"EllipBody: part F1 at {SIZE} px after {', '.join(map(str, counts))} iterations",
            "time of all iterations, one body [ms]",
            whole,
            counts,
            True,
        ),
    ]


def _draw_head(draw: ImageDraw, report: Report, panels: Sequence[_Panel], font: _Font) -> None:
    draw.text(
        _at(16, 8),
        ", ".join(value if key == "machine" else f"{key} {value}" for key, value in report.machine.items()),
        "black",
        font,
    )
    x = 16.0
    for name, style in _STYLES.items():
        _draw_line(draw, [(x, 46), (x + 46, 46)], style)
        _draw_mark(draw, x + 23, 46, 5.5, style)
        draw.text(_at(x + 54, 46), name, "black", font, anchor="lm")
        x += 54 + font.getlength(name) / _SMOOTH + 26
    x = 16.0
    sizes = panels[0].sizes
    draw.text(_at(x, 80), "marks grow with the picture:", "black", font, anchor="lm")
    x += font.getlength("marks grow with the picture:") / _SMOOTH + 16
    for size, half in zip(sizes, _halves(len(sizes)), strict=True):
        _draw_mark(draw, x, 80, half, _STYLES[EXACT])
        draw.text(_at(x + 14, 80), f"{size} px", "black", font, anchor="lm")
        x += 14 + font.getlength(f"{size} px") / _SMOOTH + 20
    draw.line([*_at(x, 80), *_at(x + 46, 80)], fill=_FRONT, width=9 * _SMOOTH)
    text = "front: nothing is as fast and better; faster is to the left"
    draw.text(_at(x + 54, 80), text, "black", font, anchor="lm")


def _halves(count: int) -> list[float]:
    """Half sizes of marks, from small to large."""
    return [_MARKS[round(index * (len(_MARKS) - 1) / max(count - 1, 1))] for index in range(count)]


def _draw_panel(draw: ImageDraw, corner: tuple[float, float], panel: _Panel, font: _Font, bold: _Font) -> None:
    left, top = corner
    points = [point for line in panel.lines.values() for point in line]
    draw.text(_at(left, top - 10), panel.title, "black", bold, anchor="ls")
    if not points:
        return
    low, high = (math.log10(function(time for time, _ in points)) for function in (min, max))
    low, high = low - 0.12, max(high, low + 0.3) + 0.12
    ticks, scale = _upright([value for _, value in points], panel.logarithmic)
    bottom_value, top_value = scale(ticks[0]), scale(ticks[-1])

    def place(point: tuple[float, float]) -> tuple[float, float]:
        across = (math.log10(point[0]) - low) / (high - low)
        up = (scale(point[1]) - bottom_value) / (top_value - bottom_value)
        return left + _WIDTH * across, top + _HEIGHT * (1 - up)

    for tick in ticks:
        _, y = place((1.0, tick))
        draw.line([*_at(left, y), *_at(left + _WIDTH, y)], fill=_GRID, width=_SMOOTH)
        draw.text(_at(left - 6, y), f"{tick:.4g}", "black", font, anchor="rm")
    for power in range(math.floor(low), math.ceil(high) + 1):
        for digit in range(1, 10):
            value = digit * 10.0**power
            if low <= math.log10(value) <= high:
                x, _ = place((value, ticks[0]))
                draw.line([*_at(x, top), *_at(x, top + _HEIGHT)], fill=_GRID, width=_SMOOTH)
                if digit in (1, 2, 5):
                    draw.text(_at(x, top + _HEIGHT + 6), f"{value:.4g}", "black", font, anchor="ma")
    draw.rectangle([*_at(left, top), *_at(left + _WIDTH, top + _HEIGHT)], outline=_GREY, width=_SMOOTH)
    draw.text(_at(left + _WIDTH / 2, top + _HEIGHT + 28), panel.across, "black", font, anchor="ma")

    sign = -1 if panel.higher_is_better else 1
    best = sorted(points[index] for index in front([(time, sign * value) for time, value in points]))
    draw.line([xy for point in best for xy in _at(*place(point))], fill=_FRONT, width=9 * _SMOOTH, joint="curve")
    for name, line in panel.lines.items():
        placed = [place(point) for point in line]
        _draw_line(draw, placed, _STYLES[name])
        for point, half in zip(placed, _halves(len(panel.sizes)), strict=False):
            _draw_mark(draw, *point, half, _STYLES[name])


def _upright(values: Sequence[float], logarithmic: bool) -> tuple[list[float], Callable[[float], float]]:
    """Ticks from below the least to above the greatest value, and how the axis places a value."""
    if logarithmic:
        decades = range(math.floor(math.log10(min(values))) - 1, math.ceil(math.log10(max(values))) + 1)
        all_ticks = [digit * 10.0**power for power in decades for digit in (1, 2, 5)]
    else:
        span = max(max(values) - min(values), 1e-9)
        power = 10.0 ** math.floor(math.log10(span))
        step = next(power * digit for digit in (0.2, 0.5, 1.0, 2.0) if span / (power * digit) <= 6)
        first = math.floor(min(values) / step) - 1
        all_ticks = [step * index for index in range(first, first + 12)]
    below = max(tick for tick in all_ticks if tick < min(values))
    above = min(tick for tick in all_ticks if tick > max(values))
    ticks = [tick for tick in all_ticks if below <= tick <= above]
    return (ticks, math.log10) if logarithmic else (ticks, float)


def _draw_line(draw: ImageDraw, points: Sequence[tuple[float, float]], style: _Style) -> None:
    """A polyline with the style's dashes, which run on around its corners."""
    dash = style.dash or (1_000_000, 0)
    left, index = float(dash[0]), 0
    for (x0, y0), (x1, y1) in pairwise(points):
        length, done = math.hypot(x1 - x0, y1 - y0), 0.0
        while done < length:
            step = min(left, length - done)
            a, b = done / length, (done + step) / length
            if index % 2 == 0:
                ends = (x0 + a * (x1 - x0), y0 + a * (y1 - y0)), (x0 + b * (x1 - x0), y0 + b * (y1 - y0))
                draw.line([*_at(*ends[0]), *_at(*ends[1])], fill=style.colour, width=2 * _SMOOTH)
            done, left = done + step, left - step
            if left <= 0:
                index = (index + 1) % len(dash)
                left = float(dash[index])


def _draw_mark(draw: ImageDraw, x: float, y: float, half: float, style: _Style) -> None:
    fill = style.colour if style.filled else (255, 255, 255)
    if style.shape == "circle":
        box = [*_at(x - half, y - half), *_at(x + half, y + half)]
        draw.ellipse(box, fill=fill, outline=style.colour, width=2 * _SMOOTH)
        return
    corners = {
        "square": ((x - half, y - half), (x + half, y - half), (x + half, y + half), (x - half, y + half)),
        "triangle": ((x, y - half), (x + half, y + half), (x - half, y + half)),
        "diamond": ((x, y - half), (x + half, y), (x, y + half), (x - half, y)),
    }[style.shape]
    draw.polygon([_at(*corner) for corner in corners], fill=fill, outline=style.colour, width=2 * _SMOOTH)


def _at(x: float, y: float) -> tuple[float, float]:
    return x * _SMOOTH, y * _SMOOTH
