"""The window of a refinement: sliders, buttons and keys that change the state, and steps while it plays."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from ..body.template import PART_NAMES
from .buttons import Entry
from .controlled import ControlledWindow, median_time
from .controls import Controls
from .plotted import WINDOW, Look
from .scene import PlottedScene
from .settings import QUALITIES
from .sliders import Page, make_page
from .state import DemoState
from .tradeoff import Tradeoff, TradeoffTable

_RESTS = 0.25  # [s] without a change, after which the detailed body is registered
_FAR_FROM_END, _AT_ONCE = (
    60,
    3,
)  # first iterations of a run with the detailed body, and how many of them a picture shows
_PHOTO = "Press play: the {} body moves until it stands on the person in the photo."
_BODY = "Press play: the body moves until its labels cover those of the target behind it."


class Window(ControlledWindow):
    """Controls and keys around a scene; ``off_screen`` for a browser, tests and ``profile``.

    It begins with the first screen, or with everything if ``more``; ``detailed``: with the detailed body.
    """

    scene: PlottedScene

    def __init__(
        self,
        state: DemoState,
        folder: Path,
        *,
        off_screen: bool = False,
        seed: int = 0,
        more: bool = False,
        detailed: bool = False,
    ) -> None:
        self.state, self.folder = state, folder
        scene = PlottedScene(state, off_screen=off_screen, smooth=False)
        self.tradeoff = Tradeoff(state)
        self.controls = Controls(state, scene, folder, self.refresh, seed)
        scene.has_table = True
        self._table = TradeoffTable(scene.view("table"), self.tradeoff)
        self._moved, self._rests = 0.0, True  # when the body moved last, and whether it is drawn as well as it can be
        scene.smooth_edges(True)
        super().__init__(scene, self.controls.filming, self.controls.keys, self.controls, more=more)
        plotter = scene.plotter
        plotter.enable_mesh_picking(self._picked, use_actor=True, left_clicking=True, show=False, show_message=False)
        if detailed:
            self.controls.clothe()
            self.controls.settle()
            scene.message = ""
        self.tradeoff.update(measure=True)
        scene.arrange(Look(WINDOW, more, controls=True))
        self._update()

    def sentence(self) -> str:
        """One sentence that says what one sees and can do, or what has just happened."""
        if self.scene.message:
            return self.scene.message
        return (
            _BODY if self.state.target.photo is None else _PHOTO.format("grey" if self.scene.detailed else "coloured")
        )

    def first_row(self) -> list[Entry]:
        """Play and three sliders."""
        return [self.controls.play, *self.controls.first_sliders()]

    def all_rows(self) -> list[list[Entry]]:
        """Buttons, then the sliders of the page."""
        page = self.page()
        return [*self.controls.rows, [page.title], [*page.sliders]]

    def slide(self, index: int, value: float) -> None:
        """Move a slider of the page, 0 first."""
        self.controls.playing = False
        self._try(lambda: self.page().sliders[index].set(value), measure=False)

    def tick(self) -> None:
        """A step, if it plays, until it has converged; what was told last can still be read meanwhile.

        At rest, the detailed body is registered.
        """
        if self.controls.playing:
            self._try(self._go_on, clear=False)
        elif not self._rests and time.perf_counter() - self._moved > _RESTS:
            self._rests = True
            self.scene.smooth_edges(True)
            self.controls.settle()
            self.refresh()

    def _stir(self) -> None:
        """Draw fast, until there is rest again."""
        self._moved, self._rests = time.perf_counter(), False
        self.scene.smooth_edges(False)

    def _clicked(self) -> bool:
        self._stir()
        return super()._clicked()

    def _go_on(self) -> None:
        hurry = self.scene.detailed and len(self.state.history) < _FAR_FROM_END
        for _ in range(_AT_ONCE if hurry else 1):
            self.state.step()
        if self.state.converged:
            self.controls.playing = False
            count = len(self.state.history)
            self.scene.message = f"Done: it stopped by itself after {count} iterations; more make it hardly better."

    def page(self) -> Page:
        """The sliders that are shown."""
        return make_page(self.state, self.controls.part, self.controls.page)

    def _update(self) -> None:
        shown_part = self.controls.is_open("part") and self.scene.look_now.more
        self.scene.chosen = self.controls.part if shown_part else None
        super()._update()

    def _paint(self) -> bool:
        self._table.update()
        return super()._paint()

    def _try(self, action: Callable[[], None], *, clear: bool = True, measure: bool = True) -> None:
        def measured() -> None:
            self._stir()
            action()
            self.tradeoff.update(measure=measure)

        super()._try(measured, clear=clear)

    def _picked(self, actor: Any) -> None:
        """Turn to the sliders of a part that was clicked on."""
        if actor in self.scene.parts:
            part = PART_NAMES[self.scene.parts.index(actor)]
            self._try(partial(self.controls.pick, part), measure=False)

    def profile(self, count: int = 30) -> dict[str, float]:
        """Median time from a change to its drawn picture, by what is changed [ms]."""
        self.scene.screenshot()  # until there is a first picture, PyVista draws none
        took = {}
        for kind in ("lengths", "camera", "part"):
            self.controls.open(kind)
            title, low, high, _, _ = self.page().sliders[0]
            values = [low + (high - low) * k / count for k in range(count + 1)]
            took[f"slider {title}"] = median_time([partial(self.slide, 0, value) for value in values])
        self.state.restart()
        self.controls.playing = True
        took["iteration"] = median_time([self.tick] * count)
        self.controls.playing = False
        took["quality"] = median_time([partial(self.press, f"F{6 + k}") for k in range(len(QUALITIES))] * 3)
        return took
