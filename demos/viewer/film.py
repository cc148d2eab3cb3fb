"""What happens in the window, as an animated GIF."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .record import write

FILM = "demo.gif"
_MOST = 400  # pictures of 0.8 MB
_SMALLER = 2


class Film:
    """Pictures of the window at half its size, one after each change, while it runs.

    Attributes:
        running: Whether pictures are taken.
    """

    def __init__(self) -> None:
        self.running = False
        self._pictures: list[np.ndarray] = []

    def start(self) -> None:
        """Begin with nothing."""
        self._pictures, self.running = [], True

    def take(self, picture: np.ndarray) -> bool:
        """Keep a picture, RGB, shape (height, width, 3), uint8; whether there is room for more."""
        from PIL import Image

        small = np.asarray(Image.fromarray(picture).reduce(_SMALLER))
        if self._pictures and small.shape != self._pictures[0].shape:  # the window has another size now
            self._pictures = []
        self._pictures.append(small)
        return len(self._pictures) < _MOST

    def stop(self, folder: Path) -> int:
        """Write ``FILM`` into a folder, made if it isn't there, and forget the pictures; how many there were.

        Raises:
            InputError: If it can't be written.
        """
        self.running = False
        pictures, self._pictures = self._pictures, []
        if pictures:
            write(pictures, folder / FILM)
        return len(pictures)
