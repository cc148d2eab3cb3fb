"""Plotters of the demo: how one is opened, and what each of its pictures has."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np

from ..errors import InputError
from .style import INK, PAPER

_WINDOW = (1280, 800)  # [px]


class Plotted:
    """A plotter whose picture follows a state; ``update`` looks at the state again.

    ``smooth`` outlines (multisampling) without a GPU take four times as long; ``layout`` is PyVista's of the views. An
    InputError says that VTK can't draw.
    """

    def __init__(self, *, off_screen: bool, smooth: bool, **layout: Any) -> None:
        try:
            self._pv = pv = import_module("pyvista")
            logger = import_module("vtkmodules.vtkCommonCore").vtkLogger
            logger.SetStderrVerbosity(logger.VERBOSITY_ERROR)  # it tells of each display that it tries in vain
            self.plotter = pv.Plotter(off_screen=off_screen, window_size=list(_WINDOW), border=False, **layout)
        except (ImportError, RuntimeError, OSError) as error:  # a VTK without libGL, or without a display to open
            reason = " ".join(str(error).split())[:120]
            raise InputError(
                f"demo: VTK can't draw here ({reason}); expected OpenGL: with a display (Debian's libgl1) or without "
                "(libegl1 or libosmesa6); partdr fit needs neither"
            ) from error
        self.plotter.render_window.SetMultiSamples(8 if smooth else 0)
        self.plotter.set_background(PAPER)
        self.message = ""  # a line below the status, such as an error

    def _add(self, shape: Any, **look: Any) -> Any:
        """A shape in the active view; its actor."""
        return self.plotter.add_mesh(shape, render=False, **look)

    def _add_status(self) -> Any:
        """Lines of text in the active view's upper left."""
        status = self.plotter.add_text("", position=(0.025, 0.985), viewport=True, font_size=9, color=INK, font="arial")
        status.prop.SetVerticalJustificationToTop()
        return status

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
