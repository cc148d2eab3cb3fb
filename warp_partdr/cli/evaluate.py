"""The command ``partdr evaluate``: fit the people of a data set and say how well that went."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import InputError
from .options import DeviceOption, LabelsOption, grouped
from .partbench import run_partbench

if TYPE_CHECKING:
    from ..body.labels import LabelSet
    from ..inputs.sample import Sample

evaluate = typer.Typer(
    help="How good fits are on a data set: parts, keypoints, 3D joints, with 95 % intervals; see docs/evaluation.md.",
    no_args_is_help=True,
)


@dataclass(frozen=True)
class RunOptions:
    """Options of every data set."""

    limit: Annotated[int | None, typer.Option(help="Only the first N people.", metavar="N")] = None
    jobs: Annotated[
        int, typer.Option(help="Fits at a time, a process each; they make one another slower.", metavar="N")
    ] = 1
    methods: Annotated[
        list[str] | None,
        typer.Option(
            "--method",
            help="What to fit to: keypoints only, full silhouette or parts; may be given again; default: all.",
            metavar="NAME",
            show_default=False,
        ),
    ] = None
    device: DeviceOption = "auto"
    out: Annotated[
        Path | None, typer.Option(help="Write all figures, also of each fit.", metavar="FILE.json", show_default=False)
    ] = None


PicturesOption = Annotated[
    Path | None, typer.Option(help="The data set's pictures; not needed to fit.", metavar="FOLDER", show_default=False)
]
KeypointsOption = Annotated[
    Path | None,
    typer.Option(help="2D keypoints, one JSON file a picture, instead of the file's own.", metavar="FOLDER"),
]


def folder(
    path: Annotated[Path, typer.Argument(help="N.jpg, N.keypoints.json, and perhaps N.parts.png.", metavar="FOLDER")],
    labels: LabelsOption = None,
    *,
    options: RunOptions,
) -> None:
    """Your own pictures: how well bodies follow the labels and keypoints given.

    Without --labels, labels.json in the folder says what the part labels are.
    """
    from ..evaluation.datasets import read_folder

    _evaluate(read_folder(path, _label_set(labels)), options)


def h36m(
    path: Annotated[Path, typer.Argument(help="SPIN's h36m_valid_protocol1.npz or the like.", metavar="FILE.npz")],
    keypoints: KeypointsOption = None,
    pictures: PicturesOption = None,
    *,
    options: RunOptions,
) -> None:
    """Human3.6M, in SPIN's annotation arrays: MPJPE and PA-MPJPE."""
    from ..evaluation.datasets import read_human36m

    _evaluate(read_human36m(path, pictures=pictures, keypoints=keypoints), options)


def lsp(
    path: Annotated[Path, typer.Argument(help="lsp_dataset, or an annotation file.", metavar="FOLDER|FILE.npz")],
    parts: Annotated[
        Path | None, typer.Option(help="im1001_part_segmentation.png and so on, of UPi-S1h.", metavar="FOLDER")
    ] = None,
    labels: Annotated[str, typer.Option(help="Label set of --parts, or a JSON file.", metavar="NAME")] = "lsp6",
    pictures: PicturesOption = None,
    *,
    options: RunOptions,
) -> None:
    """Leeds Sports Pose with UP-3D's six parts: foreground and part accuracy and F1."""
    from ..evaluation.datasets import read_lsp

    _evaluate(read_lsp(path, parts=parts, labels=_label_set(labels), pictures=pictures), options)


def pw3d(
    path: Annotated[Path, typer.Argument(help="SPIN's 3dpw_test.npz or the like.", metavar="FILE.npz")],
    keypoints: KeypointsOption = None,
    pictures: PicturesOption = None,
    *,
    options: RunOptions,
) -> None:
    """3DPW, in SPIN's annotation arrays; 3D errors need the array S in the file."""
    from ..evaluation.datasets import read_pw3d

    _evaluate(read_pw3d(path, pictures=pictures, keypoints=keypoints), options)


evaluate.command("folder")(grouped(folder))
evaluate.command("h36m")(grouped(h36m))
evaluate.command("lsp")(grouped(lsp))
evaluate.command("3dpw")(grouped(pw3d))
evaluate.command("partbench")(run_partbench)


def _label_set(name: str | None) -> LabelSet | None:
    from ..inputs.part_labels import read_label_set

    return None if name is None else read_label_set(name)


def _evaluate(samples: Iterable[Sample], options: RunOptions) -> None:
    limit, jobs, names, out = options.limit, options.jobs, options.methods, options.out
    for option, number in (("--limit", limit), ("--jobs", jobs)):
        if number is not None and number < 1:
            raise InputError(f"{option}: {number}; expected 1 or more")
    people = list(islice(samples, limit))
    if not people:
        raise InputError("the data set: nobody in it; expected at least one person")

    from ..bench.machine import about
    from ..bench.report import wide_console
    from ..evaluation.evaluate import METHODS, evaluate, one_thread, tables
    from ..interop.devices import choose_device
    from ..results.result_sets import check_folder
    from .progress import FitProgress

    if unknown := set(names or ()) - METHODS.keys():
        raise InputError(f"--method: {', '.join(sorted(unknown))}; expected {', '.join(METHODS)}")
    labelled = any(sample.parts is not None for sample in people)
    methods = {
        name: method
        for name, method in METHODS.items()
        if (name in names if names else labelled or name == "keypoints only")
    }
    if out is not None:
        if out.is_dir():
            raise InputError(f"--out: {out}: a folder; expected a file")
        check_folder(out.parent)
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # for the processes to come
    one_thread()
    where = choose_device(options.device)
    with FitProgress() as progress:
        report = evaluate(people, methods, jobs=jobs, device=where, progress=progress)

    console = wide_console()
    for table in tables(report):
        console.print(table)
    if all(sample.joints is None and sample.target is None for sample in people):
        typer.echo("Neither labels nor 3D joints are known: only keypoints are compared.", err=True)
    for failure in report.failures:
        typer.echo(f"not fitted: {failure.sample}, {failure.method}: {failure.reason}", err=True)
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        figures = {"about": {**about(where), "jobs": jobs}, **report.to_json()}
        out.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
        typer.echo(f"{out} holds the same figures, and each fit's")
