"""Windows with controls and keys, and a timer that plays; each of the demo's is one."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Protocol

from ..errors import InputError
from .buttons import Button, Entry, Panel, Placed, Rows, Slider
from .plotted import PANEL, WINDOW, Look, Plotted
from .recording import Filming

_UNSEEN = ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow")
_TICK = 15  # [ms] between a picture and the next step
_FIRST = 1.0  # priority of an observer that comes before VTK's own, which are at 0 and widgets' at 0.5
_LARGEST = {False: 17, True: 12}  # [px] letters of the first screen, and of all controls
_LEAST = (320, 240)  # (width, height) of a picture [px]; smaller windows show its lower left part
# PyVista's, which would turn the view or swell lines; q takes a last picture for nobody before VTK's own q closes.
_PYVISTA_KEYS = ("v", "C", "b", "plus", "minus", "q")
_TURNS = ("RightButtonPressEvent", "MiddleButtonPressEvent", "MouseWheelForwardEvent", "MouseWheelBackwardEvent")
NOBODY = "Paused, because nobody looks. Press play to go on."


class Playing(Protocol):
    """State of something that plays or is still."""

    playing: bool


class ControlledWindow:
    """Controls and keys around a scene whose first view can be turned.

    Attributes:
        more: True while the window shows everything; False on the first screen.
        changed: Function that is called when there is something new to draw.
        tall: Height of the picture with everything on a phone, in its widths.
    """

    tall = 2.3

    def __init__(
        self, scene: Plotted, filming: Filming, keys: dict[str, Callable[[], None]], playing: Playing, *, more: bool
    ) -> None:
        """``keys``: what each does, by VTK's name; ``playing``: what a fault brings to a halt."""
        self.scene, self.keys, self.more = scene, keys, more
        self.changed: Callable[[], None] = lambda: None
        self._filming, self._playing, self._size = filming, playing, WINDOW
        self.panel = Panel(scene.view(PANEL))
        self._more = Button("more", "h", "renderers, gradients, sizes and all other controls", self.more_or_less)
        self._less = Button("less", "h", "back to the first screen", self.more_or_less)
        self._held: Placed | None = None  # the slider that is pulled
        plotter = scene.plotter
        self._interactor = plotter.iren.interactor
        for key in _PYVISTA_KEYS:
            plotter.clear_events_for_key(key)
        self.keys["h"] = self.more_or_less
        for key in keys:
            plotter.add_key_event(key, partial(self.press, key))
        plotter.subplot(0, 1)
        plotter.enable_terrain_style(mouse_wheel_zooms=True, shift_pans=True)  # people stay upright
        self._observe("LeftButtonPressEvent", self._clicked)
        self._observe("LeftButtonReleaseEvent", self._let_go)
        for event in _TURNS:
            self._observe(event, self._beside)
        self._observe("MouseMoveEvent", self._hovered)
        # Of VTK's own keys, which would draw all as wires or end the demo, only q stays.
        self._observe("CharEvent", lambda: self._interactor.GetKeySym() not in ("q", "Q"))
        # Instead of what the style does at a tick, which is to turn the view on and on while the mouse is held; nobody
        # but the style hears of it then. And not PyVista's timer, which draws at every tick.
        plotter.iren.style.AddObserver("TimerEvent", lambda *_: self._ticked())
        self._interactor.CreateRepeatingTimer(_TICK)

    def sentence(self) -> str:
        """One sentence that says what one sees and can do, or what has just happened."""
        raise NotImplementedError

    def first_row(self) -> list[Entry]:
        """Controls of the first screen."""
        raise NotImplementedError

    def all_rows(self) -> list[list[Entry]]:
        """Controls of the screen that shows everything."""
        raise NotImplementedError

    def rows(self, more: bool) -> tuple[Rows, Rows]:
        """Rows above and below the picture of a page: with everything, or those of the first screen."""
        if not more:
            return [[self.sentence()]], [[*self.first_row(), self._more]]
        first, *rows = self.all_rows()
        told = self.scene.message
        if self.panel.over is not None:
            told = self.panel.over.hint + (f" (key: {self.panel.over.key})" if self.panel.over.key else "")
        return [[self._less, *first]], [*([line] for line in self.scene.said()), *rows, [told or self.hint()]]

    def hint(self) -> str:
        """A line about the mouse."""
        return "Drag to turn, wheel to zoom, shift and drag to move; q closes. Point at a button for more."

    def more_or_less(self) -> None:
        """Turn to the other screen: of everything, or the first one."""
        self.more = not self.more

    def press(self, key: str) -> None:
        """Do what a key does; a fault becomes the message in the window."""
        self._try(self.keys[key])

    def click(self, button: Button) -> None:
        """Do what a button does; a fault becomes the message in the window."""
        self._try(button.do)

    def pull(self, slider: Slider, value: float) -> None:
        """Move a slider."""
        self._try(lambda: slider.set(min(max(value, slider.low), slider.high)))

    def tick(self) -> None:
        """Go on, if it plays."""
        raise NotImplementedError

    def pause(self) -> None:
        """Stop, for nobody looks, and say so; nothing where it doesn't play."""
        if self._playing.playing:
            self._playing.playing = False
            self.scene.message = NOBODY
            self.refresh()

    def refresh(self) -> None:
        """Draw the state as it is."""
        self._update()
        self.scene.plotter.render()
        self.changed()
        film = self._filming.film
        if film.running and not film.take(self.scene.screenshot()):
            self._try(self._filming.finish)

    def arrange(self, look: Look) -> None:
        """Show a screen in a size."""
        if look != self.scene.look_now:
            self.scene.arrange(look)
            self._paint()

    def _update(self) -> None:
        look = self.scene.look_now
        if look.controls:
            self.arrange(Look(look.size, self.more, controls=True))
        self.scene.update()
        self._paint()

    def _paint(self) -> bool:
        look = self.scene.look_now
        above, below = self.rows(look.more)
        return look.controls and self.panel.update([*above, *below], self.scene.panel, _LARGEST[look.more])

    def _ticked(self) -> None:
        """Follow the window's size, and go on."""
        width, height = self.scene.plotter.render_window.GetSize()
        look = self.scene.look_now
        size = max(width, _LEAST[0]), max(height, _LEAST[1])
        if look.controls and size != look.size:
            self.arrange(Look(size, self.more, controls=True))
            self.refresh()
        self.tick()

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

    def _pointed(self) -> Placed | None:
        """The button or slider under the mouse."""
        return self.panel.at(*self._interactor.GetEventPosition())

    def _clicked(self) -> bool:
        pointed = self._pointed()
        if pointed is None:
            return self._beside()
        if isinstance(pointed.entry, Button):
            self.click(pointed.entry)
        else:
            self._held = pointed
            self._pull_held()
        return True

    def _let_go(self) -> bool:
        held, self._held = self._held, None
        return held is not None

    def _pull_held(self) -> None:
        assert self._held is not None
        held, x = self._held, self._interactor.GetEventPosition()[0]
        self._try(lambda: self.panel.slide(held, x))

    def _beside(self) -> bool:
        """True if the mouse is not over the view that can be turned."""
        return not self.scene.body_view.IsInViewport(*self._interactor.GetEventPosition())

    def _hovered(self) -> bool:
        if self._held is not None:
            self._pull_held()
            return True
        pointed = self._pointed()
        self.panel.over = pointed.entry if pointed is not None and isinstance(pointed.entry, Button) else None
        if self._paint():
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
