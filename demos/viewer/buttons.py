"""The window's buttons: rows of words that can be clicked, lit where they say what is so now."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .overlay import Overlay
from .style import ACCENT, FAINT, INK, PAPER

SIZE = (620, 206)  # of the panel [px]
_ROW, _HEIGHT = 23, 19  # [px] from row to row, and of a button
_LETTER = 12  # [px]
_LABEL = 86  # [px]: where a row's first button begins
_IDLE, _OVER, _ON_INK = "#e6e9ed", "#ccd3dc", "#ffffff"
_HINT = "Drag to turn the body, wheel to zoom, click on a part for its sliders; q closes. Point at a button for more."


def _never() -> bool:
    return False


@dataclass(frozen=True, eq=False)
class Button:
    """A button of the panel, or a label beside some.

    Attributes:
        text: On it; of a label, which can't be clicked, what it says.
        hint: What it does, shown while the mouse is over it.
        key: The key that does the same, as X and VTK name it; "" without.
        do: What it does; None of a label.
        is_on: Whether it is lit.
    """

    text: str
    hint: str = ""
    key: str = ""
    do: Callable[[], None] | None = None
    is_on: Callable[[], bool] = _never


class Panel:
    """Rows of buttons in the lower left of a view.

    Args:
        renderer: The view.
        rows: From top to bottom; a row's first entry is its label.
    """

    def __init__(self, renderer: Any, rows: Sequence[Sequence[Button]]) -> None:
        from PIL import Image, ImageFont

        self._font = ImageFont.load_default(_LETTER)
        # As many pixels as it is large in a window of the usual size, 640 x 800 of it the view.
        self._overlay = Overlay(renderer, (8 / 640, 4 / 800, (8 + SIZE[0]) / 640, (4 + SIZE[1]) / 800), SIZE)
        self._boxes: dict[Button, tuple[float, float, float, float]] = {}
        self.over: Button | None = None
        for index, row in enumerate(rows):
            left, top = 0.0, 2.0 + index * _ROW
            for button in row:
                width = self._font.getlength(button.text) + (4 if button.do is None else 14)
                self._boxes[button] = (left, top, left + width, top + _HEIGHT)
                left = max(left + width + 4, _LABEL if button is row[0] else 0)
        self._picture = Image.new("RGB", SIZE, PAPER)
        self._shown: dict[Button, tuple[bool, bool]] = {}  # whether it is lit, whether the mouse is over it

    @property
    def buttons(self) -> list[Button]:
        """All that can be clicked."""
        return [button for button in self._boxes if button.do is not None]

    def at(self, x: float, y: float) -> Button | None:
        """The button at a place of the window [px, y up]; None if there is none."""
        pixel = self._overlay.pixel(x, y)
        if pixel is None:
            return None
        for button in self.buttons:
            left, top, right, bottom = self._boxes[button]
            if left <= pixel[0] <= right and top <= pixel[1] <= bottom:
                return button
        return None

    def place(self, button: Button) -> tuple[int, int]:
        """Place of a button's middle in the window [px, y up]."""
        left, top, right, bottom = self._boxes[button]
        return self._overlay.place((left + right) / 2, (top + bottom) / 2)

    def update(self) -> bool:
        """Paint the buttons if one has changed; whether one has."""
        now = {button: (button.is_on(), button is self.over) for button in self._boxes}
        changed = [button for button, look in now.items() if self._shown.get(button) != look]
        if not changed:
            return False
        self._shown = now
        for button in changed:
            self._paint(button, *now[button])
        self._paint_hint()
        self._overlay.show(np.asarray(self._picture))
        return True

    def _paint(self, button: Button, on: bool, over: bool) -> None:
        from PIL import ImageDraw

        draw, box = ImageDraw.Draw(self._picture), self._boxes[button]
        left, top, right, _ = box
        middle = top + _HEIGHT / 2
        if button.do is None:
            draw.text((left, middle), button.text, FAINT, self._font, anchor="lm")
            return
        draw.rounded_rectangle(box, 4, fill=ACCENT if on else _OVER if over else _IDLE)
        draw.text(((left + right) / 2, middle), button.text, _ON_INK if on else INK, self._font, anchor="mm")

    def _paint_hint(self) -> None:
        from PIL import ImageDraw

        draw = ImageDraw.Draw(self._picture)
        draw.rectangle((0, SIZE[1] - 18, *SIZE), fill=PAPER)
        draw.text((0, SIZE[1] - 4), self._hint(), FAINT, self._font, anchor="ls")

    def _hint(self) -> str:
        if self.over is None:
            return _HINT
        return f"{self.over.hint}   (key: {self.over.key})" if self.over.key else self.over.hint
