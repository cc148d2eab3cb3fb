"""Pictures for pages: each page asks for the next one when it shows the last, and gets the newest there is then."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple

_QUALITIES = (85, 70, 55, 40, 30, 20)  # of JPEG
_MOVING = 0.4  # [s] a picture may be under way while others follow
_STILL = 0.8  # [s] and while nothing changes; an answer waits behind no more
_QUIET = 0.5  # [s] without a change, until a rough picture is sent again


class JpegPicture(NamedTuple):
    """One picture: which change it shows, the quality of its JPEG, and the file."""

    number: int
    quality: int
    content: bytes


class PictureStream:
    """The newest picture of a window, drawn when a page asks for it.

    So one picture at most is under way to each page, and none waits for another page's. To trame this is a scheduler
    (``RcaRenderSchedulerProtocol``). ``rca`` is the window as trame sees it; ``encode`` makes a JPEG of an array:
    (array, columns, rows, quality) to (file, ...).
    """

    def __init__(self, rca: Any, encode: Callable[..., tuple[Any, ...]]) -> None:
        self.rca, self._encode = rca, encode
        self.closed = False  # nobody waits any more
        self._number = 1  # of changes
        self._changed = asyncio.Event()
        self._drawn = 0
        self._image: tuple[Any, ...] = ()
        self._encoded: dict[int, bytes] = {}
        self._drawing = asyncio.Lock()

    def schedule_render(self) -> None:
        """Note a change; it is drawn when a page asks."""
        self._number += 1
        self._changed.set()
        self._changed = asyncio.Event()

    def set_push_callback(self, callback: Callable[..., None]) -> None:
        """Do nothing, for pages ask for pictures themselves."""

    def reset(self) -> None:
        """Do nothing, for each picture is whole."""

    async def close(self) -> None:
        """Let those go that wait."""
        self.closed = True
        self.schedule_render()

    async def after(self, number: int, quality: int, rate: float) -> JpegPicture:
        """The next picture for a page: newer than the one it shows (0: none) or, while nothing changes, better.

        ``rate`` is how many bytes a second reach the page; 0 if it isn't known yet.
        """
        if number == self._number:
            with suppress(TimeoutError):
                await asyncio.wait_for(self._leave(number), _QUIET if quality < _QUALITIES[0] else None)
        if number == self._number:
            better = await self._draw(rate * _STILL)
            if better.number != number or better.quality > quality:
                return better
            await self._leave(number)
        return await self._draw(rate * _MOVING)

    async def _leave(self, number: int) -> None:
        while number == self._number:
            await self._changed.wait()

    async def _draw(self, size: float) -> JpegPicture:
        """The newest picture, of the best quality that fits into a number of bytes, or else of the least."""
        async with self._drawing:
            if self._drawn != self._number:
                self._drawn, self._encoded = self._number, {}
                self._image = self.rca.img_cols_rows
            for quality in _QUALITIES:
                if quality not in self._encoded:
                    self._encoded[quality] = (await asyncio.to_thread(self._encode, *self._image, quality))[0]
                if len(self._encoded[quality]) <= size:
                    break
            return JpegPicture(self._drawn, quality, self._encoded[quality])
