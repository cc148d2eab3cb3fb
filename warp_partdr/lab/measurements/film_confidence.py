"""Confidence in the bodies of films against their true errors: one person before calibrated cameras, with 3D truth.

Each film is fitted alone with a usual lens, as `partdr fit FILM` does, and then all films together with their cameras.
A body is right if its shoulders, elbows, wrists, hips, knees and ankles lie, on average, within 10 cm of the truth in
depth and within 10 cm across the picture, after a move that brings their mean to the truth. Frames that follow one
another are no independent samples.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch

from ...body.skeletons import BODY_LANDMARKS
from ...errors import InputError
from ...inputs.camera_files import read_cameras
from ...networks.detection.film_people import find_film_people
from ...pipelines.film import FilmFit, fit_film
from ...pipelines.matched_times import match_films
from ...pipelines.observed_film import ObservedFilm
from ..evaluation.datasets.trajectories import read_trajectories
from ..evaluation.datasets.views import Views
from ..options import Device
from ..photo_truth import depth_and_across
from ..tables import FigureTable
from .confidence import RIGHT, area_under_curve


def measure_film_confidence(
    path: Path, /, *, cameras: Path, films: Path, device: Device = "cpu"
) -> Iterator[FigureTable | str]:
    """Compare stated confidence with the truth, frame by frame.

    Args:
        path: Joints over time, as `partdr evaluate real` takes them.
        cameras: File of calibrated cameras.
        films: Folder of the films of these cameras.
        device: Device of the fits.
    """
    views = read_trajectories(path, cameras, films=films)
    assert views.film is not None
    paths = dict.fromkeys(views.film.tolist())
    people = {film: find_film_people(film, device=device) for film in paths}
    table = FigureTable(
        "frames of films",
        {
            "film": "",
            "frames": "d",
            "error, median [mm]": ".0f",
            "confidence, mean": ".2f",
            "right": ".2f",
            "AUC": ".2f",
            "rank correlation": ".2f",
        },
    )
    everything: list[np.ndarray] = []
    for film in paths:
        everything.append(stated_and_true(fit_film([ObservedFilm.of(people[film])], device=device), views, film))
        table.add(Path(film).name, *figures(everything[-1]))
    table.add("all, each alone", *figures(np.concatenate(everything, axis=1)))
    known = read_cameras(cameras).values()
    observed = [ObservedFilm.calibrated(each, camera) for each, camera in zip(people.values(), known, strict=True)]
    together = fit_film(match_films(observed), device=device)
    table.add("all together", *figures(stated_and_true(together, views, next(iter(paths)))))
    yield table


def stated_and_true(fit: FilmFit, views: Views, film: str) -> np.ndarray:
    """Confidence in the person whose joints are known, and errors, in the frames of the fit's first film, shape (2, N).

    An error is the larger one of the mean errors in depth and across the picture [m].

    Args:
        fit: Fit of the film, or of several of which it is the first.
        views: True joints, which the film's person is nearest to.
        film: Name of the film in ``views``.

    Raises:
        InputError: If no frame has both a body and known joints.
    """
    assert views.film is not None
    assert views.film_frame is not None
    own = views.film == film
    names = list(views.joint_names)
    columns = [names.index(name) for name in BODY_LANDMARKS]
    true = dict(zip(views.film_frame[own].tolist(), views.joints_camera[own][:, columns], strict=True))
    points = dict(zip(views.film_frame[own].tolist(), views.keypoints[own][:, columns], strict=True))
    found: list[tuple[float, np.ndarray]] = []
    for motion in fit.motions.values():
        assert motion.confidence is not None
        rows = [row for row in np.flatnonzero(motion.confidence.known) if int(motion.frames[row]) in true]
        if not rows:
            continue
        frames = motion.frames[rows].tolist()
        with torch.no_grad():
            bodies = motion.bodies(np.array(rows)).detailed
            joints = fit.films[0].view.to_camera(motion.model.landmarks(bodies, BODY_LANDMARKS)).cpu()
            pixels = fit.camera.project(joints)[..., :2].numpy()
        away = np.nanmean(np.linalg.norm(pixels - np.stack([points[frame] for frame in frames]), axis=-1))
        depth, across = depth_and_across(joints.numpy() - np.stack([true[frame] for frame in frames]))
        found.append((float(away), np.stack([motion.confidence.bodies[rows], np.maximum(depth, across)])))
    if not found:
        raise InputError(f"{film}: no frame with a body and known joints; expected the person whose joints are known")
    return min(found, key=lambda each: each[0])[1]


def figures(rows: np.ndarray) -> tuple[int, float, float, float, float, float]:
    """Figures of a row of the table, from confidence and errors, shape (2, N)."""
    stated, errors = rows
    right = errors < RIGHT
    ranks = [each.argsort().argsort() for each in rows]
    return (
        len(stated),
        1000 * float(np.median(errors)),
        float(stated.mean()),
        float(right.mean()),
        area_under_curve(stated, right),
        float(np.corrcoef(*ranks)[0, 1]),
    )
