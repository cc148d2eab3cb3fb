"""The window's buttons: rows of words that can be clicked, lit where they say what is so now."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from .overlay import Overlay
from .style import ACCENT, FAINT, INK, PAPER

_CORNER, _HINTS = (8, 4), 22  # [px]: the panel's place in a view, and the height of the line with hints
_ROW, _HEIGHT = 23, 19  # [px] from row to row, and of a button
_LETTER = 12  # [px]
_LABEL = 86  # [px]: where a row's first button begins
_IDLE, _OVER, _ON_INK = "#e6e9ed", "#ccd3dc", "#ffffff"
_MARGIN = 12  # [px] at the panel's right


@dataclass(frozen=True, eq=False)
class Button:
    """A button of the panel."""

    text: str
    key: str  # that does the same, as X and VTK name it; "" without
    hint: str  # shown while the mouse is over it
    do: Callable[[], None]
    is_on: Callable[[], bool] = lambda: False  # whether it is lit
    colour: str = ACCENT  # then


class Panel:
    """Rows of buttons in the lower left of a view of (width, height) ``view`` [px]; a string among them is a label.

    ``hint`` is told while the mouse is over no button.
    """

    def __init__(
        self, renderer: Any, rows: Sequence[Sequence[Button | str]], hint: str, view: tuple[int, int] = (640, 800)
    ) -> None:
        self._hint, self._size = hint, (view[0] - _CORNER[0] - _MARGIN, self.height_of(len(rows)))
        self.overlay = Overlay(renderer, view, _CORNER, self._size, _LETTER)
        self.boxes: dict[Button, tuple[float, float, float, float]] = {}  # left, top, right, bottom [px of the panel]
        self.over: Button | None = None  # under the mouse
        self._shown: dict[Button, tuple[bool, bool]] = {}  # whether it is lit, whether the mouse is over it
        draw, font = self.overlay.draw, self.overlay.font
        for index, row in enumerate(rows):
            left, top = 0.0, 2.0 + index * _ROW
            for entry in row:
                if isinstance(entry, str):
                    draw.text((left, top + _HEIGHT / 2), entry, FAINT, font, anchor="lm")
                    left += font.getlength(entry) + 8
                else:
                    right = left + font.getlength(entry.text) + 14
                    self.boxes[entry] = (left, top, right, top + _HEIGHT)
                    left = right + 4
                left = max(left, _LABEL)

    @staticmethod
    def height_of(rows: int) -> int:
        """Height of a panel with a number of rows [px]."""
        return rows * _ROW + _HINTS

    def at(self, x: float, y: float) -> Button | None:
        """The button at a place of the window [px, y up]; None if there is none."""
        column, row = self.overlay.pixel(x, y)
        return next((b for b, (x0, y0, x1, y1) in self.boxes.items() if x0 <= column <= x1 and y0 <= row <= y1), None)

    def update(self) -> bool:
        """Paint the buttons that have changed; whether one has."""
        now = {button: (button.is_on(), button is self.over) for button in self.boxes}
        changed = [button for button, look in now.items() if self._shown.get(button) != look]
        if not changed:
            return False
        self._shown = now
        draw, font = self.overlay.draw, self.overlay.font
        for button in changed:
            (on, over), (left, top, right, bottom) = now[button], self.boxes[button]
            draw.rounded_rectangle(
                (left, top, right, bottom), 4, fill=button.colour if on else _OVER if over else _IDLE
            )
            middle = (left + right) / 2, (top + bottom) / 2
            draw.text(middle, button.text, _ON_INK if on else INK, font, anchor="mm")
        hint = self._hint if self.over is None else self.over.hint
        if self.over is not None and self.over.key:
            hint += f"   (key: {self.over.key})"
        draw.rectangle((0, self._size[1] - 18, *self._size), fill=PAPER)
        draw.text((0, self._size[1] - 4), hint, FAINT, font, anchor="ls")
        self.overlay.show()
        return True


def flip(of: object, name: str) -> None:
    """Turn a switch of an object: an attribute that is True or False."""
    setattr(of, name, not getattr(of, name))
