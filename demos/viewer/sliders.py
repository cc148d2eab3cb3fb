"""The sliders: pages of what they can set, and the column of widgets that shows one page at a time."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from ..body.template import PART_NAMES
from .state import SIZE_NAMES, DemoState
from .style import INK
from .view import VIEW

_PER_PAGE = 6
_AXES = ("x", "y", "z")
_TOP, _STEP = 0.80, 0.068  # of the view's height: the first slider, and from one to the next


class Slider(NamedTuple):
    """Title of a slider, its smallest, largest and present value, and the function that sets it."""

    title: str
    low: float
    high: float
    value: float
    set: Callable[[float], None]


class Page(NamedTuple):
    """Sliders that are shown together.

    Attributes:
        kind: "lengths", "thicknesses", "camera" or "part".
        title: Above them.
        sliders: At most six.
    """

    kind: str
    title: str
    sliders: list[Slider]


def _num_pages(field: str) -> int:
    return -(-len(SIZE_NAMES[field]) // _PER_PAGE)


# Kind of each page, and its number among those of its kind.
PAGES: tuple[tuple[str, int], ...] = (
    *((field, k) for field in SIZE_NAMES for k in range(_num_pages(field))),
    ("camera", 0),
    ("part", 0),
)


def make_page(state: DemoState, part: str, index: int) -> Page:
    """One of ``PAGES`` as it is now.

    Args:
        state: What is set.
        part: Which part is turned, one of ``PART_NAMES``.
        index: Of the page.
    """
    kind, number = PAGES[index]
    if kind == "camera":
        return Page(kind, "camera and whole body", _view_sliders(state))
    if kind == "part":
        named = part.replace("_", " ")
        return Page(kind, f"rotation of the {named}", _rotation_sliders(state, part, named))
    sliders = _size_sliders(state, kind)
    first = _PER_PAGE * number
    return Page(kind, f"{kind}, {number + 1} of {_num_pages(kind)}", sliders[first : first + _PER_PAGE])


def _size_sliders(state: DemoState, field: str) -> list[Slider]:
    low, high = ((100 * bound[0]).tolist() for bound in state.bounds(field))
    values = (100 * state.body.tensors()[field][0].detach()).tolist()
    word = " length" if field == "lengths" else ""

    def resize(name: str) -> Callable[[float], None]:
        return lambda centimetres: state.set_size(field, name, centimetres / 100)

    return [
        Slider(f"{name}{word} [cm]", low[k], high[k], values[k], resize(name))
        for k, name in enumerate(SIZE_NAMES[field])
    ]


def _view_sliders(state: DemoState) -> list[Slider]:
    view = state.view()
    return [
        Slider(f"{name} [{unit}]", low, high, view[name], partial(state.set_view, name))
        for name, (unit, low, high) in VIEW.items()
    ]


def _rotation_sliders(state: DemoState, part: str, named: str) -> list[Slider]:
    index = PART_NAMES.index(part)
    low, high = (limits[index].rad2deg().tolist() for limits in (state.prior.lower_limits, state.prior.upper_limits))
    rotation = state.body.rotations[0, index].rad2deg().tolist()

    def turn(axis: int) -> Callable[[float], None]:
        return lambda degrees: state.set_rotation(part, axis, math.radians(degrees))

    return [Slider(f"{named}, {_AXES[k]} [deg]", low[k], high[k], rotation[k], turn(k)) for k in range(len(_AXES))]


class SliderColumn:
    """Six slider widgets and a title at the left of the active view.

    Args:
        plotter: PyVista's.
        moved: Told which slider was moved, 0 first, and its value.
    """

    def __init__(self, plotter: Any, moved: Callable[[int, float], None]) -> None:
        self._moved = moved
        self._filling = True  # widgets call back when they are made and filled, too
        self._title = plotter.add_text(
            "", position=(0.02, _TOP + 0.06), viewport=True, font_size=8, color=INK, font="arial"
        )
        self.widgets = [self._add(plotter, k) for k in range(_PER_PAGE)]

    def _add(self, plotter: Any, index: int) -> Any:
        y = _TOP - _STEP * index
        widget = plotter.add_slider_widget(
            lambda value: None if self._filling else self._moved(index, value),
            (0.0, 1.0),
            pointa=(0.02, y),
            pointb=(0.21, y),
            title=" ",
            title_height=0.014,
            fmt="%.1f",
            slider_width=0.02,
            tube_width=0.004,
            color=INK,
            interaction_event="always",
        )
        shown = widget.GetRepresentation()
        shown.SetLabelHeight(0.014)
        shown.SetEndCapLength(0.004)
        shown.SetEndCapWidth(0.012)
        shown.SetSliderWidth(0.012)
        return widget

    def show(self, page: Page) -> None:
        """Give the widgets a page's titles, bounds and values."""
        self._filling = True
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
        self._filling = False
