"""Pictures for pages: each page asks for the next one when it shows the last, and gets the newest there is then."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from .plotted import Look

_QUALITIES = (85, 70, 55, 40, 30, 20)  # of JPEG
_MOVING = 0.4  # [s] a picture may be under way while others follow
_STILL = 0.8  # [s] and while nothing changes; an answer waits behind no more
_QUIET = 0.5  # [s] without a change, until a rough picture is sent again
_LOOKS = 4  # pages of different sizes whose pictures are kept


class JpegPicture(NamedTuple):
    """One picture: which change it shows, the quality of its JPEG, and the file."""

    number: int
    quality: int
    content: bytes


class _Drawn:
    """A picture of a change, and its files by their quality."""

    def __init__(self, number: int, image: np.ndarray) -> None:
        self.number, self.image = number, image
        self.files: dict[int, bytes] = {}


class PictureStream:
    """The newest picture of a window, drawn when a page asks for it, as large as the page shows it.

    So one picture at most is under way to each page, and none waits for another page's.
    """

    def __init__(self, draw: Callable[[Look], np.ndarray], encode: Callable[[np.ndarray, int], bytes]) -> None:
        """``draw`` draws what somebody looks at, RGB, shape (H, W, 3), uint8; ``encode`` makes a JPEG of a quality."""
        self._draw_now, self._encode = draw, encode
        self.closed = False  # nobody waits any more
        self._number = 1  # of changes
        self._changed = asyncio.Event()
        self._drawn: dict[Look, _Drawn] = {}
        self._drawing = asyncio.Lock()

    def change(self) -> None:
        """Note a change; it is drawn when a page asks."""
        self._number += 1
        self._changed.set()
        self._changed = asyncio.Event()

    def close(self) -> None:
        """Let those go that wait."""
        self.closed = True
        self.change()

    async def changed(self) -> None:
        """Wait for a change."""
        await self._changed.wait()

    async def after(self, look: Look, number: int, quality: int, rate: float) -> JpegPicture:
        """The next picture for a page: newer than the one it shows (0: none) or, while nothing changes, better.

        ``rate`` is how many bytes a second reach the page; 0 if it isn't known yet.
        """
        if number == self._number:
            with suppress(TimeoutError):
                await asyncio.wait_for(self._leave(number), _QUIET if quality < _QUALITIES[0] else None)
        if number == self._number:
            better = await self._draw(look, rate * _STILL)
            if better.number != number or better.quality > quality:
                return better
            await self._leave(number)
        return await self._draw(look, rate * _MOVING)

    async def _leave(self, number: int) -> None:
        while number == self._number:
            await self._changed.wait()

    async def _draw(self, look: Look, size: float) -> JpegPicture:
        """The newest picture, of the best quality that fits into a number of bytes, or else of the least."""
        async with self._drawing:
            drawn = self._drawn.pop(look, None)
            if drawn is None or drawn.number != self._number:
                drawn = _Drawn(self._number, self._draw_now(look))
            self._drawn[look] = drawn  # the last one
            while len(self._drawn) > _LOOKS:
                del self._drawn[next(iter(self._drawn))]
            for quality in _QUALITIES:
                if quality not in drawn.files:
                    drawn.files[quality] = await asyncio.to_thread(self._encode, drawn.image, quality)
                if len(drawn.files[quality]) <= size:
                    break
            return JpegPicture(drawn.number, quality, drawn.files[quality])
