"""Matching of films frame by frame, when their clocks or frame rates differ."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import InputError
from ..inputs.frame_times import is_even
from .observed_film import ObservedFilm

_NEAR = 0.5 + 1e-6  # largest time between matched frames, in usual frame intervals of the first film


def match_films(films: Sequence[ObservedFilm], starts: Sequence[float] | None = None) -> list[ObservedFilm]:
    """Matches films frame by frame: each frame of the first film gets the nearest frame of each other film.

    A frame is used at most once, and only within half a frame interval of the first film. If a film has no such frame,
    it shows nobody at that time. After the end of the first film, the times are those of the films that go on.

    Args:
        films: Films with any frame rates, even variable ones.
        starts: Time at which each film shows the first common instant, since its first frame [s]. If it is None, films
            started together.

    Raises:
        InputError: If a film has no frame at any of the times.

    Examples:
        >>> from warp_partdr import ObservedFilm, find_film_people, match_films
        >>> left = right = ObservedFilm.of(find_film_people("walk.mp4"))  # of two cameras that started together
        >>> [len(film.people.times) for film in match_films([left, right])]
        [3, 3]
    """
    if starts is None and not _first_mismatch(films):
        return list(films)
    near = _NEAR / films[0].people.rate
    clocks = [film.people.times - start for film, start in zip(films, starts or [0.0] * len(films), strict=True)]
    times = clocks[0][clocks[0] > -near]
    if not len(times):
        raise InputError("films[0]: ends before another one starts; expected films that were taken at the same time")
    clocks = [clock - times[0] for clock in clocks]
    times = times - times[0]
    for clock in clocks[1:]:
        times = np.concatenate([times, clock[clock > times[-1] + near]])
    matched: list[ObservedFilm] = []
    for index, (film, clock) in enumerate(zip(films, clocks, strict=True)):
        frames = nearest_frames(clock, times, near)
        if not (frames >= 0).any():
            raise InputError(
                f"films[{index}]: no frame when the first film has one; expected films that were taken at the same time"
            )
        matched.append(film.taken(frames, times))
    return matched


def nearest_frames(times: np.ndarray, wanted: np.ndarray, near: float) -> np.ndarray:
    """Finds the frame that is nearest to each wanted time. Each frame is used at most once.

    Args:
        times: Times of the frames, rising [s], shape (F,).
        wanted: Times for which frames are wanted, rising [s], shape (T,).
        near: Largest time between a frame and the wanted time [s].

    Returns:
        Indices of the frames, -1 where none is near, shape (T,), int64.
    """
    frames = _nearest(times, wanted)
    shown = (np.abs(times[frames] - wanted) <= near) & (_nearest(wanted, times)[frames] == np.arange(len(wanted)))
    return np.where(shown, frames, -1)


def check_matched(films: Sequence[ObservedFilm]) -> None:
    """Raises an InputError if frames with the same index have different times in films."""
    if mismatch := _first_mismatch(films):
        raise InputError(f"{mismatch}; expected films that are matched frame by frame, as match_films returns them")


def shared_times(films: Sequence[ObservedFilm]) -> np.ndarray:
    """Times of the frames of matched films [s]: those of the longest film, shape (F,)."""
    return max((film.people.times for film in films), key=len)


def uneven_times(films: Sequence[ObservedFilm], frames: range) -> np.ndarray | None:
    """Times of some frames since the first of them [s]. None if frames are evenly spaced, at the first film's rate."""
    times = shared_times(films)
    if is_even(times, films[0].people.rate):
        return None
    return times[frames.start : frames.stop] - times[frames.start]


def _first_mismatch(films: Sequence[ObservedFilm]) -> str:
    """Describes the first frame whose time is not that of the longest film. It is empty if all films match."""
    times = shared_times(films)
    near = _NEAR / films[0].people.rate
    for index, film in enumerate(films):
        off = np.abs(film.people.times - times[: len(film.people.times)])
        if (off > near).any():
            first = int((off > near).argmax())
            return f"films[{index}]: frame {first} is {off[first]:.3f} s from that of another film"
    return ""


def _nearest(values: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Indices of the values that are nearest to wanted ones. The values rise."""
    after = np.searchsorted(values, wanted).clip(1, max(len(values) - 1, 1))
    before = after - 1
    after = after.clip(max=len(values) - 1)
    return np.where(values[after] - wanted < wanted - values[before], after, before)
