"""Controls of the demo's windows, and the panel that they are painted in: texts, buttons and sliders in rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

from PIL import ImageFont

from .overlay import Overlay
from .plotted import Box
from .style import ACCENT, FAINT, IDLE, INK, ON_INK, OVER, PAPER

_SMALLEST = 6  # [px] of letters
_MARGIN, _GAP = 0.7, 0.35  # around the panel and between its entries, in letters' sizes, as all that follows
_BUTTON, _TEXT, _SLIDER = 1.65, 1.4, 2.5  # heights
_LABEL, _TRACK = 6.5, 13.0  # widths of a label before buttons, at least, and of a slider


@dataclass(frozen=True, eq=False)
class Button:
    """A button of the panel."""

    text: str
    key: str  # that does the same, as X and VTK name it; "" without
    hint: str  # shown while the mouse is over it
    do: Callable[[], None]
    is_on: Callable[[], bool] = lambda: False  # whether it is lit
    colour: str = ACCENT  # then


class Slider(NamedTuple):
    """Title of a slider, its smallest, largest and present value, and the function that sets it."""

    title: str
    low: float
    high: float
    value: float
    set: Callable[[float], None]

    @property
    def shown(self) -> str:
        """The value in words."""
        return f"{self.value:.0f}" if self.high - self.low > 50 else f"{self.value:.1f}"

    @property
    def share(self) -> float:
        """Place of the value between the smallest and the largest, 0 to 1."""
        return min(max((self.value - self.low) / max(self.high - self.low, 1e-9), 0.0), 1.0)


Entry: TypeAlias = Button | Slider | str
Rows: TypeAlias = Sequence[Sequence[Entry]]


class Placed(NamedTuple):
    """An entry of the panel, and its box there [px]."""

    entry: Entry
    left: float
    top: float
    right: float
    bottom: float

    def holds(self, column: float, row: float) -> bool:
        """True if a place is in the box."""
        return self.left <= column <= self.right and self.top <= row <= self.bottom


class Panel:
    """Rows of texts, buttons and sliders, with letters as large as the rows fit into a view.

    A row that holds one text is wrapped; a text before buttons is their label.
    """

    def __init__(self, renderer: Any) -> None:
        self.overlay = Overlay(renderer)
        self.entries: list[Placed] = []
        self.over: Button | None = None  # under the mouse
        self.letter = 8  # [px]
        self._known: object = None  # what the size of letters was chosen for
        self._painted: list[tuple[Any, ...]] = []  # how each entry looks, and where it is

    def at(self, x: float, y: float) -> Placed | None:
        """The button or slider at a place of the window [px, y up]; None if there is none."""
        column, row = self.overlay.pixel(x, y)
        found = (each for each in self.entries if not isinstance(each.entry, str) and each.holds(column, row))
        return next(found, None)

    def slide(self, placed: Placed, x: float) -> None:
        """Pull a slider to a place of the window [px]."""
        slider = placed.entry
        assert isinstance(slider, Slider)
        column, width = self.overlay.pixel(x, 0)[0] - placed.left, placed.right - placed.left
        share = (column - self.letter / 2) / max(width - self.letter, 1.0)
        slider.set(slider.low + min(max(share, 0.0), 1.0) * (slider.high - slider.low))

    def update(self, rows: Rows, box: Box, largest: int) -> bool:
        """Paint what has changed of rows in a box of the window; whether something has.

        Letters are ``largest`` px at most.
        """
        if min(box.width, box.height) < 1:
            self.entries = []
            return False
        known = box, largest, [len(row) for row in rows]
        if known != self._known:
            self._known, self.letter = known, largest
        while True:
            self.entries, height = _placed(rows, box.width, self.letter)
            if height <= box.height or self.letter <= _SMALLEST:
                break
            self.letter -= 1
        size = box.width, box.height
        looks = [_look(each, self.over) for each in self.entries]
        if size != self.overlay.size or [look[:4] for look in looks] != [look[:4] for look in self._painted]:
            self.overlay.begin(size, self.letter)
            self._painted = []
        changed = [k for k, look in enumerate(looks) if look not in self._painted[k : k + 1]]
        for k in changed:
            self._paint(self.entries[k])
        self._painted = looks
        if changed:
            self.overlay.show()
        return bool(changed)

    def _paint(self, placed: Placed) -> None:
        entry, left, top, right, bottom = placed
        draw, font, em = self.overlay.draw, self.overlay.font, self.letter
        if isinstance(entry, str):
            draw.rectangle((left, top, right, bottom), fill=PAPER)
            draw.text((left, (top + bottom) / 2), entry, INK, font, anchor="lm")
        elif isinstance(entry, Button):
            on = entry.is_on()
            fill = entry.colour if on else OVER if entry is self.over else IDLE
            draw.rounded_rectangle((left, top, right, bottom), em / 3, fill=fill)
            draw.text(((left + right) / 2, (top + bottom) / 2), entry.text, ON_INK if on else INK, font, anchor="mm")
        else:
            draw.rectangle((left, top, right, bottom), fill=PAPER)
            middle, knob, line = bottom - 0.6 * em, 0.5 * em, max(round(em / 4), 2)
            place = left + knob + entry.share * (right - left - 2 * knob)
            draw.text((left, top), entry.title, FAINT, font, anchor="la")
            draw.text((right, top), entry.shown, INK, font, anchor="ra")
            draw.line((left, middle, right, middle), OVER, line)
            draw.line((left, middle, place, middle), ACCENT, line)
            draw.ellipse((place - knob, middle - knob, place + knob, middle + knob), fill=ACCENT)


def _placed(rows: Rows, width: float, em: float) -> tuple[list[Placed], float]:
    """Entries of rows in their places in a panel of a width [px], with letters of a size, and how high they are."""
    font, margin, gap = ImageFont.load_default(em), _MARGIN * em, _GAP * em
    found: list[Placed] = []
    top = margin
    for row in rows:
        if len(row) == 1 and isinstance(row[0], str):
            for line in _wrapped(row[0], font, width - 2 * margin):
                found.append(Placed(line, margin, top, width - margin, top + _TEXT * em))
                top += _TEXT * em
            top += gap
            continue
        left, begin, tallest = margin, margin, 0.0
        for index, entry in enumerate(row):
            across, high = _size_of(entry, font, em)
            across = min(across, width - 2 * margin)
            if left > begin and left + across > width - margin:
                left, top, tallest = begin, top + tallest + gap, 0.0
            found.append(Placed(entry, left, top, left + across, top + high))
            left, tallest = left + across + gap, max(tallest, high)
            if index == 0 and isinstance(entry, str):  # the label of a row stands alone before all of its lines
                left = begin = max(left, margin + _LABEL * em)
        top += tallest + gap
    return found, top + margin - gap


def _size_of(entry: Entry, font: Any, em: float) -> tuple[float, float]:
    """Width and height of an entry [px]."""
    if isinstance(entry, str):
        return font.getlength(entry), _BUTTON * em
    if isinstance(entry, Button):
        return font.getlength(entry.text) + 1.2 * em, _BUTTON * em
    return _TRACK * em, _SLIDER * em


def _wrapped(text: str, font: Any, width: float) -> list[str]:
    """Lines of a text that are no wider than ``width`` [px], if no word is."""
    lines: list[str] = []
    for word in text.split():
        if lines and font.getlength(f"{lines[-1]} {word}") <= width:
            lines[-1] += f" {word}"
        else:
            lines.append(word)
    return lines


def _look(placed: Placed, over: Button | None) -> tuple[Any, ...]:
    """Place of an entry, then its look."""
    entry = placed.entry
    if isinstance(entry, str):
        return (*placed[1:], entry)
    if isinstance(entry, Button):
        return (*placed[1:], entry.text, entry.is_on(), entry is over)
    return (*placed[1:], *entry[:4])


def flip(of: object, name: str) -> None:
    """Turn a switch of an object: an attribute that is True or False."""
    setattr(of, name, not getattr(of, name))
