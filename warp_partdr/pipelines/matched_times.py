"""Films of one scene by different clocks: which frames of them show one moment."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import InputError
from ..inputs.frame_times import is_even
from .observed_film import ObservedFilm

_NEAR = 0.5 + 1e-6  # of the first film's usual step, that frames of one moment may be apart


def match_films(films: Sequence[ObservedFilm], starts: Sequence[float] | None = None) -> list[ObservedFilm]:
    """Films frame by frame: in each moment of the first film the frame of each other that is nearest in time.

    A frame serves once, and lies within half a step of the first film; a film that has none there shows nobody in that
    moment. PeopleInViews after the end of the first film are those of the films that go on.

    Args:
        films: Of any rates, also variable ones.
        starts: When each film shows the first moment, since its first frame [s]; None: they started together.

    Raises:
        InputError: If a film shows none of the moments.
    """
    if starts is None and not _unmatched(films):
        return list(films)
    near = _NEAR / films[0].people.rate
    clocks = [film.people.times - start for film, start in zip(films, starts or [0.0] * len(films), strict=True)]
    moments = clocks[0][clocks[0] > -near]
    if not len(moments):
        raise InputError("films[0]: ends before another one starts; expected films of the same moments")
    clocks = [clock - moments[0] for clock in clocks]
    moments = moments - moments[0]
    for clock in clocks[1:]:
        moments = np.concatenate([moments, clock[clock > moments[-1] + near]])
    matched: list[ObservedFilm] = []
    for place, (film, clock) in enumerate(zip(films, clocks, strict=True)):
        frames = nearest_frames(clock, moments, near)
        if not (frames >= 0).any():
            raise InputError(
                f"films[{place}]: no frame when the first film has one; expected films of the same moments"
            )
        matched.append(film.taken(frames, moments))
    return matched


def nearest_frames(times: np.ndarray, moments: np.ndarray, near: float) -> np.ndarray:
    """Numbers of the frames that show moments, each at most once; -1 where none is near.

    Args:
        times: Of the frames, rising [s], shape (F,).
        moments: Rising, too [s], shape (T,).
        near: How far a frame may be from its moment [s].
    """
    frames = _nearest(times, moments)
    shown = (np.abs(times[frames] - moments) <= near) & (_nearest(moments, times)[frames] == np.arange(len(moments)))
    return np.where(shown, frames, -1)


def check_matched(films: Sequence[ObservedFilm]) -> None:
    """Raise an InputError if frames of one number show different moments in films."""
    if told := _unmatched(films):
        raise InputError(f"{told}; expected films of one clock, as match_films gives them")


def shared_times(films: Sequence[ObservedFilm]) -> np.ndarray:
    """Times of the frames of films that are matched [s]: the longest one's, shape (F,)."""
    return max((film.people.times for film in films), key=len)


def uneven_times(films: Sequence[ObservedFilm], frames: range) -> np.ndarray | None:
    """Times of some frames since the first of them [s]; None: they come evenly, at the first film's rate."""
    times = shared_times(films)
    if is_even(times, films[0].people.rate):
        return None
    return times[frames.start : frames.stop] - times[frames.start]


def _unmatched(films: Sequence[ObservedFilm]) -> str:
    """The first film whose frames are not those of the longest one, and where; empty if there is none."""
    moments, near = shared_times(films), _NEAR / films[0].people.rate
    for place, film in enumerate(films):
        off = np.abs(film.people.times - moments[: len(film.people.times)])
        if (off > near).any():
            first = int((off > near).argmax())
            return f"films[{place}]: frame {first} is {off[first]:.3f} s from that of another film"
    return ""


def _nearest(values: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Places of those values, rising, that are nearest to wanted ones."""
    after = np.searchsorted(values, wanted).clip(1, max(len(values) - 1, 1))
    before = after - 1
    after = after.clip(max=len(values) - 1)
    return np.where(values[after] - wanted < wanted - values[before], after, before)
