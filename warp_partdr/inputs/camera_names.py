"""Assignment of films to calibrated cameras by names, by numbers, letters and sides in them, or by order."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import InputError

# A number, a letter or a side after one of these words is a camera's.
_CAMERA_WORDS = frozenset(
    (
        "cam camera cams cameras camara cámara caméra kamera webcam c k v view port dev device gopro gp kinect sensor "
        "channel ch"
    ).split()
)
_SHORT_WORDS = frozenset("c k v gp".split())
_DIGITS_OF_CLIPS = 4  # a number of at least this length after a short word counts a camera's clips: C0001, GP010045
_SIDES = {"left": "l", "right": "r"}
_GOPRO = re.compile("gopro", re.IGNORECASE)
_CASE_CHANGE = re.compile(r"(?<=[a-zß-ÿ])(?=[A-Z])")
_TOKENS = re.compile(r"\d+|[^\W\d_]+")
_LONGEST = 18  # digits that are compared as a number
_BY_NAME = "by name, or as many in order"

Token = str | int


@dataclass(frozen=True)
class Assignment:
    """Camera of each film.

    Attributes:
        cameras: Indices of the cameras, film by film.
        by_order: True if films and cameras are paired by their order, because no name says which belong together.
        by_number: True if they are paired by numbers or letters that follow no word for a camera. These may also be the
            numbers of takes or a date.
    """

    cameras: tuple[int, ...]
    by_order: bool = False
    by_number: bool = False


def assign_cameras(films: Sequence[str | Path], cameras: Sequence[str]) -> Assignment:
    """Assign films to cameras.

    The first rule that fits counts:

    1. A film and a camera have the same name, or one name is part of the other ("cam10_sync" and "cam10", "cam01" and
       "int_cam01_img").
    2. They have the same number, letter or side, and a word beside it says that it is a camera's ("view-03" and
       "camera3", "camB" and "Camera B", "right" and "cam_R").
    3. The names of the files' folders fit by rule 1 or 2.
    4. They have the same number or letter, and it differs from film to film.
    5. The names have nothing in common: films and cameras are paired in order. Films that a shell's ``*`` listed are
       in natural order (2 before 10).

    Raises:
        InputError: If names contradict one another or fit several cameras, or numbers of films and cameras differ.
    """
    levels = _levels(films)
    for names in levels:
        found = _by_name(names, cameras)
        if found is None:
            found = _by_mark(names, cameras, of_cameras=True)
        if found is not None:
            return Assignment(found)
    for names in levels:
        found = _by_mark(names, cameras, of_cameras=False)
        if found is not None:
            return Assignment(found, by_number=True)
    order = _film_order(films)
    for names in levels:
        named = _named(names, cameras)
        if any(mine and order.index(film) not in mine for film, mine in enumerate(named)):
            raise _contradiction(names, cameras, _BY_NAME)
    if len(films) != len(cameras):
        raise _contradiction(film_names(films), cameras, _BY_NAME)
    return Assignment(tuple(order.index(film) for film in range(len(films))), by_order=True)


def film_names(films: Sequence[str | Path]) -> list[str]:
    """Names of films without their endings; with the names of their folders if several films have one name."""
    names = [Path(film).stem for film in films]
    if len(set(names)) < len(names):
        names = [f"{Path(film).parent.name}/{name}" for film, name in zip(films, names, strict=True)]
    return names


def _levels(films: Sequence[str | Path]) -> list[list[str]]:
    """Names of the films' files, then names of their folders, nearest first, if each film has another folder."""
    levels = [[Path(film).stem for film in films]]
    folders = [Path(film).parent.parts[::-1] for film in films]
    nearest = 1 if len(films) == 1 else None  # one film is alone in all folders farther up
    for names in zip(*(each[:nearest] for each in folders), strict=False):
        if len(set(names)) == len(films):
            levels.append(list(names))
    return levels


def _contradiction(films: Sequence[str], cameras: Sequence[str], expected: str) -> InputError:
    return InputError(f"cameras {', '.join(cameras)}; expected one a film: {', '.join(films)}, {expected}")


def _tokens(name: str) -> tuple[Token, ...]:
    """Words and numbers of a name: ("cam", 1) for "Cam_01", ("cam", "a") for "camA" and for "cama"."""
    words = _TOKENS.findall(_CASE_CHANGE.sub(" ", _GOPRO.sub("gopro", name)))
    tokens: list[Token] = []
    for word, following in zip(words, [*words[1:], ""], strict=True):
        plain = word.casefold()
        if plain in _SHORT_WORDS and following.isdecimal() and len(following) >= _DIGITS_OF_CLIPS:
            tokens.append(f"{plain} clip")
        elif word.isdecimal() and len(word) <= _LONGEST:
            tokens.append(int(word))
        elif plain not in _CAMERA_WORDS and len(plain) > 3 and plain[:-1] in _CAMERA_WORDS and plain[-1] != "s":
            tokens += [plain[:-1], plain[-1]]
        else:
            tokens.append(plain)
    return tuple(tokens)


def _holds(whole: tuple[Token, ...], part: tuple[Token, ...]) -> bool:
    """True if one name is a part of another; a number or a letter alone is no name."""
    if not part or (len(part) == 1 and (isinstance(part[0], int) or len(part[0]) == 1)):
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
            index: min(len(mine), len(other))
            for index, other in enumerate(theirs)
            if mine == other or _holds(mine, other) or _holds(other, mine)
        }
        longest = max(lengths.values(), default=0)
        found.append({index for index, length in lengths.items() if length == longest})
    return found


def _by_name(films: Sequence[str], cameras: Sequence[str]) -> tuple[int, ...] | None:
    found = [next(iter(each)) for each in _named(films, cameras) if len(each) == 1]
    return tuple(found) if len(set(found)) == len(films) else None


def _by_mark(films: Sequence[str], cameras: Sequence[str], *, of_cameras: bool) -> tuple[int, ...] | None:
    """Cameras by the films' marks; None if no mark differs from film to film, or films and cameras share none.

    Args:
        films: Names of films, or of their folders.
        cameras: Names of cameras.
        of_cameras: True: only those marks of films count that a word says to be a camera's. False: only the others.

    Raises:
        InputError: If marks contradict one another, or fit in several ways.
    """
    mine = [each for each in _marks(films) if each.of_cameras == of_cameras]
    theirs = _marks(cameras)
    # A number that a word says to be a camera's counts before other numbers in the name.
    for some in ([each for each in theirs if each.of_cameras], theirs):
        fits = {
            tuple(other.values.index(mark) for mark in one.values)
            for one in mine
            for other in some
            if set(one.values) <= set(other.values)
        }
        if len(fits) > 1:
            raise _contradiction(films, cameras, "by numbers that fit in one way")
        if fits:
            return fits.pop()
    for one in mine:
        for other in theirs:
            common = set(one.values) & set(other.values)
            if common or (one.of_cameras and other.of_cameras and one.are_numbers and other.are_numbers):
                raise _contradiction(films, cameras, "by the same numbers")
    return None


@dataclass(frozen=True)
class _Marks:
    """Numbers, letters or sides, different in each name; ``of_cameras`` if words say that they are cameras'."""

    values: tuple[Token, ...]
    of_cameras: bool

    @property
    def are_numbers(self) -> bool:
        return all(isinstance(value, int) for value in self.values)


def _marks(names: Sequence[str]) -> list[_Marks]:
    """Marks that differ from name to name; those that words say to be cameras' come first."""
    tokens = [_tokens(name) for name in names]
    candidates: list[list[int]] = []  # an index among each name's tokens
    after = [[index for index in range(len(mine)) if _is_camera_s(mine, index)] for mine in tokens]
    if all(len(each) == 1 for each in after):
        candidates.append([each[0] for each in after])
    for is_mark in (_is_number, _is_letter):
        found = [[index for index, token in enumerate(each) if is_mark(token)] for each in tokens]
        if len({len(each) for each in found}) == 1:  # the first, second, ... number of each
            candidates += [list(each) for each in zip(*found, strict=True)]
        elif all(found):
            candidates.append([each[-1] for each in found])
    marks: list[_Marks] = []
    for each in candidates:
        values = [_side(mine[index]) for mine, index in zip(tokens, each, strict=True)]
        of_cameras = all(_is_camera_s(mine, index) for mine, index in zip(tokens, each, strict=True))
        # The number of a single name means nothing, unless a word says that it is a camera's.
        if len(set(values)) == len(names) and (of_cameras or len(names) > 1):
            marks.append(_Marks(tuple(values), of_cameras))
    return marks


def _is_number(token: Token) -> bool:
    return isinstance(token, int)


def _is_letter(token: Token) -> bool:
    """True for a single letter, or a side."""
    return isinstance(token, str) and len(_SIDES.get(token, token)) == 1


def _side(token: Token) -> Token:
    """Mark in the form in which marks are compared: a side becomes its letter."""
    return _SIDES.get(token, token) if isinstance(token, str) else token


def _is_camera_s(tokens: tuple[Token, ...], index: int) -> bool:
    """True if a token is a mark that follows a word for cameras, or the whole name, or a letter before such a word."""
    mark = tokens[index]
    if not (_is_number(mark) or _is_letter(mark)):
        return False
    if len(tokens) == 1:
        return True
    before = tokens[index - 1] if index > 0 else None
    if isinstance(mark, int):
        return before in _CAMERA_WORDS
    words = _CAMERA_WORDS - _SHORT_WORDS
    # "left_cam", but not the a of "trial_a_cam2".
    return before in words or (index + 2 == len(tokens) and tokens[-1] in words)


def _film_order(films: Sequence[str | Path]) -> list[int]:
    """Indices of films in the order that pairs them with cameras: as given, or natural if a shell sorted them."""
    given = list(range(len(films)))
    names = [str(Path(film).parent / Path(film).stem) for film in films]
    if names != sorted(names):
        return given
    return sorted(given, key=lambda film: natural_key(names[film]))


def is_camera_s(name: str) -> bool:
    """True if a name has a word for a camera, with a number, a letter or a side: cam_1, camB."""
    tokens = _tokens(name)
    return len(tokens) > 1 and any(_is_camera_s(tokens, index) for index in range(len(tokens)))


def natural_key(name: str) -> tuple[tuple[int, int, str], ...]:
    """Key that sorts names as people do: 2 before 10."""
    return tuple((0, token, "") if isinstance(token, int) else (1, 0, token) for token in _tokens(name))
