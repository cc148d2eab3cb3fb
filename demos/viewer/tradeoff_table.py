"""The table of what was tried, painted over the lower right of the window."""

from __future__ import annotations

from typing import Any

from .overlay import Overlay
from .style import ACCENT, FAINT, INK, PAPER
from .tradeoff import Tradeoff

_VIEW, _CORNER, _SIZE = (640, 189), (270, 4), (364, 181)  # of the view, and of the table in it [px]
_LETTER, _LINE = 11, 15  # [px]
_WORDS = 2  # columns of words, which begin at x; the others end there

# Of each column: two lines of its head, x [px], the row's attribute and how it is written.
_COLUMNS: tuple[tuple[str, str, int, str, str], ...] = (
    ("drawn,", "gradient", 0, "drawn", "{}"),
    ("follows", "", 88, "followed", "{}"),
    ("", "px", 168, "size", "{}"),
    ("ms an", "iter.", 204, "milliseconds", "{:.1f}"),
    ("grad.", "off", 237, "angle", "{:.0f}°"),
    ("outline", "off, px", 279, "outline", "{:.1f}"),
    ("", "iter.", 305, "iterations", "{}"),
    ("", "F1", 334, "f1", "{:.2f}"),
    ("joints", "mm", 363, "joints", "{:.0f}"),
)


class TradeoffTable:
    """The rows of a tradeoff."""

    def __init__(self, renderer: Any, tradeoff: Tradeoff) -> None:
        self._overlay = Overlay(renderer, _VIEW, _CORNER, _SIZE, _LETTER)
        self._tradeoff = tradeoff
        self._shown: list[tuple[list[str], str]] = []  # lines and their colours

    def update(self) -> None:
        """Paint the lines that have changed."""
        lines = [(["Tried from this start to this target:"], INK)]
        lines += [([first for first, *_ in _COLUMNS], FAINT), ([second for _, second, *_ in _COLUMNS], FAINT)]
        for key, row in self._tradeoff.rows.items():
            values = [(getattr(row, name), style) for *_, name, style in _COLUMNS]
            texts = ["-" if value is None else style.format(value) for value, style in values]
            lines.append((texts, ACCENT if key == self._tradeoff.current else INK))
        lines += [([], INK)] * (len(self._shown) - len(lines))  # where there were more
        changed = [k for k, line in enumerate(lines) if line not in self._shown[k : k + 1]]
        for k in changed:
            self._paint(k, *lines[k])
        if changed:
            self._shown = lines
            self._overlay.show()

    def _paint(self, index: int, texts: list[str], colour: str) -> None:
        draw, top = self._overlay.draw, _LINE * index + (4 if index > 2 else 0)
        draw.rectangle((0, top, _SIZE[0], top + _LINE - 1), fill=PAPER)
        for k, (text, column) in enumerate(zip(texts, _COLUMNS, strict=False)):
            draw.text((column[2], top + 2), text, colour, self._overlay.font, anchor="la" if k < _WORDS else "ra")
