"""Warnings of a fit to several films, of which cameras may be others, or stand elsewhere than is said."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations, product

from ..solve.scene.impossible import ASKED
from .observed_film import ObservedFilm
from .same_people import Track, meeting

_MOST_OFF = 0.08  # median distance of one person's rays over trunk, thigh and shin together; real films had up to 0.034


def unmatched_films(films: Sequence[ObservedFilm], people: Iterable[Sequence[Track]]) -> list[str]:
    """Warnings of films whose people no other film shows.

    Args:
        films: Of the same moments.
        people: Tracks of each person.
    """
    shared = [tracks for tracks in people if len({film for film, _ in tracks}) > 1]
    showing = [place for place, film in enumerate(films) if film.people.num_people]
    if len(showing) > 1 and not shared:
        return [f"films: nobody is seen by two cameras at once, for no two people's rays meet; {ASKED}"]
    matched = {film for tracks in shared for film, _ in tracks}
    return [
        f"films[{place}]: shows nobody whom another film shows, for rays do not meet; {ASKED}"
        for place in showing
        if place not in matched and any(_compared(films[place], films[other]) for other in matched)
    ]


def missing_rays(films: Sequence[ObservedFilm], people: Mapping[int, Sequence[Track]]) -> list[str]:
    """Warnings of calibrated cameras before which one person's rays miss one another.

    Args:
        films: Of the same moments.
        people: Tracks by person.
    """
    found: list[str] = []
    for person, tracks in people.items():
        for one, other in combinations(tracks, 2):
            seen = films[one[0]], films[other[0]]
            if one[0] == other[0] or not all(film.by_calibration for film in seen):
                continue
            met = meeting(seen[0], seen[0].people.of(one[1]), seen[1], seen[1].people.of(other[1]))
            if met.distance > _MOST_OFF * met.size:  # never of a size that is NaN
                found.append(
                    f"person{person}: rays of films[{one[0]}] and films[{other[0]}] miss one another by "
                    f"{met.distance:.2f} m; expected {_MOST_OFF * met.size:.2f} m at most: {ASKED}"
                )
    return found


def _compared(one: ObservedFilm, other: ObservedFilm) -> bool:
    """True if two films show people at once, whoever they are."""
    pairs = product(range(one.people.num_people), range(other.people.num_people))
    return any(meeting(one, one.people.of(mine), other, other.people.of(theirs)).compared for mine, theirs in pairs)
