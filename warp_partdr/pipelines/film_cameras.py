"""Poses of films' cameras that nobody calibrated.

To match people between films, the cameras must be known. To find the cameras, people must be matched. So two films are
placed by each likely pair of their people, and the pair whose rays meet best is taken.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import chain, product

import numpy as np
import torch

from ..body.stature import check_stature
from ..errors import InputError
from ..inputs.scene import Scene, SceneObservation
from ..networks.detection.film_people import areas
from ..solve.ellipsoids.stages import Progress
from ..solve.mesh.observed_body import ObservedBody
from ..solve.scene.observations import observation_batch_size, observe_batches
from .camera_poses import PeopleInViews, RelativePoses, place_cameras
from .matched_times import uneven_times
from .observed_film import ObservedFilm
from .photo import check_stature_owner, person_index
from .same_people import Track, check_films, match_people

FRAMES = 32  # largest number of frames of a film that are observed
_PEOPLE = 4  # number of people of a film that are observed, the largest ones
_TRIES = 3  # pairs of two films' people whose rays are compared, of the pairs with the most similar poses
_ENOUGH = 0.5  # common instants that a pair needs, as a share of the most that any pair has

_ObservedTracks = Mapping[Track, Sequence[ObservedBody]]


def place_film_cameras(
    films: Sequence[ObservedFilm],
    *,
    stature: float | None = None,
    person: int | None = None,
    device: torch.device | str = "cpu",
    progress: Progress | None = None,
) -> list[ObservedFilm]:
    """Finds the poses of films' cameras from the people in them.

    Args:
        films: Two or more films that are matched frame by frame. Their lenses are those of the films' views.
        stature: Height of a person, standing [m]. If it is None, the sizes that the network predicts are taken.
        person: Index of the person whose stature is given; 0 is the one seen most and largest. Only this person then
            places the cameras. It may be None if the films share only one person.
        device: Device to run on, "cpu" or a CUDA device.
        progress: Function that is called with (stage name, films done, all films).

    Returns:
        The films with new views, in the world of the first film.

    Raises:
        InputError: If nobody is visible in two films at once, or the stature is given for several people.
        TypeError: If an argument has another type.

    Examples:
        With ``left`` and ``right``, ``ObservedFilm`` of one person, matched frame by frame:

        >>> from warp_partdr import place_film_cameras
        >>> placed = place_film_cameras([left, right], stature=1.75)
        >>> placed[1].view.rotation.shape, placed[1].view.eye.shape  # where the second camera stands
        (torch.Size([3, 3]), torch.Size([3]))
    """
    check_films(films)
    stature = check_stature(stature)
    report = progress or (lambda name, done, total: None)
    report("cameras", 0, len(films))
    observed = _observe_shared_frames(films, device)
    pair_poses = cache(lambda one, other: _place_pair(films, observed, one, other))
    views = {0: films[0].view}
    while len(views) < len(films):
        report("cameras", len(views), len(films))
        pairs = [(one, other) for one in views for other in range(len(films)) if other not in views]
        one, other = min(pairs, key=lambda pair: pair_poses(*pair).energy)
        poses = pair_poses(one, other)
        if math.isinf(poses.energy):
            raise InputError(
                f"films[{other}]: shows nobody when another film does; expected films that were taken at the same time"
            )
        views[other] = poses.applied_to([views[one], films[other].view])[1]
    placed = [film.standing(views[index].rotation, views[index].translation) for index, film in enumerate(films)]
    placed = _place_by_all(placed, observed, stature, person)
    report("cameras", len(films), len(films))
    return placed


def _observe_shared_frames(films: Sequence[ObservedFilm], device: torch.device | str) -> _ObservedTracks:
    """Observes the largest people of films, in frames in which several films show somebody."""
    own_frames = [np.unique(film.people.rows["frames"]) for film in films]
    frames, counts = np.unique(np.concatenate(own_frames), return_counts=True)
    return observe_frames(films, [choose_frames(frames[counts > 1])] * len(films), device)


def choose_frames(frames: np.ndarray) -> np.ndarray:
    """Chooses the frames to observe, evenly and at most ``FRAMES``."""
    indices = np.linspace(0, max(len(frames) - 1, 0), FRAMES).round().astype(int)
    return frames[np.unique(indices)[: len(frames)]]


def observe_frames(
    films: Sequence[ObservedFilm], frames: Sequence[np.ndarray], device: torch.device | str
) -> dict[Track, list[ObservedBody]]:
    """Observes the largest people of films.

    Args:
        films: The films.
        frames: Indices of the frames to observe, for each film.
        device: Device to run on.

    Returns:
        Observed bodies of each track, whose views are the indices of the films.
    """
    tracks: list[Track] = []
    observations: list[SceneObservation] = []
    for index, (film, chosen) in enumerate(zip(films, frames, strict=True)):
        sizes = [float(areas(film.people.of(track)["boxes"]).sum()) for track in range(film.people.num_people)]
        for track in np.argsort(sizes)[::-1][:_PEOPLE].tolist():
            rows = film.people.of(track)
            own = list(film.observations(rows[np.isin(rows["frames"], chosen)], 0, index))
            tracks += [(index, track)] * len(own)
            observations += own
    size = observation_batch_size(device)
    batches = [observations[start : start + size] for start in range(0, len(observations), size)]
    found: dict[Track, list[ObservedBody]] = {}
    observed_bodies = chain.from_iterable(observe_batches([film.small_view for film in films], batches, device))
    for key, observed in zip(tracks, observed_bodies, strict=True):
        found.setdefault(key, []).append(observed)
    return found


def _place_pair(films: Sequence[ObservedFilm], observed: _ObservedTracks, one: int, other: int) -> RelativePoses:
    """Places two films by the pair of their people whose rays meet best. The energy is infinite if there is none."""
    first = [observed_bodies for (film, _), observed_bodies in observed.items() if film == one]
    second = [observed_bodies for (film, _), observed_bodies in observed.items() if film == other]
    pairs = [person_in_films((films[one], films[other]), pair) for pair in product(first, second)]
    most = max((pair.num_common for pair in pairs), default=0)
    likely = [pair for pair in pairs if pair.num_common >= max(_ENOUGH * most, 1)]
    starts = sorted(((pair, pair.chained()) for pair in likely), key=lambda each: each[0].pose_difference(each[1]))
    found = [pair.refined(start) for pair, start in starts[:_TRIES]]
    nowhere = RelativePoses(torch.zeros(0, 3, 3), torch.zeros(0, 3), math.inf)
    return min(found, key=lambda poses: poses.energy, default=nowhere)


def person_in_films(films: Sequence[ObservedFilm], observed_bodies: Sequence[Sequence[ObservedBody]]) -> PeopleInViews:
    """Collects the observed bodies of one person in each of the films."""
    joined = [
        replace(observed, source=replace(observed.source, view=view))
        for view, own in enumerate(observed_bodies)
        for observed in own
    ]
    return PeopleInViews.of(_scene(films, joined), joined)


def _scene(films: Sequence[ObservedFilm], observed_bodies: Sequence[ObservedBody]) -> Scene:
    """Scene of the observations, with the films' cameras and times."""
    views = [film.small_view for film in films]
    observations = [observed.source for observed in observed_bodies]
    times = uneven_times(films, range(1 + max(observation.frame for observation in observations)))
    return Scene(views, observations, films[0].people.rate, times=times)


def _place_by_all(
    films: Sequence[ObservedFilm], observed: _ObservedTracks, stature: float | None, person: int | None
) -> list[ObservedFilm]:
    """Places films by all people whom several films show. The films' present poses match the people."""
    everyone = match_people(films)
    if stature is not None and person is not None:
        everyone = [everyone[person_index(person, len(everyone))]]
    people = [tracks for tracks in everyone if len({film for film, _ in tracks}) > 1]
    if not people:
        raise InputError(
            "films: no person is in two of them; expected films that were taken at the same time, frame by frame"
        )
    check_stature_owner(stature, len(people))
    if alone := set(range(len(films))) - {film for tracks in people for film, _ in tracks}:
        raise InputError(
            f"films[{min(alone)}]: shows nobody by whom it can be placed; expected a person who is in another film, too"
        )
    observed_bodies = [
        replace(each, source=replace(each.source, person=index))
        for index, tracks in enumerate(people)
        for track in tracks
        for each in observed.get(track, ())
    ]
    scene = _scene(films, observed_bodies)
    views = place_cameras(scene, observed_bodies=observed_bodies, stature=stature).views
    return [film.standing(view.rotation, view.translation) for film, view in zip(films, views, strict=True)]
