"""Places of films' cameras that nobody calibrated: who is who in the films, and from where each was taken.

Without cameras nothing says who is whom, without people nothing places cameras. So two films are placed by each likely
pair of their people, and the pair stands whose rays meet best.
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
from .camera_places import PeopleInViews, RelativePoses, place_cameras
from .matched_times import uneven_times
from .observed_film import ObservedFilm
from .photo import check_stature_owner, person_index
from .same_people import Track, check_films, match_people

FRAMES = 32  # of the films, that are looked at, at most
_PEOPLE = 4  # of a film, the largest ones, who are looked at
_TRIES = 3  # pairs of two films' people whose rays are compared, of those whose poses are most alike
_ENOUGH = 0.5  # of the most moments that two have in common, that another pair must have

_Looks = Mapping[Track, Sequence[ObservedBody]]


def place_film_cameras(
    films: Sequence[ObservedFilm],
    *,
    stature: float | None = None,
    person: int | None = None,
    device: torch.device | str = "cpu",
    progress: Progress | None = None,
) -> list[ObservedFilm]:
    """Place the cameras of films of the same moments by the people in them: the same films, in the first one's world.

    Args:
        films: Two or more, frame by frame; lenses are known or assumed, as each film's view says.
        stature: Height of a person, standing [m]; None: as large as people seem.
        person: Whose it is, 0 = the most and largest seen, by whom alone cameras are placed then; may be left out where
            films have one in common.
        device: "cpu" or a CUDA device.
        progress: Called with (stage name, films done, films in all).

    Raises:
        InputError: If nobody is seen by two cameras at once, or the stature is of several people.
        TypeError: If an argument is of another type.
    """
    check_films(films)
    stature = check_stature(stature)
    tell = progress or (lambda name, done, total: None)
    tell("cameras", 0, len(films))
    observed_bodies = _look(films, device)
    between = cache(lambda one, other: _beside(films, observed_bodies, one, other))
    views = {0: films[0].view}
    while len(views) < len(films):
        tell("cameras", len(views), len(films))
        pairs = [(one, other) for one in views for other in range(len(films)) if other not in views]
        one, other = min(pairs, key=lambda pair: between(*pair).energy)
        places = between(one, other)
        if math.isinf(places.energy):
            raise InputError(f"films[{other}]: shows nobody when another film does; expected films of the same moments")
        views[other] = places.views_of([views[one], films[other].view])[1]
    placed = [film.standing(views[place].rotation, views[place].translation) for place, film in enumerate(films)]
    placed = _by_all(placed, observed_bodies, stature, person)
    tell("cameras", len(films), len(films))
    return placed


def _look(films: Sequence[ObservedFilm], device: torch.device | str) -> _Looks:
    """Looks at the largest people of films, in frames in which several films show somebody."""
    frames, counts = np.unique(
        np.concatenate([np.unique(film.people.rows["frames"]) for film in films]), return_counts=True
    )
    return observe_frames(films, [spread(frames[counts > 1])] * len(films), device)


def spread(frames: np.ndarray) -> np.ndarray:
    """Choose the frames to look at, ``FRAMES`` at most, evenly."""
    places = np.linspace(0, max(len(frames) - 1, 0), FRAMES).round().astype(int)
    return frames[np.unique(places)[: len(frames)]]


def observe_frames(
    films: Sequence[ObservedFilm], frames: Sequence[np.ndarray], device: torch.device | str
) -> dict[Track, list[ObservedBody]]:
    """Looks at the largest people of films, in these frames of each."""
    tracks: list[Track] = []
    observations: list[SceneObservation] = []
    for place, (film, chosen) in enumerate(zip(films, frames, strict=True)):
        sizes = [float(areas(film.people.of(track)["boxes"]).sum()) for track in range(film.people.num_people)]
        for track in np.argsort(sizes)[::-1][:_PEOPLE].tolist():
            rows = film.people.of(track)
            own = list(film.observations(rows[np.isin(rows["frames"], chosen)], 0, place))
            tracks += [(place, track)] * len(own)
            observations += own
    together = observation_batch_size(device)
    batches = [observations[start : start + together] for start in range(0, len(observations), together)]
    found: dict[Track, list[ObservedBody]] = {}
    seen = chain.from_iterable(observe_batches([film.small_view for film in films], batches, device))
    for track, observed in zip(tracks, seen, strict=True):
        found.setdefault(track, []).append(observed)
    return found


def _beside(films: Sequence[ObservedFilm], observed_bodies: _Looks, one: int, other: int) -> RelativePoses:
    """Two films placed by the pair of their people whose rays meet best; of infinite energy if there is none."""
    mine, theirs = ([seen for (film, _), seen in observed_bodies.items() if film == place] for place in (one, other))
    pairs = [person_in_films((films[one], films[other]), each) for each in product(mine, theirs)]
    most = max((pair.num_common for pair in pairs), default=0)
    likely = [pair for pair in pairs if pair.num_common >= max(_ENOUGH * most, 1)]
    starts = sorted(((pair, pair.chained()) for pair in likely), key=lambda each: each[0].unlike(each[1]))
    found = [pair.refined(start) for pair, start in starts[:_TRIES]]
    nowhere = RelativePoses(torch.zeros(0, 3, 3), torch.zeros(0, 3), math.inf)
    return min(found, key=lambda places: places.energy, default=nowhere)


def person_in_films(films: Sequence[ObservedFilm], seen: Sequence[Sequence[ObservedBody]]) -> PeopleInViews:
    """PeopleInViews of one person, who was looked at in each of the films."""
    observed_bodies = [
        replace(observed, source=replace(observed.source, view=view))
        for view, each in enumerate(seen)
        for observed in each
    ]
    return PeopleInViews.of(_scene(films, observed_bodies), observed_bodies)


def _scene(films: Sequence[ObservedFilm], observed_bodies: Sequence[ObservedBody]) -> Scene:
    views, observations = [film.small_view for film in films], [observed.source for observed in observed_bodies]
    times = uneven_times(films, range(1 + max(observation.frame for observation in observations)))
    return Scene(views, observations, films[0].people.rate, times=times)


def _by_all(
    films: Sequence[ObservedFilm], observed_bodies: _Looks, stature: float | None, person: int | None
) -> list[ObservedFilm]:
    """Films placed by all whom several of them show, who are told apart by where the films stand."""
    everyone = match_people(films)
    if stature is not None and person is not None:
        everyone = [everyone[person_index(person, len(everyone))]]
    people = [tracks for tracks in everyone if len({film for film, _ in tracks}) > 1]
    if not people:
        raise InputError("films: nobody is the same in two of them; expected films of the same moments, frame by frame")
    check_stature_owner(stature, len(people))
    if alone := set(range(len(films))) - {film for tracks in people for film, _ in tracks}:
        raise InputError(f"films[{min(alone)}]: nobody to place it by; expected somebody who is in another one, too")
    seen = [
        replace(observed, source=replace(observed.source, person=number))
        for number, tracks in enumerate(people)
        for track in tracks
        for observed in observed_bodies.get(track, ())
    ]
    views = place_cameras(_scene(films, seen), observed_bodies=seen, stature=stature).views
    return [film.standing(view.rotation, view.translation) for film, view in zip(films, views, strict=True)]
