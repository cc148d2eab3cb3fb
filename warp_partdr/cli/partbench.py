"""The command ``partdr evaluate partbench``."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Annotated

import typer

from ..errors import InputError
from .options import DeviceOption

QUICK_LEVELS = ("clean", "realistic")
PEOPLE, QUICK_PEOPLE = 20, 6  # for ten minutes and for one on two cores


def run_partbench(
    quick: Annotated[
        bool, typer.Option("--quick", help=f"{QUICK_PEOPLE} people, two levels, EllipBody alone: a minute.")
    ] = False,
    people: Annotated[
        int | None,
        typer.Option(help=f"The first N of the 200 people; default {PEOPLE}.", metavar="N", show_default=False),
    ] = None,
    level: Annotated[
        list[str] | None,
        typer.Option(
            "--level",
            "--levels",
            help="clean, mild, realistic or hard; may be given again. Default: all.",
            metavar="NAME",
        ),
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option(
            "--method", "--methods", help="A row of the tables; may be given again. Default: all.", metavar="NAME"
        ),
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(help="Fits at a time, a process each; default: one a core.", metavar="N", show_default=False),
    ] = None,
    device: DeviceOption = "cpu",
    out: Annotated[
        Path | None,
        typer.Option(
            help="For partbench.html, with the worst fits drawn, and .json.", metavar="FOLDER", show_default=False
        ),
    ] = None,
) -> None:
    """PartBench: synthetic people with the whole truth known; nothing to download.

    Ten minutes on two cores; --quick one.
    """
    if jobs is not None and jobs < 1:
        raise InputError(f"--jobs: {jobs}; expected 1 or more")

    from ..bench.machine import about
    from ..bench.report import wide_console
    from ..evaluation.evaluate import evaluate, one_thread, tables
    from ..evaluation.partbench.methods import METHODS, QUICK, choose_methods
    from ..evaluation.partbench.report import compare_to_targets, write_report
    from ..evaluation.partbench.samples import partbench_samples
    from ..interop.devices import choose_device
    from ..results.result_sets import check_folder
    from ..synthetic.noise import LEVELS
    from .progress import FitProgress

    if out is not None:
        check_folder(out)
    methods = choose_methods(method or (QUICK if quick else tuple(METHODS)))
    levels = level or (QUICK_LEVELS if quick else tuple(LEVELS))
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # for the processes to come
    one_thread()
    where = choose_device(device)
    processes = jobs or ((os.cpu_count() or 1) if where == "cpu" else 1)
    with FitProgress() as progress:
        samples = partbench_samples(people or (QUICK_PEOPLE if quick else PEOPLE), levels)
        report = evaluate(samples, methods, jobs=processes, device=where, progress=progress)

    console = wide_console()
    for table in tables(report):
        console.print(table)
    for finding in compare_to_targets(report):
        console.print(finding, markup=False)
    for failure in report.failures:
        typer.echo(f"not fitted: {failure.source}: {failure.sample}, {failure.method}: {failure.reason}", err=True)
    if out is not None:
        measured_with = {**about(where), "jobs": processes}
        out.mkdir(parents=True, exist_ok=True)
        figures = {"about": measured_with, **report.to_json()}
        (out / "partbench.json").write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
        write_report(out / "partbench.html", report, samples, methods, measured_with, device=where)
        typer.echo(f"{out / 'partbench.html'} shows the worst fits, {out / 'partbench.json'} holds each fit's figures")
