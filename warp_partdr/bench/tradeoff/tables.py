"""Figures of ``partdr bench tradeoff`` as tables on the screen."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...synthetic.tradeoff_people import ANNY, ELLIPBODY
from ..machine import in_words
from ..report import make_table, print_tables
from .plan import DISTANCE, ITERATIONS, NAMES, PRECISION_NAMES, SIZE, Setting
from .report import CONVERGED, KEYPOINTS_TOO, LABELS_ALONE, Fit, TradeoffReport, front, mesh_gains

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

NOTES = (
    "Time an iteration: of one body's refinement without its set-up, as the library does it: exact ellipsoids in one "
    "captured graph, meshes through torch; the fastest run of each of four people, their median. In a batch: for each "
    "body of all people at once.",
    "Part F1: of 20 parts and background, of exact ellipsoids at 512 px; joints: 14, after the best similarity; means.",
    "Gradient: of L_seg against the derivative of the area with a wrong label, medians; length as a multiple of it.",
    f"Found: EllipBodies with a part F1 of {CONVERGED} or more at the end. *: no other setting is as fast and as good.",
)
_RENDERER = "renderer, gradient"


def print_tradeoff(report: TradeoffReport, console: Console) -> None:
    """The table of settings, then what iterations, starts, numbers and qualities change."""
    tables = (
        _settings_table(report),
        _iterations_table(report),
        _starts_table(report),
        _gradients_table(report),
        _precisions_table(report),
        _qualities_table(report),
    )
    print_tables([in_words(report.machine)], tables, mesh_gains(report), NOTES, console)


_SETTING_COLUMNS = (  # heading, format, and which values are best: the least (1), the greatest (-1), or none is (0)
    ("EllipBody: part F1", "{:.3f}", -1),
    ("joints [mm]", "{:.1f}", 1),
    ("found", "{:.0%}", 0),
    ("Anny: part F1", "{:.3f}", -1),
    ("joints [mm]", "{:.1f}", 1),
    ("gradient off [°]", "{:.1f}", 1),
    ("length", "{:.2f}", 0),
)


def _settings_table(report: TradeoffReport) -> Table:
    headings = [_RENDERER, "px", "an iteration [ms]", "in a batch [ms]"]
    headings += [heading for heading, _, _ in _SETTING_COLUMNS]
    title = f"{ITERATIONS} iterations from starts {DISTANCE} rad off"
    settings = report.settings()
    figures = []
    for setting in settings:
        own, anny = report.fit(ELLIPBODY, setting), report.fit(ANNY, setting)
        gradient = report.gradient(setting)
        if own is None or anny is None or gradient is None:
            return make_table(title, headings, [])
        figures.append(
            [
                own.scores.part_f1.mean(),
                own.scores.joint_error.mean(),
                own.found,
                anny.scores.part_f1.mean(),
                anny.scores.joint_error.mean(),
                np.median(gradient.angle),
                np.median(gradient.ratio),
                own.seconds,
            ]
        )
    times = [report.time(setting) for setting in settings]
    rows = [
        [setting.name, str(setting.size), f"{1e3 * time:.3g}", f"{1e3 * values[-1]:.3g}"]
        for setting, time, values in zip(settings, times, figures, strict=True)
    ]
    for column, (_, form, sign) in enumerate(_SETTING_COLUMNS):
        points = [(time, sign * values[column]) for time, values in zip(times, figures, strict=True)]
        best = front(points) if sign else ()
        for index, (row, values) in enumerate(zip(rows, figures, strict=True)):
            row.append(form.format(values[column]) + ("*" if index in best else " "))
    return make_table(title, headings, rows, sections=True)


def _cell(fit: Fit) -> str:
    return f"{fit.scores.part_f1.mean():.3f}, {fit.scores.joint_error.mean():.0f} mm"


def _iterations_table(report: TradeoffReport) -> Table:
    counts = sorted({fit.setting.iterations for fit in report.fits})
    rows = []
    for name in NAMES:
        fits = [report.fit(ELLIPBODY, Setting(name, SIZE, count)) for count in counts]
        if all(fits):
            rows.append([name, *(_cell(fit) for fit in fits if fit is not None)])
    return make_table(
        f"EllipBody: part F1 and joints after so many iterations at {SIZE} px, from {DISTANCE} rad off",
        [_RENDERER, *map(str, counts)],
        rows,
    )


def _starts_table(report: TradeoffReport) -> Table:
    distances = sorted({fit.distance for fit in report.fits})
    rows = []
    for seen in (KEYPOINTS_TOO, LABELS_ALONE):
        for name in NAMES:
            fits = [report.fit(ELLIPBODY, Setting(name), distance, seen) for distance in distances]
            if all(fits):
                rows.append([name, seen, *(f"{_cell(fit)}, {fit.found:.0%}" for fit in fits if fit is not None)])
    return make_table(
        f"EllipBody: part F1, joints, found, {ITERATIONS} iterations at {SIZE} px, by distance of the start [rad]",
        [_RENDERER, "sees", *map(str, distances)],
        rows,
        left=(0, 1),
    )


def _gradients_table(report: TradeoffReport) -> Table:
    sizes = sorted({size for _, size, _ in report.gradients})
    distances = sorted({distance for _, _, distance in report.gradients})
    rows = []
    for name in NAMES:
        for size in sizes:
            errors = [report.gradients.get((name, size, distance)) for distance in distances]
            cells = [f"{np.median(each.angle):.1f}, {np.median(each.ratio):.2f}" for each in errors if each is not None]
            rows.append([name, str(size), *cells])
    title = "Gradient: angle [°] and length, medians, by distance [rad]"
    return make_table(title, [_RENDERER, "px", *map(str, distances)], rows, sections=True)


def _precisions_table(report: TradeoffReport) -> Table:
    rows = [
        [
            row.name,
            row.numbers,
            f"{row.scores.part_f1.mean():.4f}",
            f"{row.scores.joint_error.mean():.2f}",
            f"{row.moved:.2f}",
            f"{1e3 * row.seconds:.3g}",
        ]
        for name in PRECISION_NAMES
        for row in report.precisions
        if row.name == name
    ]
    headings = [_RENDERER, "numbers", "part F1", "joints [mm]", "joints moved [mm]", "an iteration [ms]"]
    return make_table(f"Numbers: {ITERATIONS} iterations in torch at {SIZE} px", headings, rows, left=(0, 1))


def _qualities_table(report: TradeoffReport) -> Table:
    rows = [
        [
            quality,
            level,
            f"{figures['part_f1']:.3f}",
            f"{figures['foreground_f1']:.3f}",
            f"{figures['pa_mpjpe_mm']:.1f}",
            f"{figures['seconds']:.2f}",
        ]
        for level, qualities in report.qualities.items()
        for quality, figures in qualities.items()
    ]
    headings = ["quality", "level", "part F1", "foreground F1", "joints, PA [mm]", "time [s]"]
    return make_table("Whole fits of PartBench's people", headings, rows, left=(0, 1))
