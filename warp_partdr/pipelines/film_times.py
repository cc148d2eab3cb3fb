"""Time offsets between films that did not start together.

The angles of joints look the same from all sides. So the poses that the network predicts from two films agree where
their frames show the same instant. Then the rays through keypoints of single frames give the offset to the frame
(``camera_poses``).
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
from .film_cameras import choose_frames, observe_frames, person_in_films
from .matched_times import match_films, nearest_frames
from .observed_film import ObservedFilm
from .same_people import check_each_film

_RATE = 10.0  # observations per second in the first search
_SHARED = 0.5  # least time that two films have in common, as a share of the shorter film
_FEWEST = 5  # least number of observations that two films have in common
_ALIKE = 0.5  # correlation of two people's poses, below which the motions belong to two people
_TRIES = 4  # offsets at which rays are compared, of the offsets with the most similar poses


def align_films(
    films: Sequence[ObservedFilm], *, device: torch.device | str = "cpu", progress: Progress | None = None
) -> list[ObservedFilm]:
    """Matches films frame by frame that did not start at the same time.

    Frames that a film shows before the others started are left out. The result is that of ``match_films`` with
    ``film_starts``.

    Args:
        films: Two or more films with any frame rates. The first one is compared with each other one.
        device: Device to run on, "cpu" or a CUDA device.
        progress: Function that is called with (stage name, films done, all films).

    Raises:
        InputError: If no person of the first film moves like one of another film, for half of the shorter film.
        TypeError: If an argument has another type.

    Examples:
        With ``early`` and ``late``, ``ObservedFilm`` of somebody who moves; ``late`` began six frames after ``early``:

        >>> from warp_partdr import align_films
        >>> aligned = align_films([early, late])
        >>> [film.skipped for film in aligned]
        [6, 0]
    """
    return match_films(films, film_starts(films, device=device, progress=progress))


def film_starts(
    films: Sequence[ObservedFilm], *, device: torch.device | str = "cpu", progress: Progress | None = None
) -> list[float]:
    """Finds the time at which each film shows the first instant that all films show, since its first frame [s].

    The arguments and errors are those of ``align_films``.
    """
    check_each_film(films)
    report = progress or (lambda name, done, total: None)
    offsets = [0]
    for index in range(1, len(films)):
        report("alignment", index, len(films))
        pair = _with_even_times(films[0], films[0]), _with_even_times(films[index], films[0])
        offsets.append(_offset(pair, index, device))
    report("alignment", len(films), len(films))
    first = -min(offsets)
    return [(first + offset) / films[0].people.rate for offset in offsets]


def _with_even_times(film: ObservedFilm, other: ObservedFilm) -> ObservedFilm:
    """Returns a copy whose frames are evenly spaced, at the usual frame rate of another film."""
    rate = other.people.rate
    times = film.people.times
    if is_even(times, rate):
        return film
    wanted = np.arange(round(float(times[-1]) * rate) + 1) / rate
    return film.taken(nearest_frames(times, wanted, 0.5 / rate), wanted)


def _offset(films: tuple[ObservedFilm, ObservedFilm], index: int, device: torch.device | str) -> int:
    """Number of frames by which the second film shows an instant later than the first film.

    Args:
        films: Two films whose frames are evenly spaced.
        index: Index of the second film among all films, for messages.
        device: Device to run on.
    """
    step = max(round(films[0].people.rate / _RATE), 1)
    frames = [np.arange(0, len(film.people.times), step) for film in films]
    observed = observe_frames(films, frames, device)
    poses = {track: _poses(observed_bodies, step) for track, observed_bodies in observed.items()}
    shared = max(_SHARED * min(len(film.people.times) for film in films) / step, _FEWEST)
    first = [track for track in observed if track[0] == 0]
    second = [track for track in observed if track[0] == 1]
    peaks = sorted(
        (-likeness, offset * step, one, other)
        for one, other in product(first, second)
        for offset, likeness in _peaks(poses[one], poses[other], shared)
    )
    tried = [
        (_energies(films, (one[1], other[1]), offset, range(1), device)[0], offset, (one[1], other[1]))
        for _, offset, one, other in peaks[:_TRIES]
    ]
    if not tried:
        raise InputError(
            f"films[{index}]: nobody of the first film moves in the same way in both for long enough; expected films "
            "that were taken at the same time"
        )
    _, rough, tracks = min(tried)
    energies = _energies(films, tracks, rough, range(-step, step + 1), device)
    return rough + min(energies, key=energies.__getitem__)


def _poses(observed_bodies: Sequence[ObservedBody], step: int) -> np.ndarray:
    """Landmarks along the pelvis' axes in every ``step``-th frame [m], shape (T, 3 L). NaN without an observation."""
    rows = [observed.frame // step for observed in observed_bodies]
    poses = np.full((max(rows) + 1, 3 * len(LANDMARKS)), np.nan)
    for row, observed in zip(rows, observed_bodies, strict=True):
        landmarks = posed_landmarks(observed.body.posed(), LANDMARKS) @ observed.body.global_orient()
        poses[row] = landmarks.double().cpu().numpy().ravel()
    return poses


def _peaks(one: np.ndarray, other: np.ndarray, shared: float) -> list[tuple[int, float]]:
    """Offsets at which two people's poses correlate more than just before and after, with the correlations.

    Means over time are subtracted, because the network's errors differ between views.

    Args:
        one: Poses of a person, shape (T, 3 L).
        other: Poses of another person.
        shared: Least number of observations that both have at an offset.
    """
    alike: dict[int, float] = {}
    for offset in range(1 - len(one), len(other)):
        start = max(0, -offset)
        stop = min(len(one), len(other) - offset)
        own = one[start:stop]
        theirs = other[start + offset : stop + offset]
        both = np.isfinite(own[:, 0] + theirs[:, 0])
        if both.sum() >= shared:
            first = _centred(own[both])
            second = _centred(theirs[both])
            size = np.sqrt(np.square(first).sum() * np.square(second).sum())
            alike[offset] = float((first * second).sum() / max(size, 1e-12))
    return [
        (offset, likeness)
        for offset, likeness in alike.items()
        if likeness >= max(_ALIKE, alike.get(offset - 1, 0.0), alike.get(offset + 1, 0.0))
    ]


def _centred(poses: np.ndarray) -> np.ndarray:
    """Poses (T, 3 L) less their mean over time."""
    return poses - poses.mean(0)


def _energies(
    films: tuple[ObservedFilm, ObservedFilm],
    tracks: tuple[int, int],
    rough: int,
    moves: range,
    device: torch.device | str,
) -> dict[int, float]:
    """Energies after two films are placed by a person, for each move of a rough offset [frames]."""
    first = films[0].people.of(tracks[0])["frames"]
    second = films[1].people.of(tracks[1])["frames"]
    frames = choose_frames(first[np.isin(first + rough, second)])
    later_frames = np.unique([frames + rough + move for move in moves])
    observed = observe_frames(films, [frames, later_frames], device)
    later = {each.frame: each for each in observed[1, tracks[1]]}
    energies = {}
    for move in moves:
        own: list[ObservedBody] = []
        theirs: list[ObservedBody] = []
        for each in observed[0, tracks[0]]:
            same_time = later.get(each.frame + rough + move)
            if same_time is not None:
                own.append(each)
                theirs.append(replace(same_time, source=replace(same_time.source, frame=each.frame)))
        if own:
            people = person_in_films(films, [own, theirs])
            energies[move] = people.refined(people.chained()).energy
    return energies
