"""Recordings of a fitted film: its frames as pictures of the window, drawn one at a time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import SupportsIndex, overload

import numpy as np

from ..solve.ellipsoids.stages import Progress
from .motion_scene import PlottedMotion
from .recording import MOST, RATE, write

_SMOOTH = 60.0  # pictures a second of an .mp4, at most
_ROUNDED = 0.25  # of a frame, by which times may be rounded


class MotionPictures(Sequence[np.ndarray]):
    """Pictures at even steps of the frames of an even film, each drawn when it is asked for."""

    def __init__(self, scene: PlottedMotion, step: int, progress: Progress) -> None:
        self._scene, self._progress = scene, progress
        saved = scene.state.saved
        times = np.arange(0, round(float(saved.times[-1]) * saved.rate) + 1, step) / saved.rate
        # Of each time the frame that is shown then; containers round times.
        self._frames = (np.searchsorted(saved.times, times + _ROUNDED / saved.rate, side="right") - 1).tolist()

    def __len__(self) -> int:
        """Number of the pictures."""
        return len(self._frames)

    @overload
    def __getitem__(self, index: SupportsIndex) -> np.ndarray: ...
    @overload
    def __getitem__(self, index: slice) -> list[np.ndarray]: ...
    def __getitem__(self, index: SupportsIndex | slice) -> np.ndarray | list[np.ndarray]:
        """One of them, RGB, (height, width, 3), uint8; an IndexError ends them."""
        places = range(len(self))[index]
        if isinstance(places, range):
            return [self[place] for place in places]
        self._scene.state.go(self._frames[places])
        self._scene.update()
        self._progress("recording", places + 1, len(self))
        return self._scene.screenshot()


def record_motion(scene: PlottedMotion, path: Path, progress: Progress) -> int:
    """Write all frames, or as many as such a file can hold, at the film's speed; returns how many."""
    rate = scene.state.saved.rate * scene.state.speed
    if path.suffix == ".mp4":
        step = math.ceil(rate / _SMOOTH - 1e-6)
    else:
        count = round(float(scene.state.saved.times[-1]) * scene.state.saved.rate) + 1
        step = max(round(rate / RATE), -(-count // MOST), 1)
    pictures = MotionPictures(scene, step, progress)
    write(pictures, path, rate / step)
    return len(pictures)
