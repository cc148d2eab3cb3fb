"""The files of films' people: a motion each, and the films with their bodies over them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from ..body.template import LENGTH_NAMES
from ..cameras import UsualLens
from ..errors import InputError, check_type
from ..inputs.camera_files import camera_data
from ..inputs.cuts import cuts_sentence
from ..inputs.films import read_frames
from ..inputs.frame_times import is_even
from ..interop.ahead import made_ahead
from ..interop.torch_threads import one_torch_thread
from ..models.clothes import CLOTHED
from ..models.measuring import measure_ellipbody
from ..networks.detection.film_people import SEEN
from ..networks.predictors.film_predictions import GivenNetworks
from ..pipelines.film import FilmFit, Motion
from ..pipelines.observed_film import ObservedFilm
from ..pipelines.photo import PACKAGED
from ..solve.ellipsoids.stages import Progress
from .film_file import write_film
from .film_overlays import PosedMotions, draw_bodies, resized, zoomed_view
from .further_files import check_formats, save_further
from .overlays import shown_at
from .predictions import ROW, FilmBodies
from .result_sets import PEOPLE_REPORT, replacing
from .scene_file import Actor, NamedView, scene_glb
from .skinned_files import Poses, bvh, glb

OVERLAY, SCENE, CAMERAS = "overlay.mp4", "scene.glb", "cameras.json"
_CHUNK = 64  # frames whose meshes are in memory at a time, to measure
_SIDE = 960  # [px], longer side of the film that shows the bodies


@one_torch_thread()
def save_film_fit(
    fit: FilmFit,
    folder: str | Path,
    *,
    films: Sequence[str | Path],
    formats: Sequence[str] = (),
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Write overlay.mp4, people.json, scene.glb, and of each person N personN.npz, personN.glb and personN.bvh.

    ``personN.npz`` is as ``predictions`` has it, with ``detailed_model`` (), ``detailed_shape`` (S,),
    ``detailed_rotations`` (T, J, 3, 3) and ``detailed_translation`` (T, 3) [m], and ``clothes`` (8,) [m]; its
    EllipBodies are measured from these. All is in the world, of one film its camera's frame; keypoints and camera are
    the first film's. GLB, BVH and USD hold motions of a person from its first frame on, standing on y = 0,
    ``scene.glb`` of everybody when and where they are, with the cameras. Overlays, GLB and USD have the frames' own
    times, BVH and FBX, which know one rate alone, the rate of most of the film, between whose frames joints turn the
    shortest way. Further films have overlay1.mp4 and so on, and all of them cameras.json, which ``read_cameras`` reads.
    ``people.json`` has the rate of most of the film, and under ``times`` those of all frames [s].
    ``people.json`` has the cameras under ``views``: X_camera = rotation X_world + translation, in pixels without
    distortion, ``lens``, the distortion that was taken away (k1, k2, p1, p2, k3, ...), ``skipped_frames`` (left out at
    the start), ``film_frames`` (of films that were matched: each frame's number in the file, -1 for none), and the
    names of the networks that saw ``keypoints`` and ``parts``.

    Args:
        fit: Of ``fit_film``.
        folder: Made if it is not there.
        films: The files, as in the fit.
        formats: Of ``FURTHER``, for more files of each motion.
        progress: Told the stage, frames done and in all.

    Returns:
        The report, which is ``people.json``.

    Raises:
        InputError: If the film can't be read any more, there are more or fewer, or results can't be written.
        TypeError: If ``fit`` is none.
    """
    check_type("fit", fit, FilmFit, "of fit_film")
    if len(films) != len(fit.films):
        raise InputError(f"films: {len(films)} files; expected {len(fit.films)}, those of the fit")
    check_formats("formats", formats)
    tell = progress or (lambda name, done, total: None)
    told = [warning for seen in fit.films for warning in seen.people.warnings]
    told += [f"{seen.people.fault}; frames before were fitted" for seen in fit.films if seen.people.fault]
    told += [_with_names(warning, films) for warning in fit.warnings]
    told += _cuts(fit, films)
    report: dict[str, Any] = {"rate": fit.people.rate, "frames": len(fit.times), "warnings": told, "people": []}
    report["times"] = fit.times.round(6).tolist()
    report["shots"] = [_shot(shot, fit.times) for shot in fit.shots]
    report["views"] = [_view(Path(film).name, seen) for film, seen in zip(films, fit.films, strict=True)]
    with replacing(Path(folder), PEOPLE_REPORT, report, outdates=(PEOPLE_REPORT,)) as temporary:
        actors: list[Actor] = []
        for place, (person, motion) in enumerate(fit.motions.items()):
            tell("writing motions", place, len(fit.motions))
            rows, actor = _acted(fit, person, motion)
            actors.append(actor)
            by = [each["film"] for each, own in zip(report["views"], _seen(fit, person), strict=True) if len(own)]
            report["people"].append({**_save_motion(fit, person, rows, actor, temporary, formats), "seen_by": by})
        names = camera_names(films)
        views = [
            NamedView(name, seen.view, seen.people.image_size) for name, seen in zip(names, fit.films, strict=True)
        ]
        (temporary / SCENE).write_bytes(scene_glb(actors, views))
        if len(films) > 1:
            data = camera_data(dict(zip(names, (seen.camera for seen in fit.films), strict=True)))
            (temporary / CAMERAS).write_text(json.dumps(data, indent=1))
        total, done = sum(int((seen.file_numbers >= 0).sum()) for seen in fit.films), 0
        for place, film in enumerate(films):
            pictures = made_ahead(draw_film(fit, film, place))
            shown = (_told(picture, done + row, total, tell) for row, picture in enumerate(pictures))
            seen = fit.films[place]
            times = fit.times[: len(seen.file_numbers)][seen.file_numbers >= 0]
            even = times[0] == 0 and is_even(times, fit.people.rate)
            write_film(temporary / overlay_name(place), shown, fit.people.rate, None if even else times)
            done += len(times)
    return report


def camera_names(films: Sequence[str | Path]) -> list[str]:
    """Names of films' cameras: the files', or numbers where two are alike."""
    names = [Path(film).stem for film in films]
    return names if len(set(names)) == len(names) else [f"camera{place}" for place in range(len(names))]


def overlay_name(film: int) -> str:
    """File of a film with the bodies over it."""
    return OVERLAY if film == 0 else f"overlay{film}.mp4"


def draw_film(fit: FilmFit, film: str | Path, place: int = 0) -> Iterator[np.ndarray]:
    """Frames of a film with the bodies over them, at most 960 px a side: RGB, (H, W, 3), uint8.

    Of a film that was matched with others, only the frames that were.

    Args:
        fit: The fit.
        film: The file.
        place: Of the film in the fit. Distortion of its lens is taken away.
    """
    seen = fit.films[place]
    zoom, size = shown_at(seen.people.image_size, _SIDE)
    view, posed = zoomed_view(seen.view, zoom, size), PosedMotions(fit.motions)
    places = {number: place for place, number in enumerate(seen.file_numbers.tolist()) if number >= 0}
    frames = islice(read_frames(film, size=size), max(places) + 1)
    shown = ((places[frame.index], frame.picture) for frame in frames if frame.index in places)
    for index, picture in made_ahead((index, resized(each, size, seen.lens)) for index, each in shown):
        yield draw_bodies(picture, posed.at(index), fit.motions, view)


def _view(name: str, seen: ObservedFilm) -> dict[str, Any]:
    camera, lens = seen.view.camera, {}
    networks = GivenNetworks() if seen.given is None else seen.given.networks
    sources = {"keypoints": networks.keypoints_from, "parts": networks.parts_from}
    if seen.lens is not None:
        lens = {"lens": {"focal": list(seen.lens.focal), "distortion": list(seen.lens.distortion)}}
    return {
        "film": name,
        **{kind: PACKAGED if network is None else network.name for kind, network in sources.items()},
        "skipped_frames": seen.skipped,
        **({} if seen.numbers is None else {"film_frames": seen.numbers.tolist()}),
        "size": list(seen.people.image_size[::-1]),
        "focal": float(camera.focal[0, 0]),
        "principal": camera.centre[0].tolist(),
        **({"guessed": True} if isinstance(camera, UsualLens) else {}),
        "rotation": seen.view.rotation.tolist(),
        "translation": seen.view.translation.tolist(),
        **lens,
    }


def _told(picture: np.ndarray, number: int, total: int, tell: Progress) -> np.ndarray:
    tell("drawing", number + 1, max(total, number + 1))
    return picture


def _acted(fit: FilmFit, person: int, motion: Motion) -> tuple[np.ndarray, Actor]:
    """Rows of ``FilmBodies`` of a person, and the motion frame by frame: where no window had one, the body waits."""
    rows, lowest = _rows(fit, person, motion)
    first, last = motion.frames[[0, -1]]
    every = np.searchsorted(motion.frames, np.arange(first, last + 1), side="right") - 1
    rate = fit.people.rate
    times = np.append(fit.times, fit.times[-1] + 1 / rate)
    if is_even(fit.times, rate):  # without what containers round
        times = np.arange(len(times)) / rate
    poses = Poses(motion.rotations[every], motion.translation[every], times[first : last + 1], rate, lowest)
    return rows, Actor(f"person{person}", motion.bodies(slice(0, 1)), poses, float(times[last + 1]))


def _save_motion(
    fit: FilmFit, person: int, rows: np.ndarray, actor: Actor, folder: Path, formats: Sequence[str]
) -> dict[str, Any]:
    """Files of a person, and what the report says."""
    motion, name = fit.motions[person], actor.name
    numbers = {"shape": motion.shape.values, "rotations": motion.rotations, "translation": motion.translation}
    FilmBodies(rows, fit.people.image_size, True).save(
        folder / f"{name}.npz",
        detailed_model=np.array(motion.model.name),
        clothes=motion.shape.clothes.cpu().numpy(),
        **{f"detailed_{key}": value.cpu().numpy() for key, value in numbers.items()},
    )
    poses = actor.poses.since(float(actor.poses.times[0]))
    (folder / f"{name}.glb").write_bytes(glb(actor.body, poses))
    (folder / f"{name}.bvh").write_text(bvh(actor.body, poses))
    further = save_further(actor.body, folder / name, formats, poses)
    seen = _seen(fit, person)
    return {
        "person": person,
        "files": [*(f"{name}.{kind}" for kind in ("npz", "glb", "bvh")), *further],
        "score": round(float(np.concatenate([each["scores"] for each in seen]).mean()), 3),
        "first_frame": int(motion.frames[0]),
        "last_frame": int(motion.frames[-1]),
        "first_time": round(float(fit.times[motion.frames[0]]), 6),
        "last_time": round(float(fit.times[motion.frames[-1]]), 6),
        "shot": next(number for number, shot in enumerate(fit.shots) if motion.frames[0] in shot),
        "frames_seen": len(np.unique(np.concatenate([each["frames"] for each in seen]))),
        "distance_m": round(float(rows["translation"][:, 2].mean()), 2),
        "lengths_cm": dict(zip(LENGTH_NAMES, _centimetres(rows["lengths"][0]), strict=True)),
        "clothes_cm": dict(zip(CLOTHED, _centimetres(motion.shape.clothes.cpu().numpy()), strict=True)),
    }


def _seen(fit: FilmFit, person: int) -> list[np.ndarray]:
    """Rows of a person, film by film."""
    return [fit.rows(person, film) for film in range(len(fit.films))]


def _rows(fit: FilmFit, person: int, motion: Motion) -> tuple[np.ndarray, float]:
    """Rows of ``FilmBodies``, and the y of the lowest vertex of all frames, y up [m]."""
    rows, lowest = np.zeros(len(motion.frames), ROW), np.inf
    rows["frames"], rows["times"] = motion.frames, fit.times[motion.frames]
    seen = fit.rows(person)
    at = np.searchsorted(motion.frames, seen["frames"])
    for name in SEEN:
        rows[name][at] = seen[name]
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
    """A warning about films[1] and so on that names the files."""
    for place, film in enumerate(films):
        warning = warning.replace(f"films[{place}]", str(film))
    return warning


def _shot(shot: range, times: np.ndarray) -> dict[str, Any]:
    """Frames and times of a shot, as the report has them."""
    first, last = shot[0], shot[-1]
    return {
        "first_frame": first,
        "last_frame": last,
        "start": round(float(times[first]), 4),
        "end": round(float(times[last]), 4),
    }


def _cuts(fit: FilmFit, films: Sequence[str | Path]) -> list[str]:
    """Warnings of films with cuts."""
    found: list[str] = []
    common = {shot.start for shot in fit.shots}
    for film, seen in zip(films, fit.films, strict=True):
        cuts, times = list(seen.people.cuts), seen.people.times
        if not cuts:
            continue
        told = f"{film}: {cuts_sentence(cuts, times[cuts])}"
        if common.issuperset(cuts):
            found.append(f"{told}, each fitted apart, its people numbered anew")
        else:
            still = "expected films of cameras that stand still, frame by frame"
            found.append(f"{told}, which not all films have, so that cameras and moments may not fit; {still}")
    return found


def _centimetres(metres: np.ndarray) -> list[float]:
    return (100 * metres.astype(np.float64)).round(2).tolist()
