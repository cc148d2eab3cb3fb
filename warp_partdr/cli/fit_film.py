"""``partdr fit FILM``: the motion of everyone in a film."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import typer

from ..errors import InputError
from ..inputs.films import film_facts
from .loading import NO_MODEL, load_mesh_kernels
from .options import CameraOptions, PhotoFiles, take_whole
from .register import read_model


def fit_motions(
    files: PhotoFiles,
    film: Path,
    out: Path,
    device: str,
    model: str,
    view: CameraOptions,
    values: dict[str, Any],
    min_score: float,
) -> None:
    """Fit motions to everyone in a film, or to one of them.

    Args:
        files: Of which only ``person`` may be given.
        film: The film.
        out: Folder for the results.
        device: As the option says.
        model: Name or file of the detailed model.
        view: The camera, which stands still.
        values: Settings: ``threads``, and fields of ``SceneOptions``.
        min_score: Least confidence that there is a person.
    """
    for name, given in vars(files).items():
        if given is not None and name != "person":
            raise InputError(f"--{name.replace('_', '-')}: {given}, with a film; expected a film alone")
    if model == NO_MODEL:
        raise InputError("--model: none, with a film; expected a detailed model")
    if view.focal == "exif":
        raise InputError("--focal: exif, with a film; expected pixels, or --fov")
    view.check()
    film_facts(film)  # faults of the file are told before anything is loaded

    from ..detection.film_people import find_film_people
    from ..files.sections import read_section
    from ..interop.devices import choose_device
    from ..kernels.launch import set_num_threads
    from ..results.result_sets import check_folder, check_inputs
    from ..results.save_film import OVERLAY, save_film_fit
    from ..scenes.film import fit_film
    from ..scenes.film_pieces import FilmPieces
    from ..scenes.options import SceneOptions
    from .progress import FitProgress

    where = choose_device(device)
    set_num_threads(take_whole(values, "threads"))
    options = read_section(SceneOptions, values, base=SceneOptions.film())
    check_folder(out)
    check_inputs(out, (film,), (OVERLAY,))
    detailed = read_model(model, where)
    with FitProgress() as progress:
        load_mesh_kernels(where)
        pieces = FilmPieces(out, film, view, options, files.person, model, min_score)
        told = partial(progress, "people")
        people = pieces.people(partial(find_film_people, film, min_score=min_score, device=where, progress=told))
        camera = view.read(people.image_size, None)
        how: dict[str, Any] = {"options": options, "model": detailed, "device": where, "camera": camera}
        fit = fit_film(people, person=files.person, progress=progress, pieces=pieces, **how)
        report = save_film_fit(fit, out, film=film, progress=progress)
        pieces.remove()
    for warning in report["warnings"]:
        typer.echo(f"partdr: warning: {warning}; frames before were fitted", err=True)
    about = "" if camera is not None else "about "
    for person in report["people"]:
        frames = f"frames {person['first_frame']} to {person['last_frame']}, seen in {person['frames_seen']}"
        typer.echo(f"person{person['person']}: {frames}; {about}{person['distance_m']:.1f} m away")
    typer.echo(f"{out / OVERLAY} shows all bodies, {out / report['people'][0]['files'][1]} moves in Blender")
