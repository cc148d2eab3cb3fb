"""Fit of one person, by ``partdr fit`` with the person's keypoints and, perhaps, part labels."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from ..errors import InputError
from .fit_request import FitRequest
from .loading import NO_MODEL, load_kernels, load_mesh_kernels
from .options import confidence_words
from .register import BodyPicture, clothe, describe_detailed, describe_scores, read_model

if TYPE_CHECKING:
    from ..cameras import Perspective
    from ..inputs.person import PersonInputs
    from ..models.model import DetailedModel
    from ..solve.ellipsoids.options import FitOptions
    from ..solve.mesh.mesh_stage import MeshFit

_FAULTS = (ValueError, RuntimeError)  # errors of a detailed body, also of torch and Warp, such as no memory left


def fit_person(request: FitRequest) -> None:
    """Fit a body to one person; write the results and print a summary.

    Raises:
        InputError: If the files and options don't go together, or the detailed body fails.
    """
    if request.min_score is not None:
        raise InputError(f"--min-score: {request.min_score:g}, with --keypoints; expected a photo alone")
    person = request.files.read(request.photo)

    # Imported after the files are read, so that faults in them are found at once.
    from ..interop.devices import choose_device
    from ..kernels.launch import set_num_threads
    from ..results.result_sets import check_folder
    from ..results.save import image_size, save_fit
    from ..solve.confidence.judge import judge_fits
    from ..solve.ellipsoids.fitting import fit_body
    from ..solve.mesh.mesh_stage import refine_mesh
    from .progress import FitProgress

    where = choose_device(request.device)
    set_num_threads(request.run.threads)
    with_labels = person.parts is not None
    options = _options(request, with_labels=with_labels)
    check_folder(request.out)
    _check_inputs(request, options)
    size = image_size(person.keypoints, person.parts, person.photo)
    camera = request.view.of_photo(size, request.photo)
    detailed_model = None if request.model == NO_MODEL else read_model(request.model, where)
    if request.explain:
        _explain(person, options, camera, detailed_model)
    mesh, failure = None, None
    with FitProgress() as progress:
        load_kernels(where, options, with_labels=with_labels)
        result = fit_body(
            person.keypoints,
            person.parts,
            others=person.others,
            options=options,
            device=where,
            camera=camera,
            progress=progress,
        )
        if with_labels and detailed_model is not None:
            try:
                load_mesh_kernels(where)
                mesh = refine_mesh(result, detailed_model, options=options.mesh, progress=progress)
                result = mesh.ellipbody
            except _FAULTS as error:
                failure = error
        progress("writing results", 1, 1)
        (confidence,) = judge_fits([result])
        result = replace(result, warnings=(*result.warnings, *confidence.warnings))
        registered = None if mesh is None else mesh.body
        report = save_fit(result, request.out, photo=person.photo, mesh=registered, confidence=confidence)
    for warning in result.warnings:
        typer.echo(f"partdr: warning: {warning}", err=True)
    _summarise(report, request.out)
    if detailed_model is None:
        return
    picture = BodyPicture(
        result.camera, size, person.photo, result.evidence, result.camera_guessed or not result.camera.perspective
    )
    try:
        if failure is not None:
            raise failure
        with FitProgress() as progress:
            if mesh is None:
                summary = clothe(
                    result.posed,
                    detailed_model,
                    request.out,
                    picture,
                    formats=request.run.formats,
                    bare=request.bare,
                    progress=progress,
                )
            else:
                summary = _save_mesh(mesh, request, picture)
    except _FAULTS as error:
        raise InputError(f"{error}; {request.out} holds the fit without its detailed body") from error
    typer.echo(summary)


def _options(request: FitRequest, *, with_labels: bool) -> FitOptions:
    """Options of the fit; raises InputError if one belongs to a stage that this fit does not have."""
    from ..solve.ellipsoids.settings import MESH
    from ..solve.ellipsoids.stages import OUTLINE

    formats, changed = request.run.formats, request.run.fit
    if formats and request.model == NO_MODEL:
        raise InputError(f"also: {', '.join(formats)}, with --model none; expected a detailed model")
    options = request.fit_options()
    clothed = with_labels and request.model != NO_MODEL
    if MESH in changed and not clothed:
        raise InputError(f"{MESH}: settings of a stage that needs part labels and a detailed model; expected both")
    if OUTLINE in changed and not with_labels:
        raise InputError(f"{OUTLINE}: settings of a stage that needs part labels; expected some")
    return request.options_before_mesh() if clothed else options


def _check_inputs(request: FitRequest, options: FitOptions) -> None:
    """Raise an InputError if a result would replace a file that was given."""
    from ..results.result_sets import check_inputs
    from ..results.save import DETAILED_FILES, RESULT_FILES, SMPLX_FILE
    from ..results.views import VIEWS

    files = request.files
    named = [options.network, files.keypoint_format, files.labels, request.model]
    given = [request.photo, files.keypoint_file(request.photo), files.parts, request.settings.config]
    given += [Path(name) for name in named if name]
    check_inputs(request.out, given, (*RESULT_FILES, *DETAILED_FILES, SMPLX_FILE, VIEWS))


def _save_mesh(mesh: MeshFit, request: FitRequest, picture: BodyPicture) -> str:
    """Write the files of the mesh stage, and return a line about them."""
    from ..results.save import save_registered

    report = save_registered(
        mesh.body,
        request.out,
        picture.camera,
        picture.image_size,
        photo=picture.photo,
        evidence=picture.evidence,
        clothes=mesh.clothes,
        formats=request.run.formats,
        bare=request.bare,
        views=picture.views(mesh.body, bare=request.bare),
        seconds=round(mesh.ellipbody.stage_seconds["mesh"], 2),
    )
    return describe_detailed(report, request.out)


def _explain(
    person: PersonInputs, options: FitOptions, camera: Perspective | None, model: DetailedModel | None
) -> None:
    from rich.console import Console

    from ..solve.ellipsoids.explain import explain, explain_mesh, print_choices

    choices = explain(person.keypoints, person.parts, others=person.others, options=options, camera=camera)
    if model is not None:
        choices.append(explain_mesh(model, person.parts, options.mesh))
    print_choices(choices, Console(highlight=False))


def _summarise(report: dict[str, Any], out: Path) -> None:
    count, start = report["hypotheses"], report["start"]
    alone = start == "network" and count == 1
    begun = "started from the label network's body" if alone else f"{count} hypotheses, the {start}'s won"
    share = report["keypoints"]["mean_distance_share_of_person_height"]
    off = f"keypoints {report['keypoints']['mean_distance_px']:.1f} px off on average"
    off += f" ({100 * share:.1f} % of the person's height)" if share else ""
    scores = [describe_scores(report)] if "parts" in report else []
    typer.echo("; ".join([f"{begun}, {report['seconds_total']:.1f} s", off, *scores, confidence_words(report)]))
    typer.echo(f"{out / 'overlay.png'} shows the body, {out / 'body.json'} its measurements")
