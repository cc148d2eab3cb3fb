"""Figures of ``partdr bench tradeoff`` as tables on the screen."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from ...synthetic.tradeoff_people import ANNY, ELLIPBODY
from .plan import DISTANCE, ITERATIONS, NAMES, PRECISION_NAMES, SIZE, Setting
from .report import CONVERGED, KEYPOINTS_TOO, LABELS_ALONE, Fit, Report, findings, front

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

TABLE_WIDTH = 150  # [characters]

NOTES = (
    "Time an iteration: of one body's refinement without its set-up, as the library does it: exact ellipsoids in one "
    "captured graph, meshes through torch; the fastest run of each of four people, their median. In a batch: for each "
    "body of all people at once.",
    "Part F1: of 20 parts and background, of exact ellipsoids at 512 px; joints: 14, after the best similarity; means.",
    "Gradient: of L_seg against the derivative of the area with a wrong label, medians; length as a multiple of it.",
    f"Found: EllipBodies with a part F1 of {CONVERGED} or more at the end. *: no other setting is as fast and as good.",
)


def print_report(report: Report, console: Console) -> None:
    """The table of settings, then what iterations, starts, numbers and qualities change."""
    from rich.markup import escape

    console.print(escape(", ".join(f"{key} {value}" for key, value in report.machine.items())))
    for table in (
        _settings_table(report),
        _iterations_table(report),
        _starts_table(report),
        _gradients_table(report),
        _precisions_table(report),
        _qualities_table(report),
    ):
        if table.row_count:
            console.print()
            console.print(table)
    console.print()
    for line in findings(report):
        console.print(escape(line))
    for line in NOTES:
        console.print(escape(line), style="dim")


def _table(title: str, columns: Iterable[str], left: int = 1) -> Table:
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    table = Table(title=title, title_justify="left", title_style="bold", box=SIMPLE_HEAD, pad_edge=False)
    for index, column in enumerate(columns):
        table.add_column(column, justify="left" if index < left else "right", no_wrap=index < left)
    return table


def _settings_table(report: Report) -> Table:
    columns = [
        "renderer, gradient",
        "px",
        "an iteration [ms]",
        "in a batch [ms]",
        "EllipBody: part F1",
        "joints [mm]",
        "found",
        "Anny: part F1",
        "joints [mm]",
        "gradient off [°]",
        "length",
    ]
    table = _table(f"{ITERATIONS} iterations from starts {DISTANCE} rad off", columns)
    settings = report.settings()
    values: list[list[float]] = []
    for setting in settings:
        own, anny = report.fit(ELLIPBODY, setting), report.fit(ANNY, setting)
        gradient = report.gradient(setting)
        if own is None or anny is None or gradient is None:
            return table
        values.append(
            [
                own.scores.part_f1.mean(),
                own.scores.joint_error.mean(),
                own.found,
                anny.scores.part_f1.mean(),
                anny.scores.joint_error.mean(),
                float(np.median(gradient.angle)),
                float(np.median(gradient.ratio)),
                own.seconds,
            ]
        )
    signs = {0: -1, 1: 1, 3: -1, 4: 1, 5: 1}  # of what is wrong, where less or more is better
    best = {
        column: front([(report.time(each), sign * row[column]) for each, row in zip(settings, values, strict=True)])
        for column, sign in signs.items()
    }
    forms = ("{:.3f}", "{:.1f}", "{:.0%}", "{:.3f}", "{:.1f}", "{:.1f}", "{:.2f}")
    for index, (setting, row) in enumerate(zip(settings, values, strict=True)):
        cells = [
            form.format(row[column]) + ("*" if index in best.get(column, ()) else " ")
            for column, form in enumerate(forms)
        ]
        table.add_row(
            setting.name,
            str(setting.size),
            f"{1e3 * report.time(setting):.3g}",
            f"{1e3 * row[-1]:.3g}",
            *cells,
            end_section=setting.size == max(size for _, size in report.times),
        )
    return table


def _cell(fit: Fit | None) -> str:
    return "" if fit is None else f"{fit.scores.part_f1.mean():.3f}, {fit.scores.joint_error.mean():.0f} mm"


def _iterations_table(report: Report) -> Table:
    counts = sorted({fit.setting.iterations for fit in report.fits})
    table = _table(
        f"EllipBody: part F1 and joints after so many iterations at {SIZE} px, from {DISTANCE} rad off",
        ["renderer, gradient", *map(str, counts)],
    )
    for name in NAMES:
        fits = [report.fit(ELLIPBODY, Setting(name, SIZE, count)) for count in counts]
        if all(fits):
            table.add_row(name, *map(_cell, fits))
    return table


def _starts_table(report: Report) -> Table:
    distances = sorted({fit.distance for fit in report.fits})
    table = _table(
        f"EllipBody: part F1, joints, found, {ITERATIONS} iterations at {SIZE} px, by distance of the start [rad]",
        ["renderer, gradient", "sees", *map(str, distances)],
        left=2,
    )
    for seen in (KEYPOINTS_TOO, LABELS_ALONE):
        for name in NAMES:
            fits = [report.fit(ELLIPBODY, Setting(name), distance, seen) for distance in distances]
            if all(fits):
                table.add_row(name, seen, *[f"{_cell(fit)}, {fit.found:.0%}" for fit in fits if fit is not None])
    return table


def _gradients_table(report: Report) -> Table:
    distances = sorted({row.distance for row in report.gradients})
    sizes = sorted({row.setting.size for row in report.gradients})
    table = _table(
        "Gradient: angle [°] and length, medians, by distance [rad]",
        ["renderer, gradient", "px", *map(str, distances)],
    )
    for name in NAMES:
        for size in sizes:
            errors = [report.gradient(Setting(name, size), distance) for distance in distances]
            cells = [f"{np.median(each.angle):.1f}, {np.median(each.ratio):.2f}" for each in errors if each is not None]
            table.add_row(name, str(size), *cells, end_section=size == sizes[-1])
    return table


def _precisions_table(report: Report) -> Table:
    table = _table(
        f"Numbers: {ITERATIONS} iterations in torch at {SIZE} px",
        ["renderer, gradient", "numbers", "part F1", "joints [mm]", "joints moved [mm]", "an iteration [ms]"],
        left=2,
    )
    for name in PRECISION_NAMES:
        for row in report.precisions:
            if row.name == name:
                table.add_row(
                    row.name,
                    row.numbers,
                    f"{row.scores.part_f1.mean():.4f}",
                    f"{row.scores.joint_error.mean():.2f}",
                    f"{row.moved:.2f}",
                    f"{1e3 * row.seconds:.3g}",
                )
    return table


def _qualities_table(report: Report) -> Table:
    table = _table(
        "Whole fits of PartBench's people",
        ["quality", "level", "part F1", "foreground F1", "joints, PA [mm]", "time [s]"],
        left=2,
    )
    for level, qualities in report.qualities.items():
        for quality, figures in qualities.items():
            table.add_row(
                quality,
                level,
                f"{figures['part_f1']:.3f}",
                f"{figures['foreground_f1']:.3f}",
                f"{figures['pa_mpjpe_mm']:.1f}",
                f"{figures['seconds']:.2f}",
            )
    return table
