"""Pictures of a scene's views: people as each camera sees them, over its film where that can be read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..inputs.film_reader import FilmReader
from ..results.film_overlays import draw_bodies, resized, zoomed_view
from ..results.load_film import FilmView
from .motion_state import MotionState
from .overlay import Overlay
from .style import INK, PAPER

_PLAIN = 232  # gray of a view without its film
_TITLE, _GAP, _MARGIN = 20, 6, 8  # [px]
_KEPT = 3  # sizes whose pictures of films are kept, for several pages may show them


@dataclass(frozen=True)
class _Box:
    """Place of a view's picture among the others [px]."""

    left: int
    top: int
    size: tuple[int, int]  # (H, W)


class ViewPictures:
    """All views side by side in a painted box."""

    def __init__(self, state: MotionState, overlay: Overlay, films: Sequence[Path | None]) -> None:
        """``films``: of each view."""
        self.state, self._overlay, self._films = state, overlay, films
        self.over_film = True
        self.boxes: list[_Box] = []
        self._readers: list[FilmReader | None] = []
        self._known: dict[tuple[int, int], tuple[list[_Box], list[FilmReader | None]]] = {}  # of the last sizes
        self.titles = [
            f"camera {number}" + (f"   {Path(view.film).name}" if view.film else "")
            for number, view in enumerate(state.saved.views, start=1)
        ]
        self.fault = ""  # a film that can't be read
        self._shown: tuple[object, ...] = ()

    def arrange(self, size: tuple[int, int]) -> None:
        """Place the pictures in a box of (width, height) pixels."""
        if size not in self._known:
            room = max(size[0] - 2 * _MARGIN, 1), max(size[1] - 2 * _MARGIN, 1)
            boxes = arrange([view.size for view in self.state.saved.views], room)
            free = room[1] - max(box.top + box.size[0] for box in boxes)
            boxes = [replace(box, top=box.top + max(free, 0) // 2) for box in boxes]
            readers: list[FilmReader | None] = []
            for view, box, film in zip(self.state.saved.views, boxes, self._films, strict=True):
                shrink = partial(_shrunk, view=view, size=box.size)
                readers.append(None if film is None or self.fault else FilmReader(film, shrink))
            if len(self._known) == _KEPT:
                del self._known[next(iter(self._known))]
            self._known[size] = boxes, readers
        self.boxes, self._readers = self._known[size]
        self._shown = ()

    def update(self) -> None:
        """Paint all views, if something is new."""
        now = self.state.frame, frozenset(self.state.hidden), self.over_film
        if now == self._shown:
            return
        self._shown, draw = now, self._overlay.draw
        for index, box in enumerate(self.boxes):
            picture = self.picture(index)  # first: it finds that a film can't be read
            title = self.titles[index] + ("" if self._readers[index] else "   without its film")
            left, top = box.left + _MARGIN, box.top + _MARGIN
            draw.rectangle((left, top - _TITLE, left + box.size[1], top - 1), fill=PAPER)
            draw.text((left, top - 6), _short(title, box.size[1], self._overlay.font), INK, self._overlay.font, "ls")
            self._overlay.paste(picture, (left, top))
        self._overlay.show()

    def picture(self, index: int) -> np.ndarray:
        """A view as it is now, RGB, (H, W, 3) of its box, uint8."""
        state, view, size = self.state, self.state.saved.views[index], self.boxes[index].size
        seen = zoomed_view(view.view, size[1] / view.size[1], size)
        people = {person: state.colour(person) for person in state.people}
        return draw_bodies(self._background(index), state.bodies(), state.saved.motions, seen, people)

    def _background(self, index: int) -> np.ndarray:
        reader, number = self._readers[index], self.state.saved.views[index].number(self.state.frame)
        if reader is not None and number is not None and self.over_film:
            try:
                return reader.picture(number)
            except InputError as error:
                self._readers[index] = None  # it is not tried at each frame
                self.fault = str(error)
        return np.full((*self.boxes[index].size, 3), _PLAIN, np.uint8)


def arrange(sizes: Sequence[tuple[int, int]], room: tuple[int, int]) -> list[_Box]:
    """Places of pictures (H, W) in rows and columns in which they are largest, within (width, height) [px]."""
    tallest = max(height / width for height, width in sizes)
    columns = max(range(1, len(sizes) + 1), key=lambda each: _width(len(sizes), each, tallest, room))
    widest = _width(len(sizes), columns, tallest, room)
    found = []
    for index, (height, width) in enumerate(sizes):
        row, column = divmod(index, columns)
        left, top = column * (widest + _GAP), _TITLE + row * (round(widest * tallest) + _TITLE + _GAP)
        found.append(_Box(left, top, (max(round(widest * height / width), 1), widest)))
    return found


def _short(title: str, width: float, font: Any) -> str:
    """The first words of a title, that are no wider than a picture [px]."""
    words = title.split()
    while len(words) > 1 and font.getlength(" ".join(words)) > width:
        words.pop()
    return " ".join(words)


def _width(count: int, columns: int, tallest: float, room: tuple[int, int]) -> int:
    """Width of each picture when there are several columns [px]."""
    rows = -(-count // columns)
    across = (room[0] - _GAP * (columns - 1)) / columns
    return max(int(min(across, ((room[1] - _GAP * (rows - 1)) / rows - _TITLE) / tallest)), 1)


def _shrunk(picture: np.ndarray, view: FilmView, size: tuple[int, int]) -> np.ndarray:
    if picture.shape[:2] != view.size:
        found, wanted = ("x".join(map(str, each[1::-1])) for each in (picture.shape, view.size))
        raise InputError(f"pictures of {found}; expected {wanted}, as were fitted")
    return resized(picture, size, view.lens)
