"""Frames of a film in any order, as a slider asks for them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from .films import FilmFrames

_KEPT = 48  # pictures in memory
_BEFORE = 16  # frames that are read, too, on steps back


class FilmReader:
    """Film that is open at the frame that was read last; a few dozen pictures around it are in memory."""

    def __init__(self, path: Path, shrink: Callable[[np.ndarray], np.ndarray]) -> None:
        """Open nothing yet; ``shrink`` turns a frame's picture into the one that is kept in memory."""
        self._path, self._shrink = path, shrink
        self._frames: FilmFrames | None = None  # opened at the first picture
        self._kept: dict[int, np.ndarray] = {}
        self._last = 0  # frame that was read

    def picture(self, index: int) -> np.ndarray:
        """Return a frame's picture, shrunk; raise InputError if it can't be read."""
        if index not in self._kept:
            self._frames = self._frames or FilmFrames(self._path)
            back = self._last - _KEPT - _BEFORE <= index < self._last  # the next steps may go back, too
            for each in range(max(index - _BEFORE * back, 0), index + 1):
                self._kept.pop(each, None)  # the newest come last
                self._kept[each] = self._shrink(self._frames.read(each))
                if len(self._kept) > _KEPT:
                    del self._kept[next(iter(self._kept))]
            self._last = index
        return self._kept[index]
