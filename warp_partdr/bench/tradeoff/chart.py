"""Time an iteration against what is wrong after it: a line for each renderer and gradient."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from ...synthetic.tradeoff_people import ANNY, ELLIPBODY
from ..drawing import WHITE, Canvas, Colour, Point, log_ticks
from ..machine import in_words
from ..renderers import COVERAGE, EXACT, PARTDR
from .plan import DISTANCE, ITERATIONS, NAMES, SIZE, Setting
from .report import TradeoffReport, front

if TYPE_CHECKING:
    from PIL.Image import Image

_COLUMNS = 3
_WIDTH, _HEIGHT = 470, 360  # [px] of a panel's axes
_LEFT, _TOP, _RIGHT, _BOTTOM = 64, 44, 22, 58  # [px] around them
_PANEL = _LEFT + _WIDTH + _RIGHT, _TOP + _HEIGHT + _BOTTOM
_HEAD = 112  # [px] above all panels
_FONT = 14  # [px]
_GRID, _GREY, _FRONT = (225, 225, 225), (120, 120, 120), (200, 200, 200)
_FRONT_WIDTH = 9  # [px]
_MARKS = (4.0, 5.5, 7.0, 8.5)  # [px] half sizes, from the smallest picture or the fewest iterations


@dataclass(frozen=True)
class _Style:
    """A line's looks: told apart by colour, and without it by shape, filling and dashes."""

    colour: Colour
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
    lines: dict[str, list[Point]]  # time [ms], what is wrong or right
    sizes: tuple[int, ...]
    higher_is_better: bool
    logarithmic: bool = False  # the upright axis


_Value = Callable[[Setting], float | None]


def draw_tradeoff_chart(report: TradeoffReport) -> Image:
    """Part F1, joint error and gradient error over time: EllipBodies above, Annys and whole refinements below."""
    panels = _panels(report)
    rows = math.ceil(len(panels) / _COLUMNS)
    canvas = Canvas(_COLUMNS * _PANEL[0], _HEAD + rows * _PANEL[1], _FONT)
    _draw_head(canvas, report, panels[0].sizes)
    for index, panel in enumerate(panels):
        row, column = divmod(index, _COLUMNS)
        _draw_panel(canvas, (column * _PANEL[0] + _LEFT, _HEAD + row * _PANEL[1] + _TOP), panel)
    return canvas.image()


def _panels(report: TradeoffReport) -> list[_Panel]:
    sizes = tuple(sorted({size for _, size in report.times}))
    counts = tuple(sorted({fit.setting.iterations for fit in report.fits}))

    def lines(value: _Value, settings: Sequence[Setting], *, whole: bool) -> dict[str, list[Point]]:
        found: dict[str, list[Point]] = {}
        for setting in settings:
            figure = value(setting)
            if figure is not None:
                iterations = setting.iterations if whole else 1
                found.setdefault(setting.name, []).append((1e3 * iterations * report.time(setting), figure))
        return found

    def score(truth: str, name: str, setting: Setting) -> float | None:
        fit = report.fit(truth, setting)
        return None if fit is None else float(getattr(fit.scores, name).mean())

    def angle(setting: Setting) -> float | None:
        error = report.gradient(setting)
        return None if error is None else float(np.median(error.angle))

    def by_size(title: str, value: _Value, *, better: bool, log: bool = False) -> _Panel:
        shown = lines(value, report.settings(), whole=False)
        return _Panel(title, "time an iteration, one body [ms]", shown, sizes, better, log)

    panels = []
    after = f"after {ITERATIONS} iterations"
    for truth in (ELLIPBODY, ANNY):
        part_f1, joint_error = (partial(score, truth, name) for name in ("part_f1", "joint_error"))
        panels += [
            by_size(f"{truth}: part F1 {after}", part_f1, better=True),
            by_size(f"{truth}: joint error, PA-MPJPE [mm], {after}", joint_error, better=False),
        ]
    panels.insert(2, by_size(f"{ELLIPBODY}: gradient's error [°], {DISTANCE} rad off", angle, better=False, log=True))
    settings = [Setting(name, SIZE, count) for name in NAMES for count in counts]
    title = f"{ELLIPBODY}: part F1 at {SIZE} px after {', '.join(map(str, counts))} iterations"
    whole = lines(partial(score, ELLIPBODY, "part_f1"), settings, whole=True)
    return [*panels, _Panel(title, "time of all iterations, one body [ms]", whole, counts, True)]


def _draw_head(canvas: Canvas, report: TradeoffReport, sizes: Sequence[int]) -> None:
    canvas.text(16, 8, in_words(report.machine), "la")
    x = 16.0
    for name, style in _STYLES.items():
        _draw_line(canvas, [(x, 46), (x + 46, 46)], style)
        _draw_mark(canvas, (x + 23, 46), 5.5, style)
        x += 54 + canvas.text(x + 54, 46, name) + 26
    x = 16 + canvas.text(16, 80, "marks grow with the picture:") + 16
    for size, half in zip(sizes, _halves(len(sizes)), strict=True):
        _draw_mark(canvas, (x, 80), half, _STYLES[EXACT])
        x += 14 + canvas.text(x + 14, 80, f"{size} px") + 20
    canvas.line([(x, 80), (x + 46, 80)], _FRONT, _FRONT_WIDTH)
    canvas.text(x + 54, 80, "front: nothing is as fast and better; faster is to the left")


def _halves(count: int) -> list[float]:
    """Half sizes of marks, from small to large."""
    return [_MARKS[round(index * (len(_MARKS) - 1) / max(count - 1, 1))] for index in range(count)]


def _draw_panel(canvas: Canvas, corner: Point, panel: _Panel) -> None:
    left, top = corner
    points = [point for line in panel.lines.values() for point in line]
    canvas.text(left, top - 10, panel.title, "ls", bold=True)
    if not points:
        return
    low, high = (math.log10(function(time for time, _ in points)) for function in (min, max))
    low, high = low - 0.12, max(high, low + 0.3) + 0.12
    ticks, scale = _upright([value for _, value in points], panel.logarithmic)
    bottom_value, top_value = scale(ticks[0]), scale(ticks[-1])

    def place(point: Point) -> Point:
        across = (math.log10(point[0]) - low) / (high - low)
        up = (scale(point[1]) - bottom_value) / (top_value - bottom_value)
        return left + _WIDTH * across, top + _HEIGHT * (1 - up)

    for tick in ticks:
        _, y = place((1.0, tick))
        canvas.line([(left, y), (left + _WIDTH, y)], _GRID)
        canvas.text(left - 6, y, f"{tick:.4g}", "rm")
    for digit, value in log_ticks(low, high):
        x, _ = place((value, ticks[0]))
        canvas.line([(x, top), (x, top + _HEIGHT)], _GRID)
        if digit in (1, 2, 5):
            canvas.text(x, top + _HEIGHT + 6, f"{value:.4g}", "ma")
    canvas.frame((left, top), (left + _WIDTH, top + _HEIGHT), _GREY)
    canvas.text(left + _WIDTH / 2, top + _HEIGHT + 28, panel.across, "ma")

    sign = -1 if panel.higher_is_better else 1
    best = sorted(points[index] for index in front([(time, sign * value) for time, value in points]))
    canvas.line([place(point) for point in best], _FRONT, _FRONT_WIDTH)
    for name, line in panel.lines.items():
        placed = [place(point) for point in line]
        _draw_line(canvas, placed, _STYLES[name])
        for point, half in zip(placed, _halves(len(panel.sizes)), strict=False):
            _draw_mark(canvas, point, half, _STYLES[name])


def _upright(values: Sequence[float], logarithmic: bool) -> tuple[list[float], Callable[[float], float]]:
    """Ticks from below the least to above the greatest value, and the function that places a value on the axis."""
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


def _draw_line(canvas: Canvas, points: Sequence[Point], style: _Style) -> None:
    """A polyline with the style's dashes, which run on around its corners."""
    dash = style.dash or (1_000_000, 0)
    left, index = float(dash[0]), 0
    for (x0, y0), (x1, y1) in pairwise(points):
        length, done = math.hypot(x1 - x0, y1 - y0), 0.0
        while done < length:
            step = min(left, length - done)
            if index % 2 == 0:
                shares = done / length, (done + step) / length
                canvas.line([(x0 + share * (x1 - x0), y0 + share * (y1 - y0)) for share in shares], style.colour, 2)
            done, left = done + step, left - step
            if left <= 0:
                index = (index + 1) % len(dash)
                left = float(dash[index])


def _draw_mark(canvas: Canvas, place: Point, half: float, style: _Style) -> None:
    canvas.mark(place, style.shape, half, style.colour if style.filled else WHITE, style.colour, 2)
