"""Recordings of a refinement, a scene or the window, with its button: a GIF, an MP4, or a page that holds pictures."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Sequence
from importlib.util import find_spec
from itertools import chain, repeat
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image, ImageColor, ImageOps

from ..errors import InputError
from ..files.html_pages import data_address
from ..results.film_file import write_film
from .buttons import Button
from .plotted import Plotted
from .style import PAPER

if TYPE_CHECKING:
    from .scene import PlottedScene

_PAUSE = 12  # times the last picture is shown at the end
RATE = 12.5  # pictures a second
_GRAY = 8  # range of a pixel's channels up to which it is gray
_PLAIN = 5000  # pixels that stand for gray ones, white and black in a palette

FILM = "demo.gif"
MOST = 400  # pictures of a film, of 0.8 MB each
_WIDEST = 640  # [px] of a film


def frames(scene: PlottedScene, steps: int) -> Iterator[np.ndarray]:
    """The start, then a picture after each two steps, and the last: RGB, (height, width, 3), uint8.

    In the last one, a detailed body that is shown is registered, if the refinement has settled.
    """
    scene.update()
    yield scene.screenshot()
    for done in range(1, steps + 1):
        scene.state.step()
        if done % 2 == 0 or done == steps:
            if done == steps and scene.skin is not None and scene.state.settled:
                scene.skin.register(scene.state.placed, fitted=scene.state.target.truth is None)
            scene.update()
            yield scene.screenshot()


def check_format(path: Path) -> None:
    """Raise InputError unless ``write`` can write such a file here."""
    if path.suffix not in _WRITERS:
        raise InputError(f"--record: {path}; expected a name that ends with {', '.join(_WRITERS)}")
    if not path.absolute().parent.is_dir():
        raise InputError(f"--record: {path}; expected a file in a folder that is there")
    if path.suffix == ".mp4" and find_spec("av") is None:
        raise InputError(
            "--record: .mp4 without PyAV; expected it (pip install av), or .gif or .html, which need nothing more"
        )


def write(pictures: Sequence[np.ndarray], path: Path, rate: float = RATE) -> None:
    """Write pictures as the file's name says, so many a second; an InputError if it can't be written.

    They are taken one at a time, so that they may be drawn then.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _WRITERS[path.suffix](pictures, path, rate)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}; expected a file that can be written") from error


class Film:
    """Small pictures of the window, one after each change, while it runs."""

    def __init__(self) -> None:
        self.running = False
        self.pictures: list[np.ndarray] = []  # that are still to be written

    def take(self, picture: np.ndarray) -> bool:
        """Keep a picture, RGB, shape (height, width, 3), uint8; whether there is room for more.

        It is made smaller by a whole number. Where the window has another size now, it is fitted into the first one's.
        """
        small = Image.fromarray(picture).reduce(-(-picture.shape[1] // _WIDEST))
        if self.pictures:
            height, width = self.pictures[0].shape[:2]
            small = ImageOps.pad(small, (width, height), color=PAPER)
        self.pictures.append(np.asarray(small))
        return len(self.pictures) < MOST

    def write(self, folder: Path) -> int:
        """End, write ``FILM`` into a folder and forget the pictures, unless that fails; returns how many there were."""
        self.running = False
        if count := len(self.pictures):
            write(self.pictures, folder / FILM)
        self.pictures = []
        return count


def _write_gif(pictures: Sequence[np.ndarray], path: Path, rate: float) -> None:
    """All pictures share one palette, so that no colour flickers; the paper, most of a picture, gets little of it."""
    some = np.concatenate([pictures[0], pictures[len(pictures) // 2], pictures[-1]]).reshape(-1, 3)
    coloured = some[np.ptp(some, axis=1) > _GRAY]
    shown = np.concatenate([coloured, some[:: max(len(some) // _PLAIN, 1)]])
    palette = Image.fromarray(shown[None]).quantize(255, kmeans=1)
    palette.putpalette([*(palette.getpalette() or [])[: 3 * 255], *ImageColor.getrgb(PAPER)])
    images = (Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures)
    durations = [round(1000 / rate)] * (len(pictures) - 1) + [round(1000 / rate * _PAUSE)]
    next(images).save(path, save_all=True, append_images=images, duration=durations, loop=0, optimize=False)


def _write_mp4(pictures: Sequence[np.ndarray], path: Path, rate: float) -> None:
    write_film(path, chain(pictures, repeat(pictures[-1], _PAUSE)), rate)


def _write_html(pictures: Sequence[np.ndarray], path: Path, rate: float) -> None:
    sources = []
    for picture in pictures:
        Image.fromarray(picture).save(file := io.BytesIO(), "webp", quality=80)
        sources.append(f'"{data_address(file.getvalue(), "webp")}"')
    page = _PAGE.replace("PAUSE", str(round(1000 / rate))).replace("PAPER", PAPER)
    path.write_text(page.replace("SOURCES", ",\n".join(sources)))  # last: pictures may hold any letters


_PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<title>partdr demo</title>
<style>
body { margin: 1em auto; max-width: 1280px; font: 15px sans-serif; background: PAPER; }
img { width: 100%; } input { width: 80%; vertical-align: middle; }
</style>
<img id="picture" alt="the recording">
<p><button id="play">pause</button> <input id="place" type="range" min="0" value="0"></p>
<script>
const pictures = [
SOURCES
];
const last = place.max = pictures.length - 1;
let playing = true;
const show = index => { place.value = index; picture.src = pictures[index]; };
const set = now => { playing = now; play.textContent = now ? "pause" : "play"; };
play.onclick = () => { if (!playing && +place.value === last) show(0); set(!playing); };
place.oninput = () => { set(false); show(+place.value); };
setInterval(() => { if (playing) +place.value === last ? set(false) : show(+place.value + 1); }, PAUSE);
show(0);
</script>
</html>
"""

_WRITERS: dict[str, Callable[[Sequence[np.ndarray], Path, float], None]] = {
    ".gif": _write_gif,
    ".mp4": _write_mp4,
    ".html": _write_html,
}


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
