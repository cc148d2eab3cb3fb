"""The demo's window: sliders, buttons and keys that change the state, and a timer that plays."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from ..body.template import PART_NAMES
from ..errors import InputError
from .buttons import Button, Panel
from .controls import Controls
from .recording import FILM
from .scene import PlottedScene
from .settings import QUALITIES
from .sliders import Page, SliderColumn, make_page
from .state import DemoState
from .tradeoff import Tradeoff, TradeoffTable

_UNSEEN = ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow")
_TICK = 15  # [ms] between a picture and the next step
_FIRST = 1.0  # priority of an observer that comes before VTK's own, which are at 0 and widgets' at 0.5
# PyVista's, which would turn the view or swell lines; q takes a last picture for nobody before VTK's own q closes.
_PYVISTA_KEYS = ("v", "C", "b", "plus", "minus", "q")
_TURNS = ("RightButtonPressEvent", "MiddleButtonPressEvent", "MouseWheelForwardEvent", "MouseWheelBackwardEvent")


class Window:
    """Sliders, buttons and keys around a scene; ``off_screen`` for a browser, tests and ``profile``."""

    def __init__(self, state: DemoState, folder: Path, *, off_screen: bool = False, seed: int = 0) -> None:
        self.state, self.folder = state, folder
        self.scene = PlottedScene(state, off_screen=off_screen, smooth=False)
        self.tradeoff = Tradeoff(state)
        self.controls = Controls(state, self.scene, folder, self.refresh, seed)
        self.keys = self.controls.keys
        plotter = self.scene.plotter
        self._interactor = plotter.iren.interactor
        for key in _PYVISTA_KEYS:
            plotter.clear_events_for_key(key)
        for key in self.keys:
            plotter.add_key_event(key, partial(self.press, key))
        plotter.subplot(0, 0)
        self.controls.look()
        self._sliders = SliderColumn(plotter, self.slide)
        self.panel = Panel(plotter.renderer, self.controls.rows)
        plotter.subplot(2, 2)
        self.scene.chart.size = (0.4, 0.95)
        self._table = TradeoffTable(plotter.renderer, self.tradeoff)
        plotter.subplot(0, 0)
        plotter.enable_terrain_style(mouse_wheel_zooms=True, shift_pans=True)  # people stay upright
        plotter.enable_mesh_picking(self._picked, use_actor=True, left_clicking=True, show=False, show_message=False)
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
        self.tradeoff.update(measure=True)
        self._update()

    def press(self, key: str) -> None:
        """Do what a key does; a fault becomes the message in the window."""
        self._try(self.keys[key])

    def click(self, button: Button) -> None:
        """Do what a button does; the same."""
        self._try(button.do)

    def slide(self, index: int, value: float) -> None:
        """Move a slider of the page, 0 first."""
        self.controls.playing = False
        self._try(lambda: self.page().sliders[index].set(value), measure=False)

    def tick(self) -> None:
        """A step, if it plays; what was told last can still be read meanwhile."""
        if self.controls.playing:
            self._try(self.state.step, clear=False)

    def refresh(self) -> None:
        """Draw the state as it is."""
        self._update()
        self.scene.plotter.render()
        film = self.controls.film
        if film.running and not film.take(self.scene.screenshot()):
            self._try(self.controls.finish_film, measure=False)

    def page(self) -> Page:
        """The sliders that are shown."""
        return make_page(self.state, self.controls.part, self.controls.page)

    def _update(self) -> None:
        self._sliders.show(self.page())
        self.scene.chosen = self.controls.part if self.controls.is_open("part") else None
        self.scene.update()
        self.panel.update()
        self._table.update()

    def _try(self, action: Callable[[], None], *, measure: bool = True, clear: bool = True) -> None:
        if clear:
            self.scene.message = ""
        try:
            action()
            self.tradeoff.update(measure=measure)
        except InputError as error:
            self.controls.playing = False
            self.scene.message = str(error)
        self.refresh()

    def _picked(self, actor: Any) -> None:
        """Turn to the sliders of a part that was clicked on."""
        if actor in self.scene.parts:
            part = PART_NAMES[self.scene.parts.index(actor)]
            self._try(partial(self.controls.pick, part), measure=False)

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
        count = self.controls.film.write(self.folder)
        return f"{self.folder / FILM}: {count} pictures" if count else ""

    def profile(self, count: int = 30) -> dict[str, float]:
        """Median time from a change to its drawn picture, by what is changed [ms]."""
        self.scene.screenshot()  # until there is a first picture, PyVista draws none
        took = {}
        for kind in ("lengths", "camera", "part"):
            self.controls.open(kind)
            title, low, high, _, _ = self.page().sliders[0]
            values = [low + (high - low) * k / count for k in range(count + 1)]
            took[f"slider {title}"] = _median([partial(self.slide, 0, value) for value in values])
        self.state.restart()
        self.controls.playing = True
        took["iteration"] = _median([self.tick] * count)
        self.controls.playing = False
        took["quality"] = _median([partial(self.press, f"F{6 + k}") for k in range(len(QUALITIES))] * 3)
        return took


def _median(actions: Sequence[Callable[[], None]]) -> float:
    """Median time of an action [ms]."""
    times = []
    for action in actions:
        began = time.perf_counter()
        action()
        times.append((time.perf_counter() - began) * 1000)
    return statistics.median(times)
