"""Sliders of the demo: pages of all that they can set."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from ..body.template import LENGTH_NAMES, PART_NAMES, THICKNESS_NAMES
from .buttons import Slider
from .state import DemoState
from .view import VIEW, view_of

_PER_PAGE = 6
_SIZE_TITLES = {
    "lengths": [f"{name} length [cm]" for name in LENGTH_NAMES],
    "thicknesses": [f"{name} [cm]" for name in THICKNESS_NAMES],
}

# Kind of each page, and the first of its sliders among those of its kind.
PAGES: tuple[tuple[str, int], ...] = (
    *((kind, first) for kind, titles in _SIZE_TITLES.items() for first in range(0, len(titles), _PER_PAGE)),
    ("camera", 0),
    ("part", 0),
)


class Page(NamedTuple):
    """Title of a page, and its sliders, at most six."""

    title: str
    sliders: list[Slider]


def make_page(state: DemoState, part: str, index: int) -> Page:
    """The page of ``PAGES`` with an index as it is now; the last one turns a part, one of ``PART_NAMES``."""
    kind, first = PAGES[index]
    if kind == "camera":
        numbers = view_of(state.body).values()
        sliders = [
            Slider(f"{name} [{unit}]", low, high, value, partial(state.set_view, name))
            for (name, (unit, low, high)), value in zip(VIEW.items(), numbers, strict=True)
        ]
        return Page("camera and whole body", sliders)
    if kind == "part":
        named, row = part.replace("_", " "), PART_NAMES.index(part)
        turns = {f"{named}, {axis} [deg]": (row, k) for k, axis in enumerate("xyz")}
        return Page(f"rotation of the {named}", _sliders(state, "rotations", turns, math.degrees(1)))
    titles = _SIZE_TITLES[kind]
    sizes = dict(list(zip(titles, range(len(titles)), strict=True))[first : first + _PER_PAGE])
    count = -(-len(titles) // _PER_PAGE)
    return Page(f"{kind}, {first // _PER_PAGE + 1} of {count}", _sliders(state, kind, sizes, 100))


def _sliders(state: DemoState, field: str, indices: dict[str, Any], unit: float) -> list[Slider]:
    """Sliders of numbers of the body: their indices by title; ``unit``: how many of what is shown make 1 m or 1 rad."""
    low, high = state.bounds(field)
    values = state.body.tensors()[field][0].detach()

    def setter(index: Any) -> Callable[[float], None]:
        return lambda value: state.set_number(field, index, value / unit)

    return [
        Slider(title, unit * float(low[k]), unit * float(high[k]), unit * float(values[k]), setter(k))
        for title, k in indices.items()
    ]
