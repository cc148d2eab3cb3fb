"""Unit of calibrated cameras' places, as the people in their films tell it.

Rays of one person's keypoints meet whatever the unit is: where cameras stand in centimetres, people are a hundred times
as large. So who is who is found by distances of rays over people's sizes, and the sizes say the unit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations, product

import numpy as np

from .observed_film import ObservedFilm
from .same_people import LENGTHS, meeting

_APART = 0.05  # median distance of rays over trunk, thigh and shin together, above which it is two people
_TYPICAL = 1.27  # [m], trunk, thigh and shin together, of an adult
_TALL = 1.7  # [m], an adult
_UNITS = {"millimetres": 0.001, "centimetres": 0.01}
_NAMED = (0.8, 1.75)  # [m], trunk, thigh and shin together of people whose cameras stand in a unit of these


def in_metres(films: Sequence[ObservedFilm]) -> tuple[list[ObservedFilm], list[str]]:
    """Films whose cameras stand in metres, and a warning if they were calibrated in another unit.

    Where people would be as tall as people are if translations were in millimetres or centimetres, they are taken so;
    in another unit, such as squares of a chessboard, people are taken to be as tall as adults are.

    Args:
        films: Of the same moments frame by frame, with calibrated cameras.
    """
    sizes = _sizes(films) if all(film.by_calibration for film in films) else []
    size = float(np.median(sizes)) if sizes else math.nan
    if not sizes or LENGTHS[0] <= size <= LENGTHS[1]:
        return list(films), []
    named = [name for name, unit in _UNITS.items() if _NAMED[0] <= unit * size <= _NAMED[1]]
    factor = _UNITS[named[0]] if named else _TYPICAL / size
    tall = f"people are about {_TALL * factor * size / _TYPICAL:.2f} m tall"
    if named:
        told = f"translations are taken as {named[0]}, with which {tall}; expected metres, please convert them"
    else:
        told = (
            f"translations are multiplied by {factor:.3g}, with which {tall}, as most are; expected metres: are they "
            "in squares of a chessboard, or in another unit? Please convert them, for all distances hang on it"
        )
    return [film.scaled(factor) for film in films], [f"cameras: {told}"]


def _sizes(films: Sequence[ObservedFilm]) -> list[float]:
    """Sizes of people whom two films show, of whom each is one in the other at most."""
    sizes: list[float] = []
    for one, other in combinations(films, 2):
        pairs = product(range(one.people.num_people), range(other.people.num_people))
        found = []
        for mine, theirs in pairs:
            met = meeting(one, one.people.of(mine), other, other.people.of(theirs))
            if met.distance < _APART * met.size:  # never of a size that is NaN
                found.append((met.distance / met.size, mine, theirs, met.size))
        taken: set[tuple[int, int]] = set()
        for _, mine, theirs, size in sorted(found):
            if not taken & {(0, mine), (1, theirs)}:
                taken |= {(0, mine), (1, theirs)}
                sizes.append(size)
    return sizes
