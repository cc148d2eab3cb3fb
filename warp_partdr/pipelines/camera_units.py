"""Unit of calibrated cameras' positions, found from the sizes of people in their films.

The rays through one person's keypoints meet in any unit. If cameras were calibrated in centimetres, people are a
hundred times as large. So people are matched by the distances of rays relative to people's sizes, and the sizes then
give the unit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations, product

import numpy as np

from .observed_film import ObservedFilm
from .same_people import LENGTHS, meeting

_APART = 0.05  # median distance of rays above which they belong to two people, over trunk, thigh and shin together
_TYPICAL = 1.27  # [m], length of an adult's trunk, thigh and shin together
_TALL = 1.7  # [m], height of an adult
_UNITS = {"millimetres": 0.001, "centimetres": 0.01}
_NAMED = (0.8, 1.75)  # [m], lengths of trunk, thigh and shin together for which a unit in _UNITS is believed


def in_metres(films: Sequence[ObservedFilm]) -> tuple[list[ObservedFilm], list[str]]:
    """Converts films to metres, if their cameras were calibrated in another unit.

    Translations are taken as millimetres or centimetres if people then have a plausible size. In any other unit, such
    as squares of a chessboard, people get the size of a typical adult.

    Args:
        films: Films with calibrated cameras, matched frame by frame.

    Returns:
        The films, and a warning if they were converted.
    """
    sizes = _sizes(films) if all(film.by_calibration for film in films) else []
    size = float(np.median(sizes)) if sizes else math.nan
    if not sizes or LENGTHS[0] <= size <= LENGTHS[1]:
        return list(films), []
    named = [name for name, unit in _UNITS.items() if _NAMED[0] <= unit * size <= _NAMED[1]]
    factor = _UNITS[named[0]] if named else _TYPICAL / size
    tall = f"people are about {_TALL * factor * size / _TYPICAL:.2f} m tall"
    if named:
        warning = f"translations are taken as {named[0]}, with which {tall}; expected metres, please convert them"
    else:
        warning = (
            f"translations are multiplied by {factor:.3g}, with which {tall}, like most people; expected metres. Are "
            "they in squares of a chessboard, or in another unit? Please convert them, because all distances depend on "
            "the unit"
        )
    return [film.scaled(factor) for film in films], [f"cameras: {warning}"]


def _sizes(films: Sequence[ObservedFilm]) -> list[float]:
    """Sizes of people who are in two films. Each person is matched with at most one person of the other film."""
    sizes: list[float] = []
    for one, other in combinations(films, 2):
        pairs = product(range(one.people.num_people), range(other.people.num_people))
        found = []
        for first, second in pairs:
            met = meeting(one, one.people.of(first), other, other.people.of(second))
            if met.distance < _APART * met.size:  # False if the size is NaN
                found.append((met.distance / met.size, first, second, met.size))
        matched: set[tuple[int, int]] = set()
        for _, first, second, size in sorted(found):
            if not matched & {(0, first), (1, second)}:
                matched |= {(0, first), (1, second)}
                sizes.append(size)
    return sizes
