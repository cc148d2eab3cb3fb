"""Figures of ``partdr bench tradeoff`` as tables on the screen."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from ...synthetic.tradeoff_people import ANNY, ELLIPBODY
from ...tables import RecordColumn, make_table, print_tables, record_table
from ..machine import in_words
from .plan import DISTANCE, ITERATIONS, NAMES, SIZE, Setting
from .report import CONVERGED, KEYPOINTS_TOO, LABELS_ALONE, Row, TradeoffReport, front, mesh_gains

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


def _settings_table(report: TradeoffReport) -> Table:
    settings = report.settings()
    own, annys = ([report.fit(truth, setting) for setting in settings] for truth in (ELLIPBODY, ANNY))
    gradients = [report.gradient(setting) for setting in settings]
    times = [report.time(setting) for setting in settings]
    columns = (  # heading, format, values, and which are best: the least (1), the greatest (-1), or none is (0)
        ("an iteration [ms]", "{:.3g}", [1e3 * time for time in times], 0),
        ("in a batch [ms]", "{:.3g}", [1e3 * fit["batch_seconds"] for fit in own], 0),
        ("EllipBody: part F1", "{:.3f}", [fit["part_f1"].mean() for fit in own], -1),
        ("joints [mm]", "{:.1f}", [fit["joint_error_mm"].mean() for fit in own], 1),
        ("found", "{:.0%}", [_found(fit) for fit in own], 0),
        ("Anny: part F1", "{:.3f}", [fit["part_f1"].mean() for fit in annys], -1),
        ("joints [mm]", "{:.1f}", [fit["joint_error_mm"].mean() for fit in annys], 1),
        ("gradient off [°]", "{:.1f}", [np.median(error["angle_deg"]) for error in gradients], 1),
        ("length", "{:.2f}", [np.median(error["length_ratio"]) for error in gradients], 0),
    )
    rows = [[setting.name, str(setting.size)] for setting in settings]
    for _, form, values, sign in columns:
        best = front([(time, sign * value) for time, value in zip(times, values, strict=True)]) if sign else set()
        for index, (row, value) in enumerate(zip(rows, values, strict=True)):
            row.append(form.format(value) + ("*" if index in best else " "))
    headings = [_RENDERER, "px", *(heading for heading, *_ in columns)]
    return make_table(f"{ITERATIONS} iterations from starts {DISTANCE} rad off", headings, rows, sections=True)


def _found(fit: Row) -> float:
    return float(np.mean(fit["part_f1"] >= CONVERGED))


def _cell(fit: Row) -> str:
    return f"{fit['part_f1'].mean():.3f}, {fit['joint_error_mm'].mean():.0f} mm"


def _iterations_table(report: TradeoffReport) -> Table:
    counts = report.iterations()
    rows = [[name, *(_cell(report.fit(ELLIPBODY, Setting(name, SIZE, count))) for count in counts)] for name in NAMES]
    return make_table(
        f"EllipBody: part F1 and joints after so many iterations at {SIZE} px, from {DISTANCE} rad off",
        [_RENDERER, *map(str, counts)],
        rows,
    )


def _starts_table(report: TradeoffReport) -> Table:
    distances = sorted({row["distance_rad"] for row in report.fits})
    rows = []
    for seen in (KEYPOINTS_TOO, LABELS_ALONE):
        for name in NAMES:
            fits = [report.fit(ELLIPBODY, Setting(name), distance, seen) for distance in distances]
            rows.append([name, seen, *(f"{_cell(fit)}, {_found(fit):.0%}" for fit in fits)])
    return make_table(
        f"EllipBody: part F1, joints, found, {ITERATIONS} iterations at {SIZE} px, by distance of the start [rad]",
        [_RENDERER, "sees", *map(str, distances)],
        rows,
        left=(0, 1),
    )


def _gradients_table(report: TradeoffReport) -> Table:
    distances = sorted({row["distance_rad"] for row in report.gradients})
    rows = []
    for setting in report.settings():
        errors = [report.gradient(setting, distance) for distance in distances]
        cells = [f"{np.median(error['angle_deg']):.1f}, {np.median(error['length_ratio']):.2f}" for error in errors]
        rows.append([setting.name, str(setting.size), *cells])
    title = "Gradient: angle [°] and length, medians, by distance [rad]"
    return make_table(title, [_RENDERER, "px", *map(str, distances)], rows, sections=True)


def _formatted(form: str, factor: float = 1.0) -> Callable[[float], str]:
    return lambda value: format(factor * value, form)


def _precisions_table(report: TradeoffReport) -> Table:
    columns = (
        RecordColumn(_RENDERER, "renderer"),
        RecordColumn("numbers", "numbers"),
        RecordColumn("part F1", "part_f1", lambda values: f"{values.mean():.4f}"),
        RecordColumn("joints [mm]", "joint_error_mm", lambda values: f"{values.mean():.2f}"),
        RecordColumn("joints moved [mm]", "moved_mm", _formatted(".2f")),
        RecordColumn("an iteration [ms]", "seconds", _formatted(".3g", 1e3)),
    )
    title = f"Numbers: {ITERATIONS} iterations in torch at {SIZE} px"
    return record_table(title, columns, report.precisions, left=(0, 1))


def _qualities_table(report: TradeoffReport) -> Table:
    columns = (
        RecordColumn("quality", "quality"),
        RecordColumn("level", "level"),
        RecordColumn("part F1", "part_f1", _formatted(".3f")),
        RecordColumn("foreground F1", "foreground_f1", _formatted(".3f")),
        RecordColumn("joints, PA [mm]", "pa_mpjpe_mm", _formatted(".1f")),
        RecordColumn("time [s]", "seconds", _formatted(".2f")),
    )
    records = [
        {"quality": quality, "level": level, **figures}
        for level, qualities in report.qualities.items()
        for quality, figures in qualities.items()
    ]
    return record_table("Whole fits of PartBench's people", columns, records, left=(0, 1))
