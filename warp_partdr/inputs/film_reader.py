"""Frames of a film in any order, such as a slider asks for."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from .films import FilmFrames

_KEPT = 48  # pictures in memory
_BEFORE = 16  # frames that are read, too, on steps back


class FilmReader:
    """A film that is open where it was looked at last; a few dozen pictures around it are in memory."""

    def __init__(self, path: Path, shrink: Callable[[np.ndarray], np.ndarray]) -> None:
        """``shrink``: makes a frame's picture what is kept of it."""
        self._path, self._shrink = path, shrink
        self._frames: FilmFrames | None = None  # opened at the first picture
        self._kept: dict[int, np.ndarray] = {}
        self._last = 0  # frame that was read

    def picture(self, index: int) -> np.ndarray:
        """A frame's picture, shrunk; an InputError if it can't be read."""
        if index not in self._kept:
            self._frames = self._frames or FilmFrames(self._path)
            back = self._last - _KEPT - _BEFORE <= index < self._last  # and it may go on so
            for each in range(max(index - _BEFORE * back, 0), index + 1):
                self._kept.pop(each, None)  # the newest come last
                self._kept[each] = self._shrink(self._frames.read(each))
                if len(self._kept) > _KEPT:
                    del self._kept[next(iter(self._kept))]
            self._last = index
        return self._kept[index]
