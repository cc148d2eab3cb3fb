"""Warnings about several films whose cameras do not fit them: wrong files, other positions, or other times."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations

from ..solve.scene.impossible import ASKED
from .observed_film import ObservedFilm
from .same_people import Track, meeting

# Largest median distance of one person's rays, over the length of trunk, thigh and shin together. Real films had up to
# 0.034.
_MOST_OFF = 0.08


def unmatched_films(films: Sequence[ObservedFilm], people: Iterable[Sequence[Track]]) -> list[str]:
    """Warnings about films whose people are in no other film.

    Args:
        films: Films that are matched frame by frame.
        people: Tracks of each person.
    """
    shared = [tracks for tracks in people if len({film for film, _ in tracks}) > 1]
    showing = [index for index, film in enumerate(films) if film.people.num_people]
    if len(showing) > 1 and not shared:
        return [f"films: nobody is seen by two cameras at once, because no two people's rays meet; {ASKED}"]
    matched = {film for tracks in shared for film, _ in tracks}
    return [
        f"films[{index}]: shows nobody whom another film shows, because rays do not meet; {ASKED}"
        for index in showing
        if index not in matched and any(_can_be_compared(films[index], films[other]) for other in matched)
    ]


def distant_rays(films: Sequence[ObservedFilm], people: Mapping[int, Sequence[Track]]) -> list[str]:
    """Warnings about calibrated cameras for which one person's rays miss one another.

    Args:
        films: Films that are matched frame by frame.
        people: Tracks by the index of the person.
    """
    found: list[str] = []
    for person, tracks in people.items():
        for one, other in combinations(tracks, 2):
            first = films[one[0]]
            second = films[other[0]]
            if one[0] == other[0] or not (first.by_calibration and second.by_calibration):
                continue
            met = meeting(first, first.people.of(one[1]), second, second.people.of(other[1]))
            if met.distance > _MOST_OFF * met.size:  # False if the size is NaN
                found.append(
                    f"person{person}: rays of films[{one[0]}] and films[{other[0]}] miss one another by "
                    f"{met.distance:.2f} m; expected {_MOST_OFF * met.size:.2f} m at most: {ASKED}"
                )
    return found


def _can_be_compared(one: ObservedFilm, other: ObservedFilm) -> bool:
    """True if two films show any people at the same time."""
    for first in range(one.people.num_people):
        for second in range(other.people.num_people):
            if meeting(one, one.people.of(first), other, other.people.of(second)).compared:
                return True
    return False
