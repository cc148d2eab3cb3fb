"""``partdr fit FILM``, and films of several cameras: the motion of everyone in them."""

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
from .options import EXIF, CameraOptions, NetworkOptions, RunSettings, say_distance
from .register import read_model

if TYPE_CHECKING:
    from ..inputs.calibrated_camera import CalibratedCamera
    from ..networks.predictors.film_sights import GivenNetworks
    from ..pipelines.seen_film import SeenFilm
    from ..solve.scene.options import SceneOptions


def fit_motions(request: FitRequest) -> None:
    """Fit motions to everyone in a film, or to one of them, and write and tell what was found.

    Raises:
        InputError: If an option is of photos alone, or the film can't be fitted.
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
    film_facts(film)  # faults of the file are told before anything is loaded

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
    """Raise an InputError for what cameras of films, or of photos among them, can't be."""
    if view.focal == EXIF and not all(map(is_photo, films)):
        raise InputError("--focal: exif, with a film; expected pixels, or --fov")
    view.check()


@dataclass(frozen=True)
class FilmRun:
    """Films that are to be fitted, and how.

    Attributes:
        films: Films of the same moments.
        out: Folder for the results.
        device: As the option says.
        model: Name or file of the detailed model.
        person: Whom alone.
        min_score: Least confidence that there is a person.
        settings: Settings, of the fit those of ``SceneOptions``.
        networks: Networks of others.
        view: The camera, or the lens of each of several.
        cameras: Or the file of calibrated ones; several cameras without are placed by the people.
        align: Whether it is to be found which frames of several films show one moment.
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
    """Find people, fit their motions, write and tell the results."""
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
        seen = search.find(pieces, progress)
        if search.places_cameras:
            options = replace(options, stature=None)  # cameras are as far away as it says
        fit = fit_film(
            seen,
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
    for film, each in zip(films, seen, strict=True):
        for gap in each.given.gaps if each.given is not None else ():
            typer.echo(f"partdr: warning: {film}: {gap}", err=True)
    _tell(run, seen, report)


def _read_rig(run: FilmRun, options: SceneOptions) -> list[CalibratedCamera] | None:
    """Calibrated cameras of the films, if a file of them is given; faults are told before people are looked for."""
    from ..inputs.camera_files import cameras_of_films

    if run.cameras is None:
        return None
    rig = cameras_of_films(run.cameras, run.films, warn=_say)
    options.check_sights(1, len(run.films))
    for film, camera in zip(run.films, rig, strict=True):
        picture = next(read_frames(film)).picture
        with told_as("picture", film):
            camera.fitted((picture.shape[0], picture.shape[1]))
    return rig


def _load_networks(options: NetworkOptions, device: str) -> GivenNetworks | None:
    """Networks of others, if there are any."""
    from ..networks.predictors.film_sights import GivenNetworks

    if not options.given:
        return None
    loaded = options.load(device)
    return GivenNetworks(loaded.parts_from, loaded.keypoints_from)


def _say(sentence: str) -> None:
    typer.echo(f"partdr: {sentence}", err=True)


def _tell(run: FilmRun, seen: Sequence[SeenFilm], report: dict[str, Any]) -> None:
    """Say in lines what was found, and where it is."""
    from ..body.rotations import rotation_to_axis_angle
    from ..cameras import UsualLens
    from ..results.save_film import CAMERAS, SCENE, overlay_name

    several, films, out = len(seen) > 1, run.films, run.out
    assumed = any(isinstance(each.view.camera, UsualLens) for each in seen)
    sure = not assumed and (run.cameras is not None or not several)
    for person in report["people"]:
        frames = f"frames {person['first_frame']} to {person['last_frame']}, seen in {person['frames_seen']}"
        by = f", by {', '.join(person['seen_by'])}" if several else ""
        typer.echo(
            f"person{person['person']}: {frames}{by}; {say_distance(person['distance_m'], sure=sure, assumed=assumed)}"
        )
    if run.align:
        for film, each in zip(films, seen, strict=True):
            typer.echo(f"{film.name}: from frame {each.skipped} on")
    if run.cameras is None and several:
        for film, each in zip(films[1:], seen[1:], strict=True):
            turn = math.degrees(float(rotation_to_axis_angle(each.view.rotation).norm()))
            away = f"about {float(each.view.eye.norm()):.1f} m from the camera of {films[0].name}"
            typer.echo(f"{film.name}: {away}, turned by {turn:.0f} degrees")
        typer.echo(f"{out / CAMERAS} says so, --cameras takes it")
    typer.echo(f"{out / overlay_name(0)} shows all bodies, {out / SCENE} moves in Blender")
