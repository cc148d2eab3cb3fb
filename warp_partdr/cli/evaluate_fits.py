"""Fits of many samples, which all commands of ``partdr evaluate`` run and report in one way."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Option

from ..errors import InputError
from .options import DeviceOption

if TYPE_CHECKING:
    from ..lab.evaluation.evaluate import Evaluated, Fitting, Report


@dataclass(frozen=True)
class RunOptions:
    """Options of every data set."""

    limit: Annotated[int | None, Option(help="Take only the first N people or views.", metavar="N")] = None
    jobs: Annotated[int, Option(help="Fits at a time, each in a process; they slow each other down.", metavar="N")] = 1
    methods: Annotated[
        list[str] | None,
        Option(
            "--method",
            help="Row of the tables, such as 'keypoints only'. May be given several times. Default: all.",
            metavar="NAME",
        ),
    ] = None
    device: DeviceOption = "auto"
    out: Annotated[Path | None, Option(help="File for all figures, with those of each fit.", metavar="FILE.json")] = (
        None
    )

    def check_out(self) -> None:
        """Raise InputError if figures can't be written to ``out``."""
        from ..results.result_sets import check_folder

        if self.out is None:
            return
        if self.out.is_dir():
            raise InputError(f"--out: {self.out}: a folder; expected a file")
        check_folder(self.out.parent)

    def save(self, figures: dict[str, Any]) -> None:
        """Write figures to ``out``, if it was given."""
        from ..lab.tables import save_figures

        if self.out is not None:
            save_figures(figures, self.out)
            typer.echo(f"{self.out} holds the same figures, and those of each fit")


def check_counts(**options: int | None) -> None:
    """Raise InputError if one of these numbers is below 1."""
    for name, number in options.items():
        if number is not None and number < 1:
            raise InputError(f"--{name}: {number}; expected 1 or more")


def choose_methods(methods: Mapping[str, Fitting], names: Collection[str]) -> dict[str, Fitting]:
    """Choose methods by their names, in the order of ``methods``."""
    if unknown := sorted(set(names) - methods.keys()):
        raise InputError(f"--method: {', '.join(unknown)}; expected {'; '.join(methods)}")
    return {name: method for name, method in methods.items() if name in names}


def one_thread_device(device: str) -> str:
    """Keep this process and later ones to one core each, and return the device to fit on."""
    from ..interop.devices import choose_device
    from ..lab.evaluation.evaluate import one_thread

    os.environ.setdefault("OMP_NUM_THREADS", "1")
    one_thread()
    return choose_device(device)


def fit_samples(
    people: Sequence[Evaluated],
    methods: Mapping[str, Fitting],
    jobs: int,
    device: str,
    *,
    clusters: str = "people",
    pooled: bool = False,
) -> tuple[Report, dict[str, Any]]:
    """Fit all people, print the results, and return the report and all figures for a file.

    Args:
        people: Samples to fit.
        methods: Methods by their names, the rows of the tables.
        jobs: Number of fits at a time.
        device: Device to fit on.
        clusters: Names of the groups of samples that are not independent, for the report.
        pooled: True: the report also has a table of all sources together.
    """
    from ..lab.bench.machine import about
    from ..lab.evaluation.evaluate import evaluate, tables
    from ..lab.tables import wide_console
    from .progress import FitProgress

    with FitProgress() as progress:
        fitted = evaluate(people, methods, jobs=jobs, device=device, progress=progress)
    report = replace(fitted, clusters=clusters, together=pooled)
    console = wide_console()
    for table in tables(report):
        console.print(table)
    for failure in report.failures:
        typer.echo(f"not fitted: {failure.source}: {failure.sample}, {failure.method}: {failure.reason}", err=True)
    return report, {"about": {**about(device), "jobs": jobs}, **report.to_json()}
