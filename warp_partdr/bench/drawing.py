"""A picture to draw charts on: lines, text, and marks that are told apart by their shape."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from PIL import Image as PilImage
from PIL import ImageDraw, ImageFont

if TYPE_CHECKING:
    from PIL.Image import Image

Colour = tuple[int, int, int]
Point = tuple[float, float]

BLACK, WHITE = (0, 0, 0), (255, 255, 255)
SHAPES = ("circle", "square", "triangle", "diamond")
_SMOOTH = 2  # drawn so much larger, for smooth marks


class Canvas:
    """A white picture; all places and lengths are in its pixels.

    Args:
        width: Of the picture [px].
        height: Of the picture [px].
        letters: Height of letters [px]; bold ones are 2 px higher.
    """

    def __init__(self, width: int, height: int, letters: int) -> None:
        self._size = width, height
        self._image = PilImage.new("RGB", (width * _SMOOTH, height * _SMOOTH), "white")
        self._draw = ImageDraw.Draw(self._image)
        self._fonts = [ImageFont.load_default(size * _SMOOTH) for size in (letters, letters + 2)]

    def image(self) -> Image:
        """The picture as it is now."""
        return self._image.resize(self._size, PilImage.Resampling.BOX)

    def text(self, x: float, y: float, text: str, anchor: str = "lm", *, bold: bool = False) -> float:
        """Write in black, and return the width [px]; ``anchor`` as Pillow's."""
        font = self._fonts[bold]
        self._draw.text(_at((x, y)), text, BLACK, font, anchor=anchor)
        return font.getlength(text) / _SMOOTH

    def line(self, points: Sequence[Point], colour: Colour, width: float = 1) -> None:
        """Draw a polyline ``width`` px wide."""
        ends = [number for point in points for number in _at(point)]
        self._draw.line(ends, fill=colour, width=round(width * _SMOOTH), joint="curve" if len(points) > 2 else None)

    def frame(self, corner: Point, opposite: Point, colour: Colour) -> None:
        """Draw the outline of a rectangle."""
        self._draw.rectangle([*_at(corner), *_at(opposite)], outline=colour, width=_SMOOTH)

    def mark(self, place: Point, shape: str, half: float, fill: Colour, outline: Colour, width: float = 1) -> None:
        """Draw one of ``SHAPES``, ``2 * half`` px wide and high."""
        x, y = place
        corners = {
            "circle": [(x - half, y - half), (x + half, y + half)],
            "square": [(x - half, y - half), (x + half, y - half), (x + half, y + half), (x - half, y + half)],
            "triangle": [(x, y - half), (x + half, y + half), (x - half, y + half)],
            "diamond": [(x, y - half), (x + half, y), (x, y + half), (x - half, y)],
        }[shape]
        draw = self._draw.ellipse if shape == "circle" else self._draw.polygon
        draw([_at(corner) for corner in corners], fill=fill, outline=outline, width=round(width * _SMOOTH))


def log_ticks(low: float, high: float) -> Iterator[tuple[int, float]]:
    """Ticks of an axis from ``10 ** low`` to ``10 ** high``: the first digit, 1 to 9, and the value."""
    for power in range(math.floor(low), math.ceil(high) + 1):
        for digit in range(1, 10):
            value = digit * 10.0**power
            if low <= math.log10(value) <= high:
                yield digit, value


def _at(point: Point) -> Point:
    return point[0] * _SMOOTH, point[1] * _SMOOTH
