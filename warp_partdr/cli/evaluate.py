"""Command ``partdr evaluate``: fit the people of a data set, or of PartBench, and measure how good the fits are."""

from __future__ import annotations

import os
from collections.abc import Iterable
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from ..errors import InputError
from .evaluate_fits import RunOptions, check_counts, choose_methods, fit_samples, one_thread_device
from .evaluate_views import real
from .options import DeviceOption, LabelsOption, grouped

if TYPE_CHECKING:
    from ..body.labels import LabelSet
    from ..inputs.sample import Sample
    from ..lab.evaluation.evaluate import Evaluated, Fitting

QUICK_LEVELS = ("clean", "realistic")
PEOPLE, QUICK_PEOPLE = 20, 6  # take ten minutes and one minute on two cores

evaluate = typer.Typer(
    help="Measure how good fits are on a data set: parts, keypoints and 3D joints, with 95 % intervals. "
    "See docs/how_to/evaluate.md.",
    no_args_is_help=True,
)


PicturesOption = Annotated[Path | None, Option(help="The data set's pictures; not needed to fit.", metavar="FOLDER")]
KeypointsOption = Annotated[
    Path | None, Option(help="2D keypoints, a JSON file for each picture, instead of the file's own.", metavar="FOLDER")
]


def folder(
    path: Annotated[
        Path, Argument(help="Folder with N.jpg, N.keypoints.json and, if you like, N.parts.png.", metavar="FOLDER")
    ],
    labels: LabelsOption = None,
    *,
    options: RunOptions,
) -> None:
    """Evaluate on your own pictures: it measures how well bodies follow the given labels and keypoints.

    Example: `partdr evaluate folder pictures --limit 10`

    Without --labels, labels.json in the folder describes the part labels.
    """
    from ..inputs.photo_files import LeftOut
    from ..lab.evaluation.datasets import read_folder

    check_counts(limit=options.limit, jobs=options.jobs)
    left_out = LeftOut()
    people = list(islice(read_folder(path, _label_set(labels), left_out), options.limit))
    if left_out:
        typer.echo(f"partdr: {left_out}", err=True)
    _evaluate(people, options)


def h36m(
    path: Annotated[
        Path, Argument(help="SPIN's h36m_valid_protocol1.npz, or a file with the same arrays.", metavar="FILE.npz")
    ],
    keypoints: KeypointsOption = None,
    pictures: PicturesOption = None,
    *,
    options: RunOptions,
) -> None:
    """Evaluate on Human3.6M, in SPIN's annotation arrays: MPJPE and PA-MPJPE.

    Example: `partdr evaluate h36m h36m_valid_protocol1.npz --limit 100`
    """
    from ..lab.evaluation.datasets import read_human36m

    _evaluate(read_human36m(path, pictures=pictures, keypoints=keypoints), options)


def lsp(
    path: Annotated[Path, Argument(help="The folder lsp_dataset, or an annotation file.", metavar="FOLDER|FILE.npz")],
    parts: Annotated[
        Path | None,
        Option(help="Folder of UPi-S1h with im1001_part_segmentation.png and so on.", metavar="FOLDER"),
    ] = None,
    labels: Annotated[str, Option(help="Label set of --parts, or a JSON file.", metavar="NAME")] = "lsp6",
    pictures: PicturesOption = None,
    *,
    options: RunOptions,
) -> None:
    """Evaluate on Leeds Sports Pose with UP-3D's six parts: accuracy and F1 of foreground and parts.

    Example: `partdr evaluate lsp lsp_dataset --parts upi-s1h --limit 100`
    """
    from ..lab.evaluation.datasets import read_lsp

    _evaluate(read_lsp(path, parts=parts, labels=_label_set(labels), pictures=pictures), options)


def pw3d(
    path: Annotated[Path, Argument(help="SPIN's 3dpw_test.npz, or a file with the same arrays.", metavar="FILE.npz")],
    keypoints: KeypointsOption = None,
    pictures: PicturesOption = None,
    *,
    options: RunOptions,
) -> None:
    """Evaluate on 3DPW, in SPIN's annotation arrays. For 3D errors, the file must have the array S.

    Example: `partdr evaluate 3dpw 3dpw_test.npz --limit 100`
    """
    from ..lab.evaluation.datasets import read_pw3d

    _evaluate(read_pw3d(path, pictures=pictures, keypoints=keypoints), options)


def partbench(
    quick: Annotated[
        bool, Option("--quick", help=f"Take {QUICK_PEOPLE} people, two levels and only EllipBody: a minute.")
    ] = False,
    people: Annotated[
        int | None, Option(help=f"Take the first N of the 200 people; default: {PEOPLE}.", metavar="N")
    ] = None,
    level: Annotated[
        list[str] | None,
        Option(
            "--level",
            "--levels",
            help="Level of difficulty: clean, mild, realistic, hard (default: these four), near, far, tilted, turned, "
            "clothed, photo, crossed, pairs, groups, clip, views. May be given several times.",
            metavar="NAME",
        ),
    ] = None,
    method: Annotated[
        list[str] | None,
        Option(
            "--method",
            "--methods",
            help="Row of the tables. May be given several times. Default: all.",
            metavar="NAME",
        ),
    ] = None,
    mocap: Annotated[
        Path | None, Option(help="Folder of motion capture with cmu_expmap.npz, for --level clip.", metavar="FOLDER")
    ] = None,
    jobs: Annotated[
        int | None, Option(help="Number of fits at a time, each in a process; default: one a core.", metavar="N")
    ] = None,
    device: DeviceOption = "cpu",
    out: Annotated[
        Path | None,
        Option(help="Folder for partbench.html, which shows the worst fits, and partbench.json.", metavar="FOLDER"),
    ] = None,
) -> None:
    """Evaluate on PartBench: synthetic people whose true bodies are known. Nothing must be downloaded.

    Example: `partdr evaluate partbench --quick`

    It takes ten minutes on two cores, one minute with --quick.
    """
    check_counts(jobs=jobs, people=people)
    from ..lab.evaluation.partbench.crossed import CASES, CROSSED_METHODS, crossed_samples
    from ..lab.evaluation.partbench.methods import METHODS, QUICK
    from ..lab.evaluation.partbench.report import compare_methods, write_report
    from ..lab.evaluation.partbench.samples import CLIP, CROSSED, SCENES, partbench_samples
    from ..lab.evaluation.partbench.scenes import SCENE_METHODS, partbench_scenes
    from ..lab.synthetic.noise import LEVELS
    from ..lab.tables import save_figures
    from ..results.result_sets import check_folder

    if out is not None:
        check_folder(out)
    every: dict[str, Fitting] = {**METHODS, **CROSSED_METHODS, **SCENE_METHODS}
    methods = choose_methods(every, method or ([*QUICK, *CROSSED_METHODS, *SCENE_METHODS] if quick else every))
    levels = level or (QUICK_LEVELS if quick else tuple(LEVELS))
    if mocap is not None and CLIP not in levels:
        raise InputError(f"--mocap: {mocap}, without --level {CLIP}; expected both")
    where = one_thread_device(device)
    processes = jobs or ((os.cpu_count() or 1) if where == "cpu" else 1)
    count = people or (QUICK_PEOPLE if quick else PEOPLE)
    scenes = [each for each in levels if each in SCENES]
    singles = [each for each in levels if each not in (*SCENES, CROSSED)]
    samples: list[Evaluated] = [*partbench_samples(count, singles), *partbench_scenes(range(count), scenes, mocap)]
    if CROSSED in levels:
        samples += crossed_samples(people or (QUICK_PEOPLE if quick else CASES))
    report, figures = fit_samples(samples, methods, processes, where)
    for finding in compare_methods(report):
        typer.echo(finding)
    if out is not None:
        page, data = out / "partbench.html", out / "partbench.json"
        save_figures(figures, data)
        write_report(page, report, samples, methods, figures["about"], device=where)
        typer.echo(f"{page} shows the worst fits, {data} holds each fit's figures")


evaluate.command("folder")(grouped(folder))
evaluate.command("real")(grouped(real))
evaluate.command("h36m")(grouped(h36m))
evaluate.command("lsp")(grouped(lsp))
evaluate.command("3dpw")(grouped(pw3d))
evaluate.command("partbench")(partbench)


def _evaluate(samples: Iterable[Sample], options: RunOptions) -> None:
    check_counts(limit=options.limit, jobs=options.jobs)
    people = list(islice(samples, options.limit))
    if not people:
        raise InputError("the data set: nobody in it; expected at least one person")

    from ..lab.evaluation.evaluate import METHODS

    labelled = any(sample.parts is not None for sample in people)
    methods = choose_methods(METHODS, options.methods or (METHODS if labelled else ["keypoints only"]))
    options.check_out()
    figures = fit_samples(people, methods, options.jobs, one_thread_device(options.device))[1]
    if all(sample.joints is None and sample.target is None for sample in people):
        typer.echo("Neither labels nor 3D joints are known: only keypoints are compared.", err=True)
    options.save(figures)


def _label_set(name: str | None) -> LabelSet | None:
    from ..body.labels import label_set

    return None if name is None else label_set(name)
