"""Commands of ``partdr evaluate`` for views of real people with 3D truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from ..errors import InputError
from .evaluate_fits import RunOptions, check_counts, choose_methods, fit_samples, one_thread_device
from .fit_request import QualityName

if TYPE_CHECKING:
    import numpy as np

    from ..inputs.sample import Sample
    from ..lab.evaluation.datasets import Views, ViewSelection

_NONE, _TRUE, _OWN = "none", "true", "own"
_SET, _PERSON = "set", "person"


@dataclass(frozen=True)
class ViewOptions:
    """Options for views of real people: the people, the knowledge of a fit, and the tables."""

    rows: Annotated[
        str,
        Option(
            help="Views to take: inside (all joints in the picture), baseline (those the file marks), or every.",
            metavar="ROWS",
        ),
    ] = "inside"
    people: Annotated[
        list[str] | None,
        Option(help="Take only this set or person, SET/PERSON. May be repeated.", metavar="NAME"),
    ] = None
    leave_out: Annotated[
        list[str] | None, Option(help="Leave out this set or person. May be given several times.", metavar="NAME")
    ] = None
    frames: Annotated[
        list[str] | None, Option("--frame", help="Take only this frame. May be given several times.", metavar="NAME")
    ] = None
    step: Annotated[int, Option(help="Take every Nth of these views.", metavar="N")] = 1
    camera: Annotated[
        str,
        Option(
            help="Camera that fits get: none (they assume a usual lens), true (the file's camera), or a focal length, "
            "where 1.0 is the picture's longer side.",
            metavar="LENS",
        ),
    ] = _NONE
    stature: Annotated[
        str,
        Option(
            help="Height of the people that fits get: none, true (the file's), or one number for all [m].",
            metavar="HEIGHT",
        ),
    ] = _NONE
    convention: Annotated[
        str | None,
        Option(
            help="Definition of the file's joints: coco, h36m, shelf, or own (the joints of this package's bodies). "
            "Default: by the set's name.",
            metavar="NAME",
        ),
    ] = None
    keypoints: Annotated[
        str | None,
        Option(
            help="Fit only the joints of this format, such as coco17. Default: all of the file.",
            metavar="FORMAT",
        ),
    ] = None
    network: Annotated[Path | None, Option(help="Label network that `partdr train` wrote.", metavar="FILE")] = None
    quality: Annotated[QualityName, Option(help="Quality of fits: fast, balanced or accurate.", metavar="NAME")] = (
        QualityName.balanced
    )
    by: Annotated[str, Option(help="Print a table for each set, or for each person.", metavar="set|person")] = _SET
    intervals: Annotated[
        str,
        Option(help="Units that intervals resample: people, or moments of people.", metavar="people|moments"),
    ] = "people"

    def select(self) -> ViewSelection:
        """Choose the views."""
        from ..lab.evaluation.datasets import ViewSelection

        return ViewSelection(
            self.rows, tuple(self.people or ()), tuple(self.leave_out or ()), tuple(self.frames or ()), self.step
        )


@dataclass(frozen=True)
class JointFileOptions:
    """Options for a file of joints over time, with calibrated cameras."""

    cameras: Annotated[
        Path | None, Option(help="File of calibrated cameras, for a .trc file or joints over time.", metavar="FILE")
    ] = None
    films: Annotated[
        Path | None, Option(help="Films of these cameras, for the methods 'photo alone'.", metavar="FOLDER")
    ] = None
    axes: Annotated[
        str | None,
        Option(help="Axes of the file that are x, y and z in the world of the cameras.", metavar='"x -z y"'),
    ] = None


def real(
    path: Annotated[Path, Argument(help="File of views, or a data set's own files.", metavar="FOLDER|FILE")],
    save: Annotated[Path | None, Option(help="File for the views that are fitted.", metavar="FILE.npz")] = None,
    *,
    views: ViewOptions,
    joints: JointFileOptions,
    options: RunOptions,
) -> None:
    """Evaluate on real people with true 3D joints: joints, sizes and stated depths, with intervals over people.

    Example: `partdr evaluate real views.npz --rows baseline --camera none`

    It reads views.npz (docs/how_to/evaluate.md), SPIN's .npz, MPI-INF-3DHP's annot.mat, Human3.6M's annot.h5, and
    .trc.
    """
    from ..lab.evaluation.datasets import read_real, write_views

    check_counts(limit=options.limit, jobs=options.jobs, step=views.step)
    found = read_real(path, cameras=joints.cameras, films=joints.films, axes=joints.axes)
    rows = views.select().of(found)[: options.limit]
    if save is not None:
        write_views(save, found.rows(rows))
        typer.echo(f"{save} holds these views")
    _evaluate_views(found, rows, views, options)


def _evaluate_views(views: Views, rows: np.ndarray, chosen: ViewOptions, options: RunOptions) -> None:
    from ..lab.evaluation.datasets import view_samples
    from ..lab.evaluation.pairs import compare_pairs
    from ..lab.evaluation.real import PAIRS, real_methods

    _check_word("by", chosen.by, (_SET, _PERSON))
    convention = "" if chosen.convention == _OWN else chosen.convention
    samples = view_samples(
        views,
        rows,
        convention=convention,
        keypoints=chosen.keypoints,
        clusters=chosen.intervals,
    )
    if chosen.by == _PERSON:
        people = views.people()[rows].tolist()
        samples = [replace(sample, source=person) for sample, person in zip(samples, people, strict=True)]
    camera = _number("camera", chosen.camera)
    if isinstance(camera, float):
        samples = _with_lens(samples, camera)
    elif camera and any(sample.camera is None for sample in samples):
        raise InputError(
            "--camera: true, but the file has no focal and centre; expected these arrays, or another camera"
        )
    stature = _number("stature", chosen.stature)
    if stature is True and (unknown := [sample.name for sample in samples if sample.stature is None]):
        missing = f"true, but that of {unknown[0]} is not known (nor of {len(unknown) - 1} more)"
        raise InputError(
            f"--stature: {missing}; expected the array stature, joints from ankles to shoulders, or metres"
        )
    methods = real_methods(
        chosen.quality.value,  # type: ignore[arg-type]  # its names
        camera=camera is not False,
        stature=stature,
        network=None if chosen.network is None else str(chosen.network),
    )
    served = [name for name, method in methods.items() if any(map(method.serves, samples))]
    some = choose_methods(methods, options.methods or served)
    options.check_out()
    device = one_thread_device(options.device)
    report, figures = fit_samples(samples, some, options.jobs, device, clusters=chosen.intervals, pooled=True)
    for source, finding in compare_pairs(report, PAIRS):
        typer.echo(f"{source}: {finding}")
    options.save(figures)


def _check_word(name: str, given: str, known: Sequence[str]) -> None:
    if given not in known:
        raise InputError(f"--{name}: {given}; expected {' or '.join(known)}")


def _number(name: str, given: str) -> bool | float:
    """Parse an option: False for "none", True for "true", or a positive number."""
    if given in (_NONE, _TRUE):
        return given == _TRUE
    try:
        number = float(given)
    except ValueError:
        number = 0.0
    if not 0 < number < 100:
        raise InputError(f"--{name}: {given}; expected none, true, or a number above 0")
    return number


def _with_lens(samples: Sequence[Sample], share: float) -> list[Sample]:
    """Samples with a camera whose focal length is ``share`` times the picture's longer side."""
    from ..cameras import Perspective

    found = []
    for sample in samples:
        size = sample.keypoints.image_size
        if size is None:
            raise InputError(f"--camera: {share:g}, but the file has no picture_size; expected this array, or none")
        found.append(replace(sample, camera=Perspective.of_picture(size, focal=share * max(size))))
    return found
