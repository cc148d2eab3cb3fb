"""Fit of films, by ``partdr fit FILM`` and ``partdr scene``: the motion of all people in them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from ..errors import InputError, told_as
from ..inputs.films import film_facts, is_photo, read_frames
from ..inputs.part_labels import scan_photo
from .fit_request import FitRequest, QualityName, StartName
from .loading import NO_MODEL, load_mesh_kernels
from .options import NetworkOptions, distance_words
from .register import read_model
from .scene_request import RigOptions, SceneRequest

if TYPE_CHECKING:
    from ..inputs.calibrated_camera import CalibratedCamera
    from ..networks.predictors.film_predictions import GivenNetworks
    from ..pipelines.observed_film import ObservedFilm
    from ..solve.scene.options import SceneOptions


def fit_motions(request: FitRequest) -> None:
    """Fit motions to all people in a film, or to one of them; write the results and print a summary.

    Raises:
        InputError: If an option is only for photos, or the film can't be fitted.
    """
    film, files = request.photo, request.files
    assert film is not None  # it is a film
    if request.explain:
        raise InputError("--explain: with a film; expected a photo")
    if request.quality is not QualityName.balanced or request.start is not StartName.network:
        raise InputError("--quality, --start: with a film; expected none, or --set mesh.iterations=30, for example")
    for name, given in (("keypoints", files.keypoints), ("parts", files.parts)):
        if given is not None:
            raise InputError(f"--{name}: {given}, with a film; expected a film alone")
    files.networks.check()
    if request.model == NO_MODEL:
        raise InputError("--model: none, with a film; expected a detailed model")
    request.view.check_films([film])
    film_facts(film)  # raises faults of the file before anything is loaded

    fit_films([film], request)


def fit_films(paths: Sequence[Path], request: FitRequest | SceneRequest, rig: RigOptions | None = None) -> None:
    """Find people in films, fit their motions, write the results and print a summary.

    Args:
        paths: Films that were taken at the same time.
        request: Options of the command.
        rig: Options for the cameras of several films.
    """
    from ..files.sections import read_section
    from ..interop.devices import choose_device
    from ..kernels.launch import set_num_threads
    from ..pipelines.film import fit_film
    from ..pipelines.film_pieces import FilmPieces
    from ..pipelines.film_search import FilmSearch
    from ..results.result_sets import check_folder, check_inputs
    from ..results.save_film import CAMERAS, CURVES, overlay_name, save_film_fit
    from ..solve.scene.options import SceneOptions
    from .progress import FitProgress

    rig = rig or RigOptions()
    request.networks.check_film()
    device = choose_device(request.device)
    set_num_threads(request.run.threads)
    options = read_section(SceneOptions, request.run.fit, base=SceneOptions.film())
    check_folder(request.out)
    check_inputs(request.out, (*paths, rig.cameras), [CAMERAS, CURVES, *map(overlay_name, range(len(paths)))])
    cameras = _read_rig(rig.cameras, paths, options)
    photos = [path for path in paths if cameras is None and is_photo(path)]
    lenses = {path: request.view.of_photo(scan_photo(path), path) for path in photos}
    search = FilmSearch(
        paths,
        options,
        lens=lambda path, size: lenses.get(path) or request.view.read(size, None),
        device=device,
        min_score=request.score,
        networks=_load_networks(request.networks, device),
        rig=cameras,
        person=request.person,
        align=rig.align,
    )
    detailed = read_model(request.model, device)
    camera_files = [] if rig.cameras is None or rig.cameras.is_dir() else [rig.cameras]
    pieces = FilmPieces(
        request.out,
        (*paths, *camera_files, *request.networks.files),
        cameras,
        request.view,
        request.networks,
        options,
        request.person,
        request.model,
        request.score,
        rig.align,
    )
    with FitProgress() as progress:
        load_mesh_kernels(device)
        films = search.find(pieces, progress)
        if search.places_cameras:
            options = replace(options, stature=None)  # the positions of the cameras depend on it already
        fit = fit_film(
            films,
            person=request.person,
            options=options,
            model=detailed,
            device=device,
            progress=progress,
            pieces=pieces,
        )
        report = save_film_fit(
            fit, request.out, films=paths, formats=request.run.formats, bare=request.bare, progress=progress
        )
        pieces.remove()
    for warning in report["warnings"]:
        typer.echo(f"partdr: warning: {warning}", err=True)
    for path, film in zip(paths, films, strict=True):
        for warning in film.given.warnings if film.given is not None else ():
            typer.echo(f"partdr: warning: {path}: {warning}", err=True)
    _print_report(films, paths, request.out, rig, report)


def _read_rig(file: Path | None, paths: Sequence[Path], options: SceneOptions) -> list[CalibratedCamera] | None:
    """Calibrated cameras of the films, if there is a file. They are checked before the search for people begins."""
    from ..inputs.camera_files import cameras_of_films

    if file is None:
        return None
    cameras = cameras_of_films(file, paths, warn=_echo)
    options.check_known_stature(1, len(paths))
    for path, camera in zip(paths, cameras, strict=True):
        picture = next(read_frames(path)).picture
        with told_as("picture", path):
            camera.fitted((picture.shape[0], picture.shape[1]))
    return cameras


def _load_networks(options: NetworkOptions, device: str) -> GivenNetworks | None:
    """Load networks from other projects, if there are any."""
    from ..networks.predictors.film_predictions import GivenNetworks
    from ..networks.predictors.networks import PartNetwork

    if not options.given:
        return None
    loaded = options.load(device)
    parts_from = loaded.parts_from if isinstance(loaded.parts_from, PartNetwork) else None
    return GivenNetworks(parts_from, loaded.keypoints_from)


def _echo(sentence: str) -> None:
    typer.echo(f"partdr: {sentence}", err=True)


def _print_report(
    films: Sequence[ObservedFilm], paths: Sequence[Path], out: Path, rig: RigOptions, report: dict[str, Any]
) -> None:
    """Print lines about the results and their files."""
    from ..body.rotations import rotation_to_axis_angle
    from ..cameras import UsualLens
    from ..results.save_film import CAMERAS, CURVES, SCENE, overlay_name

    several = len(films) > 1
    assumed = any(isinstance(film.view.camera, UsualLens) for film in films)
    exact = not assumed and (rig.cameras is not None or not several)
    for person in report["people"]:
        frames = f"frames {person['first_frame']} to {person['last_frame']}, seen in {person['frames_seen']}"
        by = f", by {', '.join(person['seen_by'])}" if several else ""
        distance = distance_words(person["distance_m"], exact=exact, assumed=assumed)
        mean = person["mean_confidence"]
        sure = "confidence unknown" if mean is None else f"confidence {mean:.2f} on average"
        typer.echo(f"person{person['person']}: {frames}{by}; {distance}; {sure}")
    if rig.align:
        for path, film in zip(paths, films, strict=True):
            typer.echo(f"{path.name}: from frame {film.skipped} on")
    if rig.cameras is None and several:
        for path, film in zip(paths[1:], films[1:], strict=True):
            turn = math.degrees(float(rotation_to_axis_angle(film.view.rotation).norm()))
            away = f"about {float(film.view.eye.norm()):.1f} m from the camera of {paths[0].name}"
            typer.echo(f"{path.name}: {away}, turned by {turn:.0f} degrees")
        typer.echo(f"{out / CAMERAS} says so, --cameras takes it")
    shown = f"{out / overlay_name(0)} shows all bodies, {out / CURVES} the confidence in them"
    typer.echo(f"{shown}, {out / SCENE} moves in Blender")
