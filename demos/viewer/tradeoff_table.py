"""The table of what was tried, as a picture."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from .overlay import Overlay
from .style import ACCENT, FAINT, INK, PAPER
from .tradeoff import Tradeoff, TradeoffRow

_SIZE = (364, 181)  # [px]
_LETTER, _LINE = 11, 15  # [px]


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


class _Column(NamedTuple):
    """Two lines of a head, where the column ends [px], or begins if it is one of the first, and its numbers."""

    head: tuple[str, str]
    x: int
    tell: Callable[[TradeoffRow], str]


_COLUMNS = (
    _Column(("drawn,", "gradient"), 0, lambda row: row.drawn),
    _Column(("follows", ""), 88, lambda row: row.followed),
    _Column(("", "px"), 168, lambda row: str(row.size)),
    _Column(("ms an", "iter."), 204, lambda row: _number(row.milliseconds, 1)),
    _Column(("grad.", "off"), 237, lambda row: "-" if row.angle is None else f"{row.angle:.0f}°"),
    _Column(("outline", "off, px"), 279, lambda row: _number(row.outline, 1)),
    _Column(("", "iter."), 305, lambda row: str(row.iterations)),
    _Column(("", "F1"), 334, lambda row: _number(row.f1, 2)),
    _Column(("joints", "mm"), 363, lambda row: _number(row.joints, 0)),
)


class TradeoffTable:
    """The rows of a tradeoff, in the lower right of the window.

    Args:
        renderer: The view.
        tradeoff: Where the rows come from.
    """

    def __init__(self, renderer: Any, tradeoff: Tradeoff) -> None:
        from PIL import Image, ImageFont

        self._font = ImageFont.load_default(_LETTER)
        self._overlay = Overlay(renderer, (270 / 640, 4 / 189, (270 + _SIZE[0]) / 640, (4 + _SIZE[1]) / 189), _SIZE)
        self._tradeoff = tradeoff
        self._picture = Image.new("RGB", _SIZE, PAPER)
        self._shown: list[tuple[list[str], str]] = []  # lines and their colours

    def update(self) -> None:
        """Paint the lines that have changed."""
        lines = [(["Tried from this start to this target:"], INK)]
        lines += [([column.head[k] for column in _COLUMNS], FAINT) for k in (0, 1)]
        for key, row in self._tradeoff.rows.items():
            colour = ACCENT if key == self._tradeoff.current else INK
            lines.append(([column.tell(row) for column in _COLUMNS], colour))
        lines += [([], INK)] * (len(self._shown) - len(lines))  # where there were more
        changed = [k for k, line in enumerate(lines) if k >= len(self._shown) or line != self._shown[k]]
        if changed:
            for k in changed:
                self._paint(k, *lines[k])
            self._shown = lines
            self._overlay.show(np.asarray(self._picture))

    def _paint(self, index: int, texts: list[str], colour: str) -> None:
        from PIL import ImageDraw

        draw, top = ImageDraw.Draw(self._picture), _LINE * index + (4 if index > 2 else 0)
        draw.rectangle((0, top, _SIZE[0], top + _LINE - 1), fill=PAPER)
        for index, (text, column) in enumerate(zip(texts, _COLUMNS, strict=False)):
            draw.text((column.x, top + 2), text, colour, self._font, anchor="la" if index < 2 else "ra")
