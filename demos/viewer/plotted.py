"""Plotters of the demo: how one is opened, how its views are arranged, and what each of its pictures has."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from ..errors import InputError
from .style import INK, PAPER

WINDOW = (1280, 800)  # [px]
PANEL = "panel"  # name of the view that buttons are painted in
_LETTER = (5, 13)  # [px] smallest and largest letters of titles


class Look(NamedTuple):
    """A picture that somebody looks at: its size, the first screen or everything, and the place of the controls."""

    size: tuple[int, int]  # (width, height) [px]
    more: bool = False  # True: everything; False: the first screen
    controls: bool = False  # True: buttons are painted in the picture; False: they are elsewhere, as in a browser
    zoom: float = 1.0  # pixels of the picture a pixel that letters are measured in; 2 on a fine screen


class Box(NamedTuple):
    """Place of a view in the picture [px], y down."""

    left: int
    top: int
    width: int
    height: int


class Plotted:
    """A plotter whose picture follows a state; ``update`` looks at the state again.

    ``names`` are those of its views. ``smooth`` outlines (multisampling) without a GPU take four times as long. An
    InputError says that VTK can't draw.
    """

    message = ""  # what is told last, such as an error

    def __init__(self, names: Sequence[str], *, off_screen: bool, smooth: bool) -> None:
        views = ["ground", *names, PANEL]  # the first one is empty and lies under the others
        try:
            self._pv = pv = import_module("pyvista")
            logger = import_module("vtkmodules.vtkCommonCore").vtkLogger
            logger.SetStderrVerbosity(logger.VERBOSITY_ERROR)  # it tells of each display that it tries in vain
            self.plotter = pv.Plotter(
                off_screen=off_screen, window_size=list(WINDOW), border=False, shape=(1, len(views))
            )
        except (ImportError, RuntimeError, OSError) as error:  # a VTK without libGL, or without a display to open
            reason = " ".join(str(error).split())[:120]
            raise InputError(
                f"demo: VTK can't draw here ({reason}); expected OpenGL: with a display (Debian's libgl1) or without "
                "(libegl1 or libosmesa6); partdr fit needs neither"
            ) from error
        self.plotter.render_window.SetMultiSamples(8 if smooth else 0)
        self.plotter.set_background(PAPER)
        self._views = {name: index for index, name in enumerate(views)}
        self._titles: dict[str, tuple[Any, int]] = {}  # of a view: its text, and how many letters it has
        self.look_now = Look(WINDOW, more=True)
        self.panel = Box(0, 0, 0, 0)  # where controls are painted

    def _open(self, name: str) -> None:
        """Make a view the one that shapes are added to."""
        self.plotter.subplot(0, self._views[name])

    def view(self, name: str) -> Any:
        """The renderer of a view."""
        return self.plotter.renderers[self._views[name]]

    @property
    def body_view(self) -> Any:
        """The renderer of the view that can be turned."""
        return self.plotter.renderers[1]

    def arrange(self, look: Look) -> None:
        """Give the picture a size, and each view its place; views without a place aren't drawn."""
        width, height = look.size
        if tuple(self.plotter.render_window.GetSize()) != look.size:
            self.plotter.render_window.SetSize(width, height)
        self.look_now, boxes = look, self._places(look)
        self.panel = boxes.get(PANEL, Box(0, 0, 0, 0))
        for name in self._views:
            box = Box(0, 0, width, height) if name == "ground" else boxes.get(name)
            shown, view = box is not None and min(box.width, box.height) > 0, self.view(name)
            view.SetDraw(shown)
            if not shown or box is None:
                continue
            top, bottom = 1 - box.top / height, 1 - (box.top + box.height) / height
            view.SetViewport(box.left / width, max(bottom, 0.0), (box.left + box.width) / width, top)
            if name in self._titles:
                text, letters = self._titles[name]
                text.prop.font_size = int(np.clip(1.9 * box.width / letters, _LETTER[0], _LETTER[1] * look.zoom))
        self._arranged(boxes)

    def _places(self, look: Look) -> Mapping[str, Box]:
        """Places of the views that are shown."""
        raise NotImplementedError

    def _arranged(self, boxes: Mapping[str, Box]) -> None:
        """Do what views need when they have another size."""

    def _add(self, shape: Any, **look: Any) -> Any:
        """A shape in the active view; its actor."""
        return self.plotter.add_mesh(shape, render=False, **look)

    def _add_title(self, name: str, title: str) -> None:
        """A line at the lower left of a view."""
        self._open(name)
        text = self.plotter.add_text(title, position=(4, 3), font_size=8, color=INK, font="arial")
        self._titles[name] = text, len(title)

    def said(self) -> list[str]:
        """Lines that describe the state on the screen that shows everything."""
        raise NotImplementedError

    def look(self) -> None:
        """See all in 3D as at first."""
        raise NotImplementedError

    def update(self) -> None:
        """Bring everything to what the state is now; nothing is drawn yet."""
        raise NotImplementedError

    def screenshot(self) -> np.ndarray:
        """The picture as it is now, RGB, shape (height, width, 3), uint8."""
        if self.plotter.suppress_rendering:  # in a browser, where else only what is sent is drawn
            self.plotter.render_window.Render()
        else:
            self.plotter.render()
        return np.asarray(self.plotter.screenshot(return_img=True))

    def close(self) -> None:
        """Give the window and VTK's memory back."""
        self.plotter.close()


def halves(picture: Box, share: float) -> tuple[Box, Box]:
    """Two boxes in one, side by side in a wide one and one over the other in a tall one; see ``split``."""
    return split(picture, share, wide=picture.width >= picture.height)


def split(picture: Box, share: float, *, wide: bool) -> tuple[Box, Box]:
    """Two boxes in one, side by side if ``wide``, else one over the other; the first has a share of it."""
    left, top, width, height = picture
    if wide:
        first = round(share * width)
        return Box(left, top, first, height), Box(left + first, top, width - first, height)
    first = round(share * height)
    return Box(left, top, width, first), Box(left, top + first, width, height - first)


def controls_beside(look: Look, column: int, strip: int) -> tuple[Box, Box]:
    """Box of the views and box of the controls, both of which fill the picture.

    With more than the first screen, controls are a column at the left, ``column`` px wide; else they are a strip at the
    bottom, ``strip`` px high. In a small window, they are at most half of it.
    """
    width, height = look.size
    if not look.controls:
        return Box(0, 0, width, height), Box(0, 0, 0, 0)
    if look.more:
        taken = min(column, width // 2)
        return Box(taken, 0, width - taken, height), Box(0, 0, taken, height)
    taken = min(strip, height // 2)
    return Box(0, 0, width, height - taken), Box(0, height - taken, width, taken)
