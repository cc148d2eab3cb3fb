"""Frames of a film in any order, such as a slider asks for."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from ..errors import InputError
from .films import Frame, read_frames

_KEPT = 48  # pictures in memory
_BEFORE, _AHEAD = 16, 12  # frames: so many before are read, too, on steps back; so many ahead are read on to
_NONE = -_AHEAD - 1  # far before the first frame


class FilmReader:
    """A film that is open where it was looked at last; a few dozen pictures around it are in memory."""

    def __init__(self, path: Path, times: Sequence[float], shrink: Callable[[np.ndarray], np.ndarray]) -> None:
        """``times``: of all its frames [s]; ``shrink``: makes a frame's picture what is kept of it."""
        self._path, self._times, self._shrink = path, times, shrink
        self._kept: dict[int, np.ndarray] = {}
        self._coming: Iterator[Frame] = iter(())
        self._last = _NONE  # frame that was read

    def picture(self, index: int) -> np.ndarray:
        """A frame's picture, shrunk; an InputError if it can't be read."""
        if index not in self._kept:
            if not self._last < index <= self._last + _AHEAD:
                back = self._last - _KEPT - _BEFORE <= index < self._last  # and it may go on so
                first = max(index - _BEFORE * back, 0)
                self._coming, self._last = read_frames(self._path, first=first, times=self._times), _NONE
            self._read_to(index)
        return self._kept[index]

    def _read_to(self, index: int) -> None:
        for frame in self._coming:
            self._last = frame.index
            self._kept.pop(frame.index, None)  # the newest come last
            self._kept[frame.index] = self._shrink(frame.picture)
            while len(self._kept) > _KEPT:
                del self._kept[next(iter(self._kept))]
            if frame.index >= index:
                break
        if index not in self._kept:
            self._last = _NONE
            raise InputError(f"{self._path}: no frame {index}; expected the film that was fitted")
