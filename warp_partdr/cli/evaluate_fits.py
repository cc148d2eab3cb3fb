"""Fits of many samples, as all commands of ``partdr evaluate`` run and report them."""

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

    limit: Annotated[int | None, Option(help="Only the first N people, or views.", metavar="N")] = None
    jobs: Annotated[int, Option(help="Fits at a time, a process each; they make one another slower.", metavar="N")] = 1
    methods: Annotated[
        list[str] | None,
        Option(
            "--method",
            help="A row of the tables, such as keypoints only; may be given again; default: all.",
            metavar="NAME",
        ),
    ] = None
    device: DeviceOption = "auto"
    out: Annotated[Path | None, Option(help="Write all figures, also of each fit.", metavar="FILE.json")] = None

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
            typer.echo(f"{self.out} holds the same figures, and each fit's")


def check_counts(**options: int | None) -> None:
    """Raise InputError if one of these numbers is below 1."""
    for name, number in options.items():
        if number is not None and number < 1:
            raise InputError(f"--{name}: {number}; expected 1 or more")


def choose_methods(methods: Mapping[str, Fitting], names: Collection[str]) -> dict[str, Fitting]:
    """Some of the methods, in their order."""
    if unknown := sorted(set(names) - methods.keys()):
        raise InputError(f"--method: {', '.join(unknown)}; expected {'; '.join(methods)}")
    return {name: method for name, method in methods.items() if name in names}


def one_thread_device(device: str) -> str:
    """Keep this process and those to come to one core each; returns the device to fit on."""
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
    together: bool = False,
) -> tuple[Report, dict[str, Any]]:
    """Fit everybody and print what came of it; returns all figures for a file, too.

    ``clusters`` and ``together`` are the report's.
    """
    from ..lab.bench.machine import about
    from ..lab.evaluation.evaluate import evaluate, tables
    from ..lab.tables import wide_console
    from .progress import FitProgress

    with FitProgress() as progress:
        fitted = evaluate(people, methods, jobs=jobs, device=device, progress=progress)
    report = replace(fitted, clusters=clusters, together=together)
    console = wide_console()
    for table in tables(report):
        console.print(table)
    for failure in report.failures:
        who = f"{failure.source}: {failure.sample}"
        typer.echo(f"not fitted: {who}, {failure.method}: {failure.reason}", err=True)
    return report, {"about": {**about(device), "jobs": jobs}, **report.to_json()}
