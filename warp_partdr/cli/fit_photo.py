"""Fit of all people in a photo, by ``partdr fit PHOTO`` without keypoints."""

from __future__ import annotations

import typer

from ..errors import InputError, printable, told_as
from .fit_request import FitRequest
from .loading import NO_MODEL, load_kernels, load_mesh_kernels
from .options import confidence_words, distance_words, read_photo_with_warnings
from .register import read_model


def fit_everyone(request: FitRequest) -> None:
    """Fit bodies to all people in a photo, or to one of them; write the results and print a summary.

    Raises:
        InputError: If the files and options don't go together, or nobody is found.
    """
    files, photo, out = request.files, request.photo, request.out
    if request.explain:
        raise InputError("--explain: without --keypoints; expected them with it")
    if photo is None:
        raise InputError("PHOTO: missing; expected a photo, or --keypoints FILE.json of a person")
    if files.parts is not None:
        raise InputError(f"--parts: {files.parts}, without --keypoints; expected them with it")
    if request.model == NO_MODEL:
        raise InputError("--model: none, without keypoints; expected a detailed model")
    files.networks.check("--keypoints")
    picture = read_photo_with_warnings(photo)

    from ..interop.devices import choose_device
    from ..kernels.launch import set_num_threads
    from ..pipelines.photo import fit_photo
    from ..results.photo_page import PAGE
    from ..results.result_sets import check_folder, check_inputs
    from ..results.save_photo import PHOTO_FILES, save_photo_fit
    from .progress import FitProgress

    options = request.options_before_mesh()
    where = choose_device(request.device)
    set_num_threads(request.run.threads)
    check_folder(out)
    check_inputs(out, (photo,), PHOTO_FILES)
    networks = files.networks.load(where)
    camera = request.view.of_photo((picture.shape[0], picture.shape[1]), photo)
    detailed = read_model(request.model, where)
    with FitProgress() as progress:
        load_kernels(where, options, with_labels=True)
        load_mesh_kernels(where)
        with told_as("photo", photo):
            fit = fit_photo(
                picture,
                person=files.person,
                min_score=request.score,
                parts_from=networks.parts_from or "packaged",
                keypoints_from=networks.keypoints_from,
                options=options,
                model=detailed,
                device=where,
                camera=camera,
                progress=progress,
            )
        progress("writing results", 0, 1)
        report = save_photo_fit(
            fit,
            out,
            photo=picture,
            formats=request.run.formats,
            name=printable(photo.name),
            bare=request.bare,
        )
    for person in report["people"]:
        for warning in person["warnings"]:
            typer.echo(f"partdr: warning: {person['folder']}: {warning}", err=True)
        hidden = "".join(f", hidden by person{index}" for index in person["hidden_by"])
        away = distance_words(person["distance_m"], exact=camera is not None, assumed=camera is None)
        typer.echo(f"{person['folder']}: {confidence_words(person)}, {away}{hidden}")
    typer.echo(
        f"{out / PAGE} shows all bodies, the least confident first; {out / 'people.json'} has their measurements"
    )
