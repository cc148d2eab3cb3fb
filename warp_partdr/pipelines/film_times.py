"""PeopleInViews of films that did not start together: which frame of one is which of the other.

How joints are bent looks the same from everywhere, so two films' poses, as the network sees them, match where their
frames show one moment. Then rays through keypoints of single frames say it to the frame (``camera_places``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
import torch

from ..errors import InputError
from ..inputs.frame_times import is_even
from ..networks.regression.landmarks import LANDMARKS
from ..networks.regression.predicted import posed_landmarks
from ..solve.ellipsoids.stages import Progress
from ..solve.mesh.observed_body import ObservedBody
from .film_cameras import observe_frames, person_in_films, spread
from .matched_times import match_films, nearest_frames
from .observed_film import ObservedFilm
from .same_people import check_each_film

_RATE = 10.0  # looks a second, at first
_SHARED = 0.5  # of the shorter film that two have in common, at least
_FEWEST = 5  # looks in common, at least
_ALIKE = 0.5  # correlation of two people's poses, below which it is not one person's motion
_TRIES = 4  # offsets at which rays are compared, of those at which poses are most alike


def align_films(
    films: Sequence[ObservedFilm], *, device: torch.device | str = "cpu", progress: Progress | None = None
) -> list[ObservedFilm]:
    """Leave out the first frames of films of which others started later: the same films, frame by frame.

    They are as of ``match_films``, with ``film_starts``.

    Args:
        films: Two or more, of any rates; the first one is compared with each other.
        device: "cpu" or a CUDA device.
        progress: Called with (stage name, films done, films in all).

    Raises:
        InputError: If no person of the first film moves as one of another does, for half of the shorter film.
        TypeError: If an argument is of another type.
    """
    return match_films(films, film_starts(films, device=device, progress=progress))


def film_starts(
    films: Sequence[ObservedFilm], *, device: torch.device | str = "cpu", progress: Progress | None = None
) -> list[float]:
    """Time at which each film shows the first moment that all of them show, since its first frame [s].

    The arguments and errors are those of ``align_films``.
    """
    check_each_film(films)
    tell = progress or (lambda name, done, total: None)
    later = [0]
    for place in range(1, len(films)):
        tell("moments", place, len(films))
        later.append(_offset((_even(films[0], films[0]), _even(films[place], films[0])), place, device))
    tell("moments", len(films), len(films))
    first = -min(later)
    return [(first + offset) / films[0].people.rate for offset in later]


def _even(film: ObservedFilm, other: ObservedFilm) -> ObservedFilm:
    """The film in even time, in which frames come as often as in most of another film."""
    rate, times = other.people.rate, film.people.times
    if is_even(times, rate):
        return film
    moments = np.arange(round(float(times[-1]) * rate) + 1) / rate
    return film.taken(nearest_frames(times, moments, 0.5 / rate), moments)


def _offset(films: tuple[ObservedFilm, ObservedFilm], place: int, device: torch.device | str) -> int:
    """Number of frames by which the second film shows a moment later, of films in even time."""
    step = max(round(films[0].people.rate / _RATE), 1)
    observed_bodies = observe_frames(films, [np.arange(0, len(film.people.times), step) for film in films], device)
    poses = {track: _poses(seen, step) for track, seen in observed_bodies.items()}
    shared = max(_SHARED * min(len(film.people.times) for film in films) / step, _FEWEST)
    alike = sorted(
        (-likeness, offset * step, one, other)
        for one, other in product(*([track for track in observed_bodies if track[0] == film] for film in (0, 1)))
        for offset, likeness in _peaks(poses[one], poses[other], shared)
    )
    tried = [
        (_energies(films, (one[1], other[1]), offset, range(1), device)[0], offset, (one[1], other[1]))
        for _, offset, one, other in alike[:_TRIES]
    ]
    if not tried:
        told = "moves in the same way in both for long enough; expected films of the same moments"
        raise InputError(f"films[{place}]: nobody of the first film {told}")
    _, rough, tracks = min(tried)
    energies = _energies(films, tracks, rough, range(-step, step + 1), device)
    return rough + min(energies, key=energies.__getitem__)


def _poses(observed_bodies: Sequence[ObservedBody], step: int) -> np.ndarray:
    """Landmarks in the pelvis' own axes [m], of every ``step``-th frame, NaN where there is no look, shape (T, 3 L)."""
    places = [observed.frame // step for observed in observed_bodies]
    poses = np.full((max(places) + 1, 3 * len(LANDMARKS)), np.nan)
    for place, observed in zip(places, observed_bodies, strict=True):
        marks = posed_landmarks(observed.body.posed(), LANDMARKS) @ observed.body.global_orient()
        poses[place] = marks.double().cpu().numpy().ravel()
    return poses


def _peaks(one: np.ndarray, other: np.ndarray, shared: float) -> list[tuple[int, float]]:
    """Offsets at which two people's poses correlate more than just before and after, and how much.

    Of offsets with so many looks in common. Means are taken off, for views differ in what they see amiss.
    """
    alike: dict[int, float] = {}
    for offset in range(1 - len(one), len(other)):
        start, stop = max(0, -offset), min(len(one), len(other) - offset)
        pair = one[start:stop], other[start + offset : stop + offset]
        both = np.isfinite(pair[0][:, 0] + pair[1][:, 0])
        if both.sum() >= shared:
            first, second = (each[both] - each[both].mean(0) for each in pair)
            size = np.sqrt(np.square(first).sum() * np.square(second).sum())
            alike[offset] = float((first * second).sum() / max(size, 1e-12))
    return [
        (offset, likeness)
        for offset, likeness in alike.items()
        if likeness >= max(_ALIKE, alike.get(offset - 1, 0.0), alike.get(offset + 1, 0.0))
    ]


def _energies(
    films: tuple[ObservedFilm, ObservedFilm],
    tracks: tuple[int, int],
    rough: int,
    moves: range,
    device: torch.device | str,
) -> dict[int, float]:
    """Energies that are left where a person's rays meet, at a rough offset moved by so many frames."""
    there, seen = (film.people.of(track)["frames"] for film, track in zip(films, tracks, strict=True))
    frames = spread(there[np.isin(there + rough, seen)])
    observed_bodies = observe_frames(films, [frames, np.unique([frames + rough + move for move in moves])], device)
    one, other = (
        {observed.frame: observed for observed in observed_bodies[film, track]} for film, track in enumerate(tracks)
    )
    energies = {}
    for move in moves:
        pairs = [(observed, other.get(frame + rough + move)) for frame, observed in one.items()]
        both = [
            (observed, replace(later, source=replace(later.source, frame=observed.frame)))
            for observed, later in pairs
            if later
        ]
        if both:
            moments = person_in_films(films, list(zip(*both, strict=True)))
            energies[move] = moments.refined(moments.chained()).energy
    return energies
