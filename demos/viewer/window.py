"""The window of a refinement: sliders, buttons and keys that change the state, and steps while it plays."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from ..body.template import PART_NAMES
from .buttons import Panel
from .controlled import ControlledWindow, median_time
from .controls import Controls
from .scene import PlottedScene
from .settings import QUALITIES
from .sliders import Page, SliderColumn, make_page
from .state import DemoState
from .tradeoff import Tradeoff, TradeoffTable

_HINT = "Drag to turn the body, wheel to zoom, click on a part for its sliders; q closes. Point at a button for more."


class Window(ControlledWindow):
    """Sliders, buttons and keys around a scene; ``off_screen`` for a browser, tests and ``profile``."""

    scene: PlottedScene

    def __init__(self, state: DemoState, folder: Path, *, off_screen: bool = False, seed: int = 0) -> None:
        self.state, self.folder = state, folder
        scene = PlottedScene(state, off_screen=off_screen, smooth=False)
        self.tradeoff = Tradeoff(state)
        self.controls = Controls(state, scene, folder, self.refresh, seed)
        plotter = scene.plotter
        plotter.subplot(0, 0)
        self.controls.look()
        self._sliders = SliderColumn(plotter, self.slide)
        panel = Panel(plotter.renderer, self.controls.rows, _HINT)
        plotter.subplot(2, 2)
        scene.chart.size = (0.4, 0.95)
        self._table = TradeoffTable(plotter.renderer, self.tradeoff)
        super().__init__(scene, self.controls.filming, panel, self.controls.keys, self.controls)
        plotter.enable_mesh_picking(self._picked, use_actor=True, left_clicking=True, show=False, show_message=False)
        self.tradeoff.update(measure=True)
        self._update()

    def slide(self, index: int, value: float) -> None:
        """Move a slider of the page, 0 first."""
        self.controls.playing = False
        self._try(lambda: self.page().sliders[index].set(value), measure=False)

    def tick(self) -> None:
        """A step, if it plays; what was told last can still be read meanwhile."""
        if self.controls.playing:
            self._try(self.state.step, clear=False)

    def page(self) -> Page:
        """The sliders that are shown."""
        return make_page(self.state, self.controls.part, self.controls.page)

    def _update(self) -> None:
        self._sliders.show(self.page())
        self.scene.chosen = self.controls.part if self.controls.is_open("part") else None
        super()._update()
        self._table.update()

    def _try(self, action: Callable[[], None], *, clear: bool = True, measure: bool = True) -> None:
        def measured() -> None:
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
