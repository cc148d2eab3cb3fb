"""The files of a film's people: a motion each, and the film with their bodies over it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from ..body.template import LENGTH_NAMES
from ..clothing.clothes import CLOTHED
from ..clothing.measuring import measure_ellipbody
from ..detection.film_people import SEEN
from ..errors import check_type
from ..fit.fitting import Progress
from ..inputs.films import read_frames
from ..interop.torch_threads import one_torch_thread
from ..scenes.film import FilmFit, Motion
from ..scenes.scene import View
from .film_file import write_film
from .film_pictures import PosedMotions, draw_bodies, resized, zoomed_view
from .predictions import ROW, FilmBodies
from .result_sets import PEOPLE_REPORT, replacing
from .save import shown_at
from .skinned_files import Poses, bvh, glb

OVERLAY = "overlay.mp4"
_CHUNK = 64  # frames whose meshes are in memory at a time, to measure
_SIDE = 960  # [px], longer side of the film that shows the bodies


@one_torch_thread()
def save_film_fit(
    fit: FilmFit, folder: str | Path, *, film: str | Path, progress: Progress | None = None
) -> dict[str, Any]:
    """Write overlay.mp4 and people.json, and of each person N personN.npz, personN.glb and personN.bvh.

    ``personN.npz`` is as ``predictions`` has it, with ``detailed_model`` (), ``detailed_shape`` (S,), in the camera
    frame ``detailed_rotations`` (T, J, 3, 3) and ``detailed_translation`` (T, 3) [m], and ``clothes`` (8,) [m]; its
    EllipBodies are measured from these. GLB and BVH hold the motion at the film's rate.

    Args:
        fit: Of ``fit_film``.
        folder: Made if it is not there.
        film: The file.
        progress: Told the stage, frames done and in all.

    Returns:
        The report, which is ``people.json``.

    Raises:
        InputError: If the film can't be read any more, or results can't be written.
        TypeError: If ``fit`` is none.
    """
    check_type("fit", fit, FilmFit, "of fit_film")
    tell = progress or (lambda name, done, total: None)
    report: dict[str, Any] = {"rate": fit.people.rate, "frames": len(fit.people.times), "people": []}
    report |= {"warnings": [fit.people.fault] if fit.people.fault else []}
    with replacing(Path(folder), PEOPLE_REPORT, report, outdates=(PEOPLE_REPORT,)) as temporary:
        for place, (person, motion) in enumerate(fit.motions.items()):
            tell("writing motions", place, len(fit.motions))
            report["people"].append(_save_motion(fit, person, motion, temporary))
        total = len(fit.people.times)
        shown = (_told(picture, number, total, tell) for number, picture in enumerate(draw_film(fit, film)))
        write_film(temporary / OVERLAY, shown, fit.people.rate)
    return report


def draw_film(fit: FilmFit, film: str | Path) -> Iterator[np.ndarray]:
    """Frames of the film with the bodies over them, at most 960 px a side: RGB, (H, W, 3), uint8."""
    zoom, size = shown_at(fit.people.image_size, _SIDE)
    view, posed = zoomed_view(View(fit.camera), zoom, size), PosedMotions(fit.motions)
    for frame in islice(read_frames(film), len(fit.people.times)):
        yield draw_bodies(resized(frame.picture, size), posed.at(frame.index), fit.motions, view)


def _told(picture: np.ndarray, number: int, total: int, tell: Progress) -> np.ndarray:
    tell("drawing", number + 1, max(total, number + 1))
    return picture


def _save_motion(fit: FilmFit, person: int, motion: Motion, folder: Path) -> dict[str, Any]:
    """Files of a person, and what the report says."""
    rows, lowest = _rows(fit, person, motion)
    name = f"person{person}"
    numbers = {"shape": motion.shape.values, "rotations": motion.rotations, "translation": motion.translation}
    FilmBodies(rows, fit.people.image_size, True).save(
        folder / f"{name}.npz",
        detailed_model=np.array(motion.model.name),
        clothes=motion.shape.clothes.cpu().numpy(),
        **{f"detailed_{key}": value.cpu().numpy() for key, value in numbers.items()},
    )
    # Files of even time: in frames that no window had, the body waits.
    even = np.searchsorted(motion.frames, np.arange(motion.frames[0], motion.frames[-1] + 1), side="right") - 1
    poses = Poses(motion.rotations[even], motion.translation[even], fit.people.rate, lowest)
    first = motion.bodies(slice(0, 1))
    (folder / f"{name}.glb").write_bytes(glb(first, poses))
    (folder / f"{name}.bvh").write_text(bvh(first, poses))
    seen = fit.people.of(person)
    return {
        "person": person,
        "files": [f"{name}.{kind}" for kind in ("npz", "glb", "bvh")],
        "score": round(float(seen["scores"].mean()), 3),
        "first_frame": int(motion.frames[0]),
        "last_frame": int(motion.frames[-1]),
        "frames_seen": len(seen),
        "distance_m": round(float(rows["translation"][:, 2].mean()), 2),
        "lengths_cm": dict(zip(LENGTH_NAMES, _centimetres(rows["lengths"][0]), strict=True)),
        "clothes_cm": dict(zip(CLOTHED, _centimetres(motion.shape.clothes.cpu().numpy()), strict=True)),
    }


def _rows(fit: FilmFit, person: int, motion: Motion) -> tuple[np.ndarray, float]:
    """Rows of ``FilmBodies``, and the y of the lowest vertex of all frames, y up [m]."""
    rows, lowest = np.zeros(len(motion.frames), ROW), np.inf
    rows["frames"], rows["times"] = motion.frames, fit.people.times[motion.frames]
    seen = fit.people.of(person)
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


def _centimetres(metres: np.ndarray) -> list[float]:
    return (100 * metres.astype(np.float64)).round(2).tolist()
