"""``partdr fit PHOTO`` with nothing else: everyone in the photo."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from ..errors import InputError, told_as
from .loading import NO_MODEL, load_kernels, load_mesh_kernels
from .options import CameraOptions, PhotoFiles, read_shown_photo, say_distance
from .register import read_model

if TYPE_CHECKING:
    from ..solve.ellipsoids.options import FitOptions


@dataclass(frozen=True)
class PhotoSettings:
    """Settings of a fit to everyone in a photo.

    Attributes:
        threads: Number of CPU threads; 0: one a core.
        min_score: Least confidence that there is a person.
        options: Options of each person's fit.
        formats: Formats of more files.
    """

    threads: int
    min_score: float
    options: FitOptions
    formats: tuple[str, ...]


def fit_everyone(
    files: PhotoFiles,
    photo: Path | None,
    out: Path,
    device: str,
    model: str,
    view: CameraOptions,
    settings: PhotoSettings,
) -> None:
    """Fit bodies to everyone in a photo, or to one of them.

    Args:
        files: Without keypoints; networks for them or for labels, if there are any.
        photo: The photo.
        out: Folder for the results.
        device: As the option says.
        model: Name or file of the detailed model.
        view: The camera.
        settings: What the command line sets of the fit and its files.
    """
    if photo is None:
        raise InputError("PHOTO: missing; expected a photo, or --keypoints FILE.json of a person")
    if files.parts is not None:
        raise InputError(f"--parts: {files.parts}, without --keypoints; expected them with it")
    files.networks.check("--keypoints")
    picture = read_shown_photo(photo)

    from ..interop.devices import choose_device
    from ..kernels.launch import set_num_threads
    from ..pipelines.photo import fit_photo
    from ..results.result_sets import check_folder, check_inputs
    from ..results.save_photo import PHOTO_FILES, save_photo_fit
    from .progress import FitProgress

    if model == NO_MODEL:
        raise InputError("--model: none, without keypoints; expected a detailed model")
    where, options = choose_device(device), settings.options
    set_num_threads(settings.threads)
    check_folder(out)
    check_inputs(out, (photo,), PHOTO_FILES)
    networks = files.networks.load(where)
    camera = view.of_photo((picture.shape[0], picture.shape[1]), photo)
    if view.refused:
        options = replace(options, guess_camera=False)
    detailed = read_model(model, where)
    with FitProgress() as progress:
        load_kernels(where, options, with_labels=True)
        load_mesh_kernels(where)
        with told_as("photo", photo):
            fit = fit_photo(
                picture,
                person=files.person,
                min_score=settings.min_score,
                parts_from=networks.parts_from,
                keypoints_from=networks.keypoints_from,
                options=options,
                model=detailed,
                device=where,
                camera=camera,
                progress=progress,
            )
        progress("writing results", 0, 1)
        report = save_photo_fit(fit, out, photo=picture, formats=settings.formats)
    for person in report["people"]:
        for warning in person["warnings"]:
            typer.echo(f"partdr: warning: {person['folder']}: {warning}", err=True)
        hidden = "".join(f", hidden by person{place}" for place in person["hidden_by"])
        away = say_distance(person["distance_m"], sure=camera is not None, assumed=camera is None)
        typer.echo(f"{person['folder']}: score {person['score']:.2f}, {away}{hidden}")
    typer.echo(f"{out / 'overlay.png'} shows all bodies, {out / 'people.json'} has their measurements")
