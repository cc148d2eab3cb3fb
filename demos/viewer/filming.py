"""The button that films a window."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from .buttons import Button
from .plotted import Plotted
from .recording import FILM, Film


class Filming:
    """A film of the window, begun and ended by one button, and written to a folder; the scene's message tells of it."""

    def __init__(self, scene: Plotted, folder: Path, redraw: Callable[[], None]) -> None:
        self._scene, self._folder, self._redraw = scene, folder, redraw
        self.film = Film()

    def button(self) -> Button:
        """The button."""
        hint = f"begin to film the window; again: write {self._folder / FILM}"
        return Button("film", "f", hint, self._switch, lambda: self.film.running)

    def _switch(self) -> None:
        if self.film.running or self.film.pictures:
            self.finish()
        else:
            self.film.running = True

    def finish(self) -> None:
        """Write what was filmed; where that fails, it is tried again the next time."""
        self.film.running = False  # the message below isn't filmed
        self._scene.message = f"writing {self._folder / FILM} ..."
        self._redraw()
        count = self.film.write(self._folder)
        self._scene.message = f"{count} pictures in {self._folder / FILM}" if count else "nothing was filmed"

    def close(self) -> str:
        """Write it when the window is gone; what to tell of it, or nothing."""
        count = self.film.write(self._folder)
        return f"{self._folder / FILM}: {count} pictures" if count else ""
