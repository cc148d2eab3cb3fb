"""Assignment of films to calibrated cameras by their names, by the numbers in them, or by their order."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import InputError

# A number after one of these words is a camera's.
_CAMERA_WORDS = frozenset(
    "cam camera cams cameras camara caméra kamera c k v view port dev device gopro gp kinect sensor channel ch".split()
)
_CASE_CHANGE = re.compile(r"(?<=[a-zß-ÿ])(?=[A-Z])")
_TOKENS = re.compile(r"\d+|[^\W\d_]+")
_LONGEST = 18  # digits that are compared as a number

Token = str | int


@dataclass(frozen=True)
class Assignment:
    """Camera of each film.

    Attributes:
        cameras: Places of the cameras, film by film.
        by_order: True if the names tell nothing, so that only the order of films and cameras is left.
    """

    cameras: tuple[int, ...]
    by_order: bool = False


def assign_cameras(films: Sequence[str | Path], cameras: Sequence[str]) -> Assignment:
    """Assign films to cameras.

    Names count first: a film's is a camera's, or one is part of the other ("cam10_sync" and "cam10", "cam01" and
    "int_cam01_img"). Then the number that tells the films apart ("view-03" and "camera3"). Only where names have
    nothing in common, films and cameras are paired in order, films of a shell's ``*`` in natural order (2 before 10).

    Raises:
        InputError: If names contradict one another or fit several cameras, or numbers of films and cameras differ.
    """
    names = film_names(films)
    found = _by_name(names, cameras)
    if found is None:
        found = _by_number(names, cameras)
    if found is not None:
        return Assignment(found)
    order = _film_order(names)
    named = _named(names, cameras)
    if len(names) != len(cameras) or any(mine and order.index(film) not in mine for film, mine in enumerate(named)):
        raise _contradiction(names, cameras, "by name, or as many in order")
    return Assignment(tuple(order.index(film) for film in range(len(names))), by_order=True)


def film_names(films: Sequence[str | Path]) -> list[str]:
    """Names of films without their endings; with their folders' where several are alike."""
    names = [Path(film).stem for film in films]
    if len(set(names)) < len(names):
        names = [f"{Path(film).parent.name}/{name}" for film, name in zip(films, names, strict=True)]
    return names


def _contradiction(films: Sequence[str], cameras: Sequence[str], how: str) -> InputError:
    return InputError(f"cameras {', '.join(cameras)}; expected one a film: {', '.join(films)}, {how}")


def _tokens(name: str) -> tuple[Token, ...]:
    """Words and numbers of a name: ("cam", 1) of "Cam_01"."""
    words = _TOKENS.findall(_CASE_CHANGE.sub(" ", name))
    return tuple(int(word) if word.isdecimal() and len(word) <= _LONGEST else word.casefold() for word in words)


def _holds(whole: tuple[Token, ...], part: tuple[Token, ...]) -> bool:
    """True if one name is a part of another; a number alone is no name."""
    if not part or (len(part) == 1 and isinstance(part[0], int)):
        return False
    return any(whole[start : start + len(part)] == part for start in range(len(whole) - len(part) + 1))


def _named(films: Sequence[str], cameras: Sequence[str]) -> list[set[int]]:
    """Cameras whose names fit each film's best: those that are equal, or have most words in common."""
    found: list[set[int]] = []
    theirs = [_tokens(camera) for camera in cameras]
    for film in films:
        if film in cameras:
            found.append({cameras.index(film)})
            continue
        mine = _tokens(film)
        lengths = {
            place: min(len(mine), len(other))
            for place, other in enumerate(theirs)
            if mine == other or _holds(mine, other) or _holds(other, mine)
        }
        longest = max(lengths.values(), default=0)
        found.append({place for place, length in lengths.items() if length == longest})
    return found


def _by_name(films: Sequence[str], cameras: Sequence[str]) -> tuple[int, ...] | None:
    found = [next(iter(each)) for each in _named(films, cameras) if len(each) == 1]
    return tuple(found) if len(set(found)) == len(films) else None


def _by_number(films: Sequence[str], cameras: Sequence[str]) -> tuple[int, ...] | None:
    """Cameras of the films' numbers; None if the names hold no number that tells them apart, or none in common.

    Raises:
        InputError: If numbers contradict one another, or fit in several ways.
    """
    mine, theirs = _numbers(films), _numbers(cameras)
    fits = {
        tuple(other.values.index(number) for number in one.values)
        for one in mine
        for other in theirs
        if set(one.values) <= set(other.values)
    }
    if len(fits) > 1:
        raise _contradiction(films, cameras, "by numbers that fit in one way")
    if fits:
        return fits.pop()
    for one in mine:
        for other in theirs:
            if set(one.values) & set(other.values) or (one.of_cameras and other.of_cameras):
                raise _contradiction(films, cameras, "by the same numbers")
    return None


@dataclass(frozen=True)
class _Numbers:
    """Numbers that tell names apart, and whether the names say that they are cameras' numbers."""

    values: tuple[int, ...]
    of_cameras: bool


def _numbers(names: Sequence[str]) -> list[_Numbers]:
    """Numbers at each place of names where all have another one; cameras' numbers alone if some are."""
    tokens = [_tokens(name) for name in names]
    numbers = [[place for place, token in enumerate(each) if isinstance(token, int)] for each in tokens]
    places: list[list[int]] = []
    if len({len(each) for each in numbers}) == 1:  # the first, second, ... number of each
        places += [list(each) for each in zip(*numbers, strict=True)]
    elif all(numbers):
        places.append([each[-1] for each in numbers])
    after = [[place for place in each if _is_camera_s(mine, place)] for mine, each in zip(tokens, numbers, strict=True)]
    if all(len(each) == 1 for each in after):
        places.append([each[0] for each in after])
    found: list[_Numbers] = []
    for each in places:
        values = [mine[place] for mine, place in zip(tokens, each, strict=True)]
        of_cameras = all(_is_camera_s(mine, place) for mine, place in zip(tokens, each, strict=True))
        # A single name's number tells it from nothing, unless it is said to be a camera's.
        if len(set(values)) == len(names) and (of_cameras or len(names) > 1):
            found.append(_Numbers(tuple(int(value) for value in values), of_cameras))
    return [each for each in found if each.of_cameras] or found


def _is_camera_s(tokens: tuple[Token, ...], place: int) -> bool:
    """True if the number at this place follows a word for cameras, or is the whole name."""
    return len(tokens) == 1 or (place > 0 and tokens[place - 1] in _CAMERA_WORDS)


def _film_order(films: Sequence[str]) -> list[int]:
    """Places of films in the order that pairs them with cameras: as given, but naturally where a shell sorted them."""
    given = list(range(len(films)))
    if list(films) != sorted(films):
        return given
    return sorted(given, key=lambda film: natural_key(films[film]))


def natural_key(name: str) -> tuple[tuple[int, int, str], ...]:
    """Key that sorts names as people do: 2 before 10."""
    return tuple((0, token, "") if isinstance(token, int) else (1, 0, token) for token in _tokens(name))
