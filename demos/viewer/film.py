"""What happens in the window, as an animated GIF."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .recording import write

FILM = "demo.gif"
_MOST = 400  # pictures of 0.8 MB
_WIDEST = 640  # [px]
_PAPER = "#fafafa"  # beside a picture of another shape


class Film:
    """Small pictures of the window, one after each change, while it runs.

    Attributes:
        running: Whether pictures are taken.
    """

    def __init__(self) -> None:
        self.running = False
        self._pictures: list[np.ndarray] = []

    @property
    def waits(self) -> bool:
        """Whether it has ended with pictures that are still to be written."""
        return bool(self._pictures) and not self.running

    def start(self) -> None:
        """Begin with nothing."""
        self._pictures, self.running = [], True

    def take(self, picture: np.ndarray) -> bool:
        """Keep a picture, RGB, shape (height, width, 3), uint8; whether there is room for more.

        It is made smaller by a whole number. Where the window has another size now, it is fitted into the first one's.
        """
        from PIL import Image, ImageOps

        small = Image.fromarray(picture).reduce(-(-picture.shape[1] // _WIDEST))
        if self._pictures:
            height, width = self._pictures[0].shape[:2]
            if small.size != (width, height):
                small = ImageOps.pad(small, (width, height), color=_PAPER)
        self._pictures.append(np.asarray(small))
        return len(self._pictures) < _MOST

    def write(self, folder: Path) -> int:
        """End, write ``FILM`` into a folder, made if it isn't there, and forget the pictures; how many there were.

        Raises:
            InputError: If it can't be written; the pictures are kept.
        """
        self.running = False
        count = len(self._pictures)
        if count:
            write(self._pictures, folder / FILM)
        self._pictures = []
        return count
