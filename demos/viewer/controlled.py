"""Windows with buttons and keys, and a timer that plays; each of the demo's is one."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Protocol

from ..errors import InputError
from .buttons import Button, Panel
from .plotted import Plotted
from .recording import Filming

_UNSEEN = ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow")
_TICK = 15  # [ms] between a picture and the next step
_FIRST = 1.0  # priority of an observer that comes before VTK's own, which are at 0 and widgets' at 0.5
# PyVista's, which would turn the view or swell lines; q takes a last picture for nobody before VTK's own q closes.
_PYVISTA_KEYS = ("v", "C", "b", "plus", "minus", "q")
_TURNS = ("RightButtonPressEvent", "MiddleButtonPressEvent", "MouseWheelForwardEvent", "MouseWheelBackwardEvent")


class Playing(Protocol):
    """State of something that plays or is still."""

    playing: bool


class ControlledWindow:
    """Buttons and keys around a scene whose first view can be turned."""

    def __init__(
        self, scene: Plotted, filming: Filming, panel: Panel, keys: dict[str, Callable[[], None]], playing: Playing
    ) -> None:
        """``keys``: what each does, by VTK's name; ``playing``: what a fault brings to a halt."""
        self.scene, self.panel, self.keys = scene, panel, keys
        self._filming, self._playing = filming, playing
        plotter = scene.plotter
        self._interactor = plotter.iren.interactor
        for key in _PYVISTA_KEYS:
            plotter.clear_events_for_key(key)
        for key in keys:
            plotter.add_key_event(key, partial(self.press, key))
        plotter.subplot(0, 0)
        plotter.enable_terrain_style(mouse_wheel_zooms=True, shift_pans=True)  # people stay upright
        self._observe("LeftButtonPressEvent", self._clicked)
        for event in _TURNS:
            self._observe(event, self._beside)
        self._observe("MouseMoveEvent", self._hovered)
        # Of VTK's own keys, which would draw all as wires or end the demo, only q stays.
        self._observe("CharEvent", lambda: self._interactor.GetKeySym() not in ("q", "Q"))
        # Instead of what the style does at a tick, which is to turn the view on and on while the mouse is held; nobody
        # but the style hears of it then. And not PyVista's timer, which draws at every tick.
        plotter.iren.style.AddObserver("TimerEvent", lambda *_: self.tick())
        self._interactor.CreateRepeatingTimer(_TICK)

    def press(self, key: str) -> None:
        """Do what a key does; a fault becomes the message in the window."""
        self._try(self.keys[key])

    def click(self, button: Button) -> None:
        """Do what a button does; a fault becomes the message in the window."""
        self._try(button.do)

    def tick(self) -> None:
        """Go on, if it plays."""
        raise NotImplementedError

    def refresh(self) -> None:
        """Draw the state as it is."""
        self._update()
        self.scene.plotter.render()
        film = self._filming.film
        if film.running and not film.take(self.scene.screenshot()):
            self._try(self._filming.finish)

    def _update(self) -> None:
        self.scene.update()
        self.panel.update()

    def _try(self, action: Callable[[], None], *, clear: bool = True) -> None:
        """Act and draw; ``clear``: forget what was told last."""
        if clear:
            self.scene.message = ""
        try:
            action()
        except InputError as error:
            self._playing.playing = False
            self.scene.message = str(error)
        self.refresh()

    def _observe(self, event: str, act: Callable[[], bool]) -> None:
        """Do something before VTK does; where ``act`` says True, nobody else hears of the event."""

        def heard(*_: Any) -> None:
            self._interactor.GetCommand(tag).SetAbortFlag(act())

        tag = self._interactor.AddObserver(event, heard, _FIRST)

    def _pointed(self) -> Button | None:
        """The button under the mouse."""
        return self.panel.at(*self._interactor.GetEventPosition())

    def _clicked(self) -> bool:
        if button := self._pointed():
            self.click(button)
        return button is not None or self._beside()

    def _beside(self) -> bool:
        """True if the mouse is over the pictures at the right, which aren't there to be turned."""
        return not self.scene.plotter.renderers[0].IsInViewport(*self._interactor.GetEventPosition())

    def _hovered(self) -> bool:
        self.panel.over = self._pointed()
        if self.panel.update():
            self.scene.plotter.render()
        return False

    def show(self) -> None:
        """Open the window, until it is closed; an InputError if there is no display for it."""
        # What VTK falls back to without a word where it can't reach the display.
        if (kind := self.scene.plotter.render_window.GetClassName()) in _UNSEEN:
            raise InputError(
                f"demo: the display can't be reached (VTK took {kind}); expected one, or --record out.gif or out.html, "
                "which need none"
            )
        self.scene.plotter.show(title="partdr demo")

    def finish(self) -> str:
        """Write what was filmed when the window is gone; what to tell of it, or nothing."""
        return self._filming.close()

    def profile(self, count: int = 30) -> dict[str, float]:
        """Median time from a change to its drawn picture, by what is changed ``count`` times [ms]."""
        raise NotImplementedError


def median_time(actions: Sequence[Callable[[], None]]) -> float:
    """Median time of an action [ms]."""
    times = []
    for action in actions:
        began = time.perf_counter()
        action()
        times.append((time.perf_counter() - began) * 1000)
    return statistics.median(times)
