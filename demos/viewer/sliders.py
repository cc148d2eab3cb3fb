"""The sliders: pages of what they can set, and the column of widgets that shows one page at a time."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from ..body.template import LENGTH_NAMES, PART_NAMES, THICKNESS_NAMES
from .state import DemoState
from .style import INK
from .view import VIEW, view_of

_PER_PAGE = 6
_TOP, _STEP = 0.80, 0.068  # of the view's height: the first slider, and from one to the next
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


class Slider(NamedTuple):
    """Title of a slider, its smallest, largest and present value, and the function that sets it."""

    title: str
    low: float
    high: float
    value: float
    set: Callable[[float], None]


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


def add_slider(
    plotter: Any, moved: Callable[[float], None], ends: tuple[float, float], height: float, style: str = "%.1f"
) -> Any:
    """Add a widget to the active view, of which ``ends`` and ``height`` are shares; ``moved`` is told its value."""
    widget = plotter.add_slider_widget(
        moved,
        (0.0, 1.0),
        pointa=(ends[0], height),
        pointb=(ends[1], height),
        title=" ",
        title_height=0.014,
        fmt=style,
        slider_width=0.012,
        tube_width=0.004,
        color=INK,
        interaction_event="always",
    )
    shown = widget.GetRepresentation()
    shown.SetLabelHeight(0.014)
    shown.SetEndCapLength(0.004)
    shown.SetEndCapWidth(0.012)
    return widget


class SliderColumn:
    """Six slider widgets and a title at the left of the active view; ``moved`` is told which, from 0, and its value."""

    def __init__(self, plotter: Any, moved: Callable[[int, float], None]) -> None:
        self._moved: Callable[[int, float], None] = lambda *_: None  # widgets call back when they are made, too
        place = (0.02, _TOP + 0.06)
        self._title = plotter.add_text("", position=place, viewport=True, font_size=8, color=INK, font="arial")
        self.widgets = [self._add(plotter, k) for k in range(_PER_PAGE)]
        self._moved = moved

    def _add(self, plotter: Any, index: int) -> Any:
        return add_slider(plotter, lambda value: self._moved(index, value), (0.02, 0.21), _TOP - _STEP * index)

    def show(self, page: Page) -> None:
        """Give the widgets a page's titles, bounds and values."""
        self._title.input = page.title
        for k, widget in enumerate(self.widgets):
            widget.SetEnabled(k < len(page.sliders))
            if k < len(page.sliders):
                title, low, high, value, _ = page.sliders[k]
                shown = widget.GetRepresentation()
                shown.SetTitleText(title)
                shown.SetMinimumValue(min(low, value))
                shown.SetMaximumValue(max(high, value, low + 1e-3))
                shown.SetValue(value)
