"""Warnings of a fit to several films, of which cameras may be others, or stand elsewhere than is said."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations, product

from .same_people import Track, meeting
from .seen_film import SeenFilm

_STATURES = (0.5, 2.6)  # [m], of people
_FARTHEST = 100.0  # [m], of people from the cameras of their films
_MOST_OFF = 0.08  # median distance of one person's rays over trunk, thigh and shin together; real films had up to 0.034
_ASKED = "are translations in metres, is each film of its camera, and do the films show the same moments?"


def unmatched_films(films: Sequence[SeenFilm], people: Iterable[Sequence[Track]]) -> list[str]:
    """Warnings of films whose people no other film shows.

    Args:
        films: Of the same moments.
        people: Tracks of each person.
    """
    shared = [tracks for tracks in people if len({film for film, _ in tracks}) > 1]
    showing = [place for place, film in enumerate(films) if film.people.num_people]
    if len(showing) > 1 and not shared:
        return [f"films: nobody is seen by two cameras at once, for no two people's rays meet; {_ASKED}"]
    matched = {film for tracks in shared for film, _ in tracks}
    return [
        f"films[{place}]: shows nobody whom another film shows, for rays do not meet; {_ASKED}"
        for place in showing
        if place not in matched and any(_compared(films[place], films[other]) for other in matched)
    ]


def missing_rays(films: Sequence[SeenFilm], people: Mapping[int, Sequence[Track]]) -> list[str]:
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
                    f"{met.distance:.2f} m; expected {_MOST_OFF * met.size:.2f} m at most: {_ASKED}"
                )
    return found


def _compared(one: SeenFilm, other: SeenFilm) -> bool:
    """True if two films show people at once, whoever they are."""
    pairs = product(range(one.people.num_people), range(other.people.num_people))
    return any(meeting(one, one.people.of(mine), other, other.people.of(theirs)).compared for mine, theirs in pairs)


def impossible_people(statures: dict[int, float], distances: dict[int, float]) -> list[str]:
    """Warnings of people who are too small, too tall or too far away.

    Args:
        statures: Heights standing, by person [m].
        distances: From the farthest camera [m], by person.
    """
    found: list[str] = []
    for person, stature in statures.items():
        if not _STATURES[0] <= stature <= _STATURES[1]:
            least, most = _STATURES
            found.append(f"person{person} is {stature:.2f} m tall; expected {least:g} to {most:g} m: {_ASKED}")
        elif not distances[person] <= _FARTHEST:
            far = f"person{person} is {distances[person]:.0f} m away from a camera"
            found.append(f"{far}; expected {_FARTHEST:g} m at most: {_ASKED}")
    return found
