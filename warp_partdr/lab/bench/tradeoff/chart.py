"""Time an iteration against what is wrong after it: a line for each renderer and gradient."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ....results.figure_parts import empty_figure
from ...synthetic.tradeoff_people import ANNY, ELLIPBODY
from ..machine import in_words
from ..renderers import COVERAGE, EXACT, PARTDR
from .plan import DISTANCE, ITERATIONS, NAMES, SIZE, Setting
from .report import TradeoffReport, front

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MARKS = (5.0, 12.0)  # [points] of the smallest picture or the fewest iterations, and of the largest
_FRONT: dict[str, Any] = {"color": "0.8", "linewidth": 7, "zorder": 0}


def _style(colour: str, marker: str, dashes: tuple[int, ...] = ()) -> dict[str, Any]:
    """A line's looks: told apart by colour, and without it by marks and, of meshes, dashes and hollow marks."""
    filling = {"markerfacecolor": "white"} if dashes else {}
    return {"color": colour, "marker": marker, "linestyle": (0, dashes or (1, 0)), "linewidth": 1.5, **filling}


_STYLES = {
    "mesh E0": _style("#aaaaaa", "o", (1, 2)),
    "mesh E1": _style("#785ea0", "s", (3, 2)),
    "mesh E2": _style("#00785a", "^", (6, 2)),
    "mesh E3": _style("#5a3200", "D", (6, 2, 1, 2)),
    PARTDR: _style("#c83c00", "s"),
    COVERAGE: _style("#005ac8", "^"),
    EXACT: _style("#000000", "o"),
}
_LEVEL_STYLES = (("#0a6e78", "P"), ("#a0006e", "X"))  # of PartBench's levels


class _Panel(NamedTuple):
    """A mark for each setting; those of one renderer share a line, from the smallest or the fewest on."""

    title: str
    settings: Sequence[Setting]
    value: Callable[[Setting], float]
    higher_is_better: bool
    scale: str = "linear"  # of the upright axis
    of_all: bool = False  # the time of all iterations, not of one


def draw_tradeoff_chart(report: TradeoffReport) -> Figure:
    """Part F1, joint error and gradient error over time: EllipBodies above, Annys and runs below, fits beside."""
    figure = empty_figure(20, 10)
    panels = figure.subplots(2, 4)
    for axes, panel in zip(panels[:, :3].flat, _panels(report), strict=True):
        _draw_panel(axes, report, panel)
    _draw_fits(panels[0, 3], report, "part_f1", "part F1", higher_is_better=True)
    _draw_fits(panels[1, 3], report, "pa_mpjpe_mm", "joint error, PA-MPJPE [mm]", higher_is_better=False)
    sizes = sorted({setting.size for setting in report.settings()})
    handles = [*figure.axes[0].plot([], [], **_FRONT)]
    labels = ["front: nothing is as fast and better; faster is to the left"]
    for size, points in zip(sizes, _mark_sizes(len(sizes)), strict=True):
        handles += figure.axes[0].plot([], [], **{**_STYLES[EXACT], "linestyle": ""}, markersize=points)
        labels.append(f"{size} px")
    for name in NAMES:
        handles += figure.axes[0].plot([], [], **_STYLES[name])
        labels.append(name)
    figure.suptitle(in_words(report.machine), fontsize=9)
    figure.legend(handles, labels, loc="outside lower center", ncols=6, frameon=False)
    return figure


def _panels(report: TradeoffReport) -> list[_Panel]:
    counts = report.iterations()
    settings = report.settings()
    runs = [Setting(name, SIZE, count) for name in NAMES for count in counts]

    def score(truth: str, name: str) -> Callable[[Setting], float]:
        return lambda setting: float(report.fit(truth, setting)[name].mean())

    def angle(setting: Setting) -> float:
        return float(np.median(report.gradient(setting)["angle_deg"]))

    after = f"after {ITERATIONS} iterations"
    by_truth = {
        truth: (
            _Panel(f"{truth}: part F1 {after}", settings, score(truth, "part_f1"), True),
            _Panel(f"{truth}: joint error, PA-MPJPE [mm], {after}", settings, score(truth, "joint_error_mm"), False),
        )
        for truth in (ELLIPBODY, ANNY)
    }
    title = f"{ELLIPBODY}: part F1 at {SIZE} px after {', '.join(map(str, counts))} iterations"
    return [
        *by_truth[ELLIPBODY],
        _Panel(f"{ELLIPBODY}: gradient's error [°], {DISTANCE} rad off", settings, angle, False, "log"),
        *by_truth[ANNY],
        _Panel(title, runs, score(ELLIPBODY, "part_f1"), True, of_all=True),
    ]


def _draw_panel(axes: Axes, report: TradeoffReport, panel: _Panel) -> None:
    unit = "time of all iterations" if panel.of_all else "time an iteration"
    axes.set(title=panel.title, xlabel=f"{unit}, one body [ms]", xscale="log", yscale=panel.scale)
    axes.grid(color="0.9", which="both")
    lines: dict[str, list[tuple[float, float]]] = {}
    for setting in panel.settings:
        time = 1e3 * report.time(setting) * (setting.iterations if panel.of_all else 1)
        lines.setdefault(setting.name, []).append((time, panel.value(setting)))
    points = [point for line in lines.values() for point in line]
    sign = -1 if panel.higher_is_better else 1
    best = sorted(points[index] for index in front([(time, sign * value) for time, value in points]))
    axes.plot([time for time, _ in best], [value for _, value in best], **_FRONT)
    for name, line in lines.items():
        style = _STYLES[name]
        axes.plot([time for time, _ in line], [value for _, value in line], **{**style, "marker": ""})
        for (time, value), size in zip(line, _mark_sizes(len(line)), strict=True):
            axes.plot(time, value, **{**style, "linestyle": ""}, markersize=size)


def _draw_fits(axes: Axes, report: TradeoffReport, figure: str, what: str, *, higher_is_better: bool) -> None:
    """Whole fits of PartBench's people: a mark for each quality and the mesh stage, a line for each level."""
    axes.set(title=f"PartBench, whole fits: {what}", xlabel="time of a fit [s]")
    axes.grid(color="0.9", which="both")
    for (level, fits), (colour, marker) in zip(report.qualities.items(), _LEVEL_STYLES, strict=False):
        points = {name: (row["seconds"], row[figure]) for name, row in fits.items()}
        sign = -1 if higher_is_better else 1
        best = front([(time, sign * value) for time, value in points.values()])
        chosen = sorted(point for place, point in enumerate(points.values()) if place in best)
        axes.plot(*zip(*chosen, strict=True), **_FRONT)
        axes.plot(*zip(*points.values(), strict=True), color=colour, marker=marker, linestyle="", label=level)
        for name, point in points.items():
            axes.annotate(name, point, xytext=(6, 5), textcoords="offset points", fontsize=8, color=colour)
    axes.margins(x=0.4, y=0.1)
    axes.set_xlim(left=0)
    if report.qualities:
        axes.legend(loc="best")


def _mark_sizes(count: int) -> list[float]:
    return np.linspace(*_MARKS, count).tolist()
