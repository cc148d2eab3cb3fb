"""Fit of films, by ``partdr fit FILM`` and ``partdr scene``: the motion of all people in them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from ..errors import InputError, told_as
from ..inputs.films import film_facts, is_photo, read_frames
from ..inputs.part_labels import scan_photo
from .fit_request import FitRequest, QualityName, StartName
from .loading import NO_MODEL, load_mesh_kernels
from .options import EXIF, CameraOptions, NetworkOptions, RunSettings, distance_words
from .register import read_model

if TYPE_CHECKING:
    from ..inputs.calibrated_camera import CalibratedCamera
    from ..networks.predictors.film_sights import GivenNetworks
    from ..pipelines.seen_film import SeenFilm
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
    check_film_view(request.view, [film])
    film_facts(film)  # raises faults of the file before anything is loaded

    fit_films(
        FilmRun(
            films=(film,),
            out=request.out,
            device=request.device,
            model=request.model,
            person=files.person,
            min_score=request.score,
            settings=request.run,
            networks=files.networks,
            view=request.view,
        )
    )


def check_film_view(view: CameraOptions, films: Sequence[Path]) -> None:
    """Raise an InputError if camera options don't fit films, or photos among them."""
    if view.focal == EXIF and not all(map(is_photo, films)):
        raise InputError("--focal: exif, with a film; expected pixels, or --fov")
    view.check()


@dataclass(frozen=True)
class FilmRun:
    """Films to fit, and the options of the fit.

    Attributes:
        films: Films of the same moments.
        out: Folder for the results.
        device: Device, as the option gives it.
        model: Name or file of the detailed model.
        person: Index of the only person to fit; None: all people.
        min_score: Least confidence that there is a person.
        settings: Settings; those of the fit are fields of ``SceneOptions``.
        networks: Networks from other projects.
        view: Camera, or the lens of each of several cameras.
        cameras: File or folder of calibrated cameras. None: the positions of several cameras are found from the people.
        align: True if frames that show the same moment must be found.
    """

    films: tuple[Path, ...]
    out: Path
    device: str
    model: str
    person: int | None
    min_score: float
    settings: RunSettings
    networks: NetworkOptions = field(default_factory=NetworkOptions)
    view: CameraOptions = field(default_factory=CameraOptions)
    cameras: Path | None = None
    align: bool = False


def fit_films(run: FilmRun) -> None:
    """Find people, fit their motions, write the results and print a summary."""
    from ..files.sections import read_section
    from ..interop.devices import choose_device
    from ..kernels.launch import set_num_threads
    from ..pipelines.film import fit_film
    from ..pipelines.film_pieces import FilmPieces
    from ..pipelines.found_films import FilmSearch
    from ..results.result_sets import check_folder, check_inputs
    from ..results.save_film import CAMERAS, overlay_name, save_film_fit
    from ..solve.scene.options import SceneOptions
    from .progress import FitProgress

    run.networks.check_film()
    films, where = run.films, choose_device(run.device)
    set_num_threads(run.settings.threads)
    options = read_section(SceneOptions, run.settings.fit, base=SceneOptions.film())
    check_folder(run.out)
    check_inputs(run.out, (*films, run.cameras), [CAMERAS, *map(overlay_name, range(len(films)))])
    rig = _read_rig(run, options)
    photos = [film for film in films if rig is None and is_photo(film)]
    lenses = {film: run.view.of_photo(scan_photo(film), film) for film in photos}
    search = FilmSearch(
        films,
        options,
        lens=lambda film, size: lenses.get(film) or run.view.read(size, None),
        device=where,
        min_score=run.min_score,
        networks=_load_networks(run.networks, where),
        rig=rig,
        person=run.person,
        align=run.align,
    )
    detailed = read_model(run.model, where)
    others = [] if run.cameras is None or run.cameras.is_dir() else [run.cameras]
    given = (*films, *others, *run.networks.files)
    pieces = FilmPieces(
        run.out,
        given,
        rig,
        run.view,
        run.networks,
        options,
        run.person,
        run.model,
        run.min_score,
        run.align,
    )
    with FitProgress() as progress:
        load_mesh_kernels(where)
        observed = search.find(pieces, progress)
        if search.places_cameras:
            options = replace(options, stature=None)  # it has set the distances of the cameras already
        fit = fit_film(
            observed,
            person=run.person,
            options=options,
            model=detailed,
            device=where,
            progress=progress,
            pieces=pieces,
        )
        report = save_film_fit(fit, run.out, films=films, formats=run.settings.formats, progress=progress)
        pieces.remove()
    for warning in report["warnings"]:
        typer.echo(f"partdr: warning: {warning}", err=True)
    for film, each in zip(films, observed, strict=True):
        for warning in each.given.gaps if each.given is not None else ():
            typer.echo(f"partdr: warning: {film}: {warning}", err=True)
    _summarise(run, observed, report)


def _read_rig(run: FilmRun, options: SceneOptions) -> list[CalibratedCamera] | None:
    """Read calibrated cameras of the films, if a file of them is given; faults are raised before people are found."""
    from ..inputs.camera_files import cameras_of_films

    if run.cameras is None:
        return None
    rig = cameras_of_films(run.cameras, run.films, warn=_echo)
    options.check_sights(1, len(run.films))
    for film, camera in zip(run.films, rig, strict=True):
        picture = next(read_frames(film)).picture
        with told_as("picture", film):
            camera.fitted((picture.shape[0], picture.shape[1]))
    return rig


def _load_networks(options: NetworkOptions, device: str) -> GivenNetworks | None:
    """Load networks from other projects, if there are any."""
    from ..networks.predictors.film_sights import GivenNetworks

    if not options.given:
        return None
    loaded = options.load(device)
    return GivenNetworks(loaded.parts_from, loaded.keypoints_from)


def _echo(sentence: str) -> None:
    typer.echo(f"partdr: {sentence}", err=True)


def _summarise(run: FilmRun, observed: Sequence[SeenFilm], report: dict[str, Any]) -> None:
    """Print lines about the results and their files."""
    from ..body.rotations import rotation_to_axis_angle
    from ..cameras import UsualLens
    from ..results.save_film import CAMERAS, SCENE, overlay_name

    several = len(observed) > 1
    films, out = run.films, run.out
    assumed = any(isinstance(each.view.camera, UsualLens) for each in observed)
    exact = not assumed and (run.cameras is not None or not several)
    for person in report["people"]:
        frames = f"frames {person['first_frame']} to {person['last_frame']}, seen in {person['frames_seen']}"
        by = f", by {', '.join(person['seen_by'])}" if several else ""
        distance = distance_words(person["distance_m"], exact=exact, assumed=assumed)
        typer.echo(f"person{person['person']}: {frames}{by}; {distance}")
    if run.align:
        for film, each in zip(films, observed, strict=True):
            typer.echo(f"{film.name}: from frame {each.skipped} on")
    if run.cameras is None and several:
        for film, each in zip(films[1:], observed[1:], strict=True):
            turn = math.degrees(float(rotation_to_axis_angle(each.view.rotation).norm()))
            away = f"about {float(each.view.eye.norm()):.1f} m from the camera of {films[0].name}"
            typer.echo(f"{film.name}: {away}, turned by {turn:.0f} degrees")
        typer.echo(f"{out / CAMERAS} says so, --cameras takes it")
    typer.echo(f"{out / overlay_name(0)} shows all bodies, {out / SCENE} moves in Blender")
