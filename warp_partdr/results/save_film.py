"""Files of the people in films: a motion for each, and the films with the bodies over them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from ..body.template import LENGTH_NAMES
from ..cameras import UsualLens
from ..errors import InputError, check_type
from ..files.json_files import rounded
from ..inputs.camera_files import camera_data
from ..inputs.cuts import cuts_sentence
from ..inputs.films import read_frames
from ..inputs.frame_times import is_even
from ..interop.ahead import made_ahead
from ..interop.torch_threads import one_torch_thread
from ..models.clothes import CLOTHED
from ..models.measuring import measure_ellipbody
from ..models.suit import in_suit
from ..networks.detection.film_people import SEEN
from ..networks.predictors.film_predictions import GivenNetworks
from ..pipelines.film import FilmFit, Motion
from ..pipelines.observed_film import ObservedFilm
from ..pipelines.photo import PACKAGED
from ..solve.ellipsoids.stages import Progress
from .confidence_chart import confidence_chart
from .film_file import write_film
from .film_overlays import PosedMotions, draw_bodies, resized, zoomed_view
from .further_files import check_formats, save_further
from .motion_confidence import confidence_arrays, motion_confidence_record
from .overlays import overlay_size
from .png_files import save_png
from .predictions import ROW, FilmBodies
from .result_sets import PEOPLE_REPORT, replacing
from .scene_file import Actor, NamedView, scene_glb
from .skinned_files import Poses, bvh, glb

OVERLAY, SCENE, CAMERAS, CURVES = "overlay.mp4", "scene.glb", "cameras.json", "confidence.png"
_CHUNK = 64  # frames whose meshes are in memory at a time, to measure
_SIDE = 960  # [px], longer side of the overlay films


@one_torch_thread()
def save_film_fit(
    fit: FilmFit,
    folder: str | Path,
    *,
    films: Sequence[str | Path],
    formats: Sequence[str] = (),
    bare: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Write overlay.mp4, people.json, scene.glb and confidence.png, and for each person N personN.npz, .glb and .bvh.

    * personN.npz is described in ``predictions``. It also has ``detailed_model`` (), ``detailed_shape`` (S,),
      ``detailed_rotations`` (T, J, 3, 3), ``detailed_translation`` (T, 3) [m] and ``clothes`` (8,) [m], from which its
      EllipBodies are measured. Bodies are in the world, which is the first camera's frame. Keypoints and camera are
      those of the first film. ``confidence_arrays`` are there, too.
    * personN.glb and personN.bvh hold the motion from the person's first frame on, standing on y = 0. Files in
      ``formats`` hold it, too.
    * scene.glb holds all people at their times and positions, with the cameras.
    * confidence.png shows the confidence in each person's bodies over time.
    * overlay.mp4 is the first film with the bodies, whose guessed limbs are pale; further films have overlay1.mp4 and
      so on, and then all cameras are in cameras.json, which ``read_cameras`` reads.
    * people.json has the rate of most of the film, and the ``times`` of all frames [s]. Under ``views`` it has the
      cameras: X_camera = rotation X_world + translation, in pixels without distortion; ``lens``, the distortion that
      was removed (k1, k2, p1, p2, k3, ...); ``skipped_frames``, the frames left out at the start; ``film_frames``, for
      films that were matched, each frame's index in the file, -1 for none; and the names of the networks that found
      ``keypoints`` and ``parts``.

    Overlays, GLB and USD have the frames' own times. BVH and FBX have one rate, that of most of the film; between
    frames, joints turn the shortest way.

    Args:
        fit: Result of ``fit_film``.
        folder: Folder for the files, made if it does not exist.
        films: Files of the films, in the order of the fit.
        formats: Formats in ``FURTHER``, for more files of each motion.
        bare: True draws and writes bare skin. By default people wear a plain T-shirt and shorts.
        progress: Function that is called with the stage, the number of frames that are done, and that of all frames.

    Returns:
        Report, as ``people.json`` holds it.

    Raises:
        InputError: If a film can't be read any more, there are more or fewer films than in the fit, or results can't be
            written.
        TypeError: If ``fit`` is no ``FilmFit``.

    Examples:
        After ``motion = fit_film([ObservedFilm.of(find_film_people("walk.mp4"))])``:

        >>> from pathlib import Path
        >>> from warp_partdr import save_film_fit
        >>> report = save_film_fit(motion, "walk", films=["walk.mp4"])
        >>> sorted(path.name for path in Path("walk").glob("person0.*"))
        ['person0.bvh', 'person0.glb', 'person0.npz']
    """
    check_type("fit", fit, FilmFit, "of fit_film")
    if len(films) != len(fit.films):
        raise InputError(f"films: {len(films)} files; expected {len(fit.films)}, those of the fit")
    check_formats("formats", formats)
    progress = progress or (lambda name, done, total: None)
    warnings = [warning for each in fit.films for warning in each.people.warnings]
    warnings += [f"{each.people.fault}; frames before were fitted" for each in fit.films if each.people.fault]
    warnings += [_with_names(warning, films) for warning in fit.warnings]
    warnings += _cut_warnings(fit, films)
    report: dict[str, Any] = {"rate": fit.people.rate, "frames": len(fit.times), "warnings": warnings, "people": []}
    report["times"] = fit.times.round(6).tolist()
    report["shots"] = [_shot(shot, fit.times) for shot in fit.shots]
    report["views"] = [_view(Path(film).name, each) for film, each in zip(films, fit.films, strict=True)]
    with replacing(Path(folder), PEOPLE_REPORT, report, outdates=(PEOPLE_REPORT,)) as temporary:
        actors: list[Actor] = []
        for count, (person, motion) in enumerate(fit.motions.items()):
            progress("writing motions", count, len(fit.motions))
            rows, actor = _make_actor(fit, person, motion)
            actors.append(actor)
            own_rows = zip(report["views"], _rows_by_film(fit, person), strict=True)
            films_of_person = [view["film"] for view, own in own_rows if len(own)]
            described = _save_motion(fit, person, rows, actor, temporary, formats, bare)
            report["people"].append({**described, "seen_by": films_of_person})
        names = camera_names(films)
        views = [
            NamedView(name, each.view, each.people.image_size) for name, each in zip(names, fit.films, strict=True)
        ]
        (temporary / SCENE).write_bytes(scene_glb(actors, views, bare=bare))
        save_png(confidence_chart(fit.motions, fit.times), temporary / CURVES)
        if len(films) > 1:
            data = camera_data(dict(zip(names, (each.camera for each in fit.films), strict=True)))
            (temporary / CAMERAS).write_text(json.dumps(data, indent=1))
        total = sum(int((each.file_numbers >= 0).sum()) for each in fit.films)
        done = 0
        for index, film in enumerate(films):
            pictures = _with_progress(made_ahead(draw_film(fit, film, index, bare=bare)), done, total, progress)
            numbers = fit.films[index].file_numbers
            times = fit.times[: len(numbers)][numbers >= 0]
            even = times[0] == 0 and is_even(times, fit.people.rate)
            write_film(temporary / overlay_name(index), pictures, fit.people.rate, None if even else times)
            done += len(times)
    return report


def camera_names(films: Sequence[str | Path]) -> list[str]:
    """Names of films' cameras: the names of the files, or numbers if two files have one name."""
    names = [Path(film).stem for film in films]
    return names if len(set(names)) == len(names) else [f"camera{index}" for index in range(len(names))]


def overlay_name(film: int) -> str:
    """Name of the file with a film and the bodies over it; ``film`` is the film's index."""
    return OVERLAY if film == 0 else f"overlay{film}.mp4"


def draw_film(fit: FilmFit, film: str | Path, index: int = 0, *, bare: bool = False) -> Iterator[np.ndarray]:
    """Frames of a film with the bodies over them, at most 960 px a side: RGB, (H, W, 3), uint8.

    If the film was matched with others, only the frames that were matched are drawn. Distortion is removed.

    Args:
        fit: Fit of the films.
        film: File of the film.
        index: Index of the film in the fit.
        bare: True draws the skin alone. By default people wear a plain T-shirt and shorts.
    """
    observed = fit.films[index]
    zoom, size = overlay_size(observed.people.image_size, _SIDE)
    view, posed = zoomed_view(observed.view, zoom, size), PosedMotions(fit.motions)
    frame_of = {number: frame for frame, number in enumerate(observed.file_numbers.tolist()) if number >= 0}
    read = islice(read_frames(film, size=size), max(frame_of) + 1)
    matched = ((frame_of[each.index], each.picture) for each in read if each.index in frame_of)
    for frame, picture in made_ahead((frame, resized(each, size, observed.lens)) for frame, each in matched):
        yield draw_bodies(picture, posed.at(frame), fit.motions, view, pale=posed.pale_at(frame), bare=bare)


def _view(name: str, film: ObservedFilm) -> dict[str, Any]:
    camera, lens = film.view.camera, {}
    networks = GivenNetworks() if film.given is None else film.given.networks
    sources = {"keypoints": networks.keypoints_from, "parts": networks.parts_from}
    if film.lens is not None:
        lens = {"lens": {"focal": list(film.lens.focal), "distortion": list(film.lens.distortion)}}
    return {
        "film": name,
        **{source: PACKAGED if network is None else network.name for source, network in sources.items()},
        "skipped_frames": film.skipped,
        **({} if film.numbers is None else {"film_frames": film.numbers.tolist()}),
        "size": list(film.people.image_size[::-1]),
        "focal": rounded(camera.focal[0, 0], 2),
        "principal": rounded(camera.centre[0], 2),
        **({"guessed": True} if isinstance(camera, UsualLens) else {}),
        "rotation": rounded(film.view.rotation, 6),
        "translation": rounded(film.view.translation, 4),
        **lens,
    }


def _with_progress(pictures: Iterable[np.ndarray], done: int, total: int, progress: Progress) -> Iterator[np.ndarray]:
    """Pictures of a film, with ``progress`` called for each; ``done`` pictures of other films came before."""
    for number, picture in enumerate(pictures, start=done + 1):
        progress("drawing", number, max(total, number))
        yield picture


def _make_actor(fit: FilmFit, person: int, motion: Motion) -> tuple[np.ndarray, Actor]:
    """Rows of ``FilmBodies`` for a person, and the motion frame by frame; in frames without a pose, the body waits."""
    rows, lowest = _rows(fit, person, motion)
    first, last = motion.frames[[0, -1]]
    every = np.searchsorted(motion.frames, np.arange(first, last + 1), side="right") - 1
    rate = fit.people.rate
    times = np.append(fit.times, fit.times[-1] + 1 / rate)
    if is_even(fit.times, rate):  # exact times, which containers round
        times = np.arange(len(times)) / rate
    poses = Poses(motion.rotations[every], motion.translation[every], times[first : last + 1], rate, lowest)
    return rows, Actor(f"person{person}", motion.bodies(slice(0, 1)), poses, float(times[last + 1]))


def _save_motion(
    fit: FilmFit, person: int, rows: np.ndarray, actor: Actor, folder: Path, formats: Sequence[str], bare: bool
) -> dict[str, Any]:
    """Write a person's files, and return the person's entry in the report."""
    motion, name = fit.motions[person], actor.name
    numbers = {"shape": motion.shape.values, "rotations": motion.rotations, "translation": motion.translation}
    FilmBodies(rows, fit.people.image_size, True).save(
        folder / f"{name}.npz",
        detailed_model=np.array(motion.model.name),
        clothes=motion.shape.clothes.cpu().numpy(),
        **{f"detailed_{key}": value.cpu().numpy() for key, value in numbers.items()},
        **({} if motion.confidence is None else confidence_arrays(motion.confidence)),
    )
    poses = actor.poses.since(float(actor.poses.times[0]))
    (folder / f"{name}.glb").write_bytes(glb(actor.body, poses, bare=bare))
    (folder / f"{name}.bvh").write_text(bvh(actor.body, poses))
    further = save_further(actor.body if bare else in_suit(actor.body), folder / name, formats, poses)
    found = _rows_by_film(fit, person)
    return {
        "person": person,
        "files": [*(f"{name}.{ending}" for ending in ("npz", "glb", "bvh")), *further],
        "score": round(float(np.concatenate([each["scores"] for each in found]).mean()), 3),
        "first_frame": int(motion.frames[0]),
        "last_frame": int(motion.frames[-1]),
        "first_time": round(float(fit.times[motion.frames[0]]), 6),
        "last_time": round(float(fit.times[motion.frames[-1]]), 6),
        "shot": next(number for number, shot in enumerate(fit.shots) if motion.frames[0] in shot),
        "frames_seen": len(np.unique(np.concatenate([each["frames"] for each in found]))),
        **({} if motion.confidence is None else motion_confidence_record(motion.frames, motion.confidence)),
        "distance_m": round(float(rows["translation"][:, 2].mean()), 2),
        "lengths_cm": dict(zip(LENGTH_NAMES, _centimetres(rows["lengths"][0]), strict=True)),
        "clothes_cm": dict(zip(CLOTHED, _centimetres(motion.shape.clothes.cpu().numpy()), strict=True)),
    }


def _rows_by_film(fit: FilmFit, person: int) -> list[np.ndarray]:
    """Rows of the frames in which a person was found, film by film."""
    return [fit.rows(person, film) for film in range(len(fit.films))]


def _rows(fit: FilmFit, person: int, motion: Motion) -> tuple[np.ndarray, float]:
    """Rows of ``FilmBodies`` for a person, and the lowest y of any vertex in any frame, y up [m]."""
    rows, lowest = np.zeros(len(motion.frames), ROW), np.inf
    rows["frames"], rows["times"] = motion.frames, fit.times[motion.frames]
    found = fit.rows(person)
    at = np.searchsorted(motion.frames, found["frames"])
    for name in SEEN:
        rows[name][at] = found[name]
    rows["camera_scale"], rows["camera_translation"] = fit.camera.focal[0, 0], fit.camera.centre[0]
    for start in range(0, len(rows), _CHUNK):
        some = slice(start, start + _CHUNK)
        bodies = motion.bodies(some)
        lowest = min(lowest, -float(bodies.detailed.vertices[..., 1].max()))
        names = "global_orient", "translation", "rotations", "lengths", "thicknesses"
        for name, values in zip(names, measure_ellipbody(bodies), strict=True):
            rows[name][some] = values.cpu().numpy()
    return rows, lowest


def _with_names(warning: str, films: Sequence[str | Path]) -> str:
    """Replace films[0], films[1] and so on in a warning by the names of the files."""
    for index, film in enumerate(films):
        warning = warning.replace(f"films[{index}]", str(film))
    return warning


def _shot(shot: range, times: np.ndarray) -> dict[str, Any]:
    """Frames and times of a shot, for the report."""
    first, last = shot[0], shot[-1]
    return {
        "first_frame": first,
        "last_frame": last,
        "start": round(float(times[first]), 4),
        "end": round(float(times[last]), 4),
    }


def _cut_warnings(fit: FilmFit, films: Sequence[str | Path]) -> list[str]:
    """Warnings about films with cuts."""
    warnings: list[str] = []
    common = {shot.start for shot in fit.shots}
    for film, observed in zip(films, fit.films, strict=True):
        cuts, times = list(observed.people.cuts), observed.people.times
        if not cuts:
            continue
        sentence = f"{film}: {cuts_sentence(cuts, times[cuts])}"
        if common.issuperset(cuts):
            warnings.append(f"{sentence}, each fitted apart, its people numbered anew")
        else:
            still = "expected films of cameras that stand still, frame by frame"
            warnings.append(f"{sentence}, which not all films have, so that cameras and moments may not fit; {still}")
    return warnings


def _centimetres(metres: np.ndarray) -> list[float]:
    centimetres: list[float] = rounded(100 * metres.astype(np.float64), 1)
    return centimetres
