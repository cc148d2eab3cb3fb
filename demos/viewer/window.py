"""The demo's window: sliders and keys that change the state, and a timer that plays."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

from ..body.template import LENGTH_NAMES, LOCKED_PARTS, PART_NAMES, THICKNESS_NAMES
from ..ellipsoid_passes import Gradient
from ..errors import InputError
from .scene import Scene
from .state import DRAWN_SIZES, DemoState, RendererName, Supervision
from .targets import PRESETS, RANDOM, body_of, target_of

_PER_PAGE = 6
_UNSEEN = ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow")
_FOREVER = 10**9  # ticks
_TICK = 15  # [ms] between a picture and the next step
_TURNING = tuple(name for k, name in enumerate(PART_NAMES) if k not in LOCKED_PARTS)
_AXES = ("x", "y", "z")
_HELP = (
    "space play / pause   n step   backspace to the start   F1-F4 start from a preset, F5 at random   t target\n"
    "c supervision   z z gradient   m renderer   g gradient   x size   o skeleton   [ ] sliders\n"
    ", . or a click choose a part   d save   q quit"
)

# A page of sliders: title, what one of them is called, and what it sets.
Slider = tuple[str, float, float, float, Callable[[float], None]]


class Window:
    """Sliders and keys around a scene.

    Args:
        state: What is played with.
        folder: Where ``d`` saves to; made when it does.
        off_screen: Without a window, for tests and ``profile``.

    Attributes:
        scene: What is shown.
        playing: Whether the timer steps.
        part: The part that the rotation sliders turn.

    Raises:
        InputError: If VTK can't draw here.
    """

    def __init__(self, state: DemoState, folder: Path, *, off_screen: bool = False) -> None:
        self.state, self.folder = state, folder
        self.scene = Scene(state, off_screen=off_screen, smooth=False)
        self.playing = False
        self.part = "left_upper_arm"
        self._page = 0
        self._target = 0
        self._seed = 0
        self._filling = True  # sliders call back when they are made and filled, too
        self.keys: dict[str, Callable[[], None]] = {
            "space": self._play,
            "n": self._step,
            "BackSpace": state.restart,
            "F5": self._random,
            "t": self._next_target,
            "c": lambda: self._cycle("supervision", get_args(Supervision)),
            "z": lambda: self._cycle("depth_gradient", (True, False)),
            "m": lambda: self._cycle("renderer", get_args(RendererName), again=False),
            "g": lambda: self._cycle("gradient", get_args(Gradient), again=False),
            "x": lambda: self._cycle("size", DRAWN_SIZES, again=False),
            "o": self._toggle_skeleton,
            "bracketleft": lambda: self._turn_page(-1),
            "bracketright": lambda: self._turn_page(1),
            "comma": lambda: self._next_part(-1),
            "period": lambda: self._next_part(1),
            "d": self._save,
        }
        for k, name in enumerate(PRESETS):
            self.keys[f"F{k + 1}"] = lambda name=name: state.reset(body_of(name))  # type: ignore[misc]
        plotter = self.scene.plotter
        for key in self.keys:
            plotter.add_key_event(key, lambda key=key: self.press(key))
        plotter.subplot(0, 0)
        plotter.add_text(_HELP, position=(16, 8), font_size=6, color="#5b6068", font="arial")
        self._widgets = [self._add_slider(k) for k in range(_PER_PAGE)]
        plotter.enable_mesh_picking(self._picked, use_actor=True, left_clicking=True, show=False, show_message=False)
        plotter.add_timer_event(max_steps=_FOREVER, duration=_TICK, callback=lambda _: self.tick())
        self._fill_page()

    def press(self, key: str) -> None:
        """What a key does; a fault becomes the message in the window."""
        self._try(self.keys[key])

    def slide(self, index: int, value: float) -> None:
        """Move a slider of the page, 0 first."""
        page = self.page()
        if index < len(page):
            self.playing = False
            self._try(lambda: page[index][-1](value))

    def pick(self, part: str) -> None:
        """Turn to the sliders of a part."""
        self.part = part if part in _TURNING else self.part
        self._page = self._num_pages() - 1
        self.scene.message = "" if part in _TURNING else f"{part.replace('_', ' ')} doesn't turn by itself"
        self.refresh()

    def tick(self) -> None:
        """A step, if it plays."""
        if self.playing:
            self._try(self.state.step)

    def refresh(self) -> None:
        """Draw the state as it is."""
        self._fill_page()
        self.scene.update()
        self.scene.plotter.render()

    def page(self) -> list[Slider]:
        """The sliders that are shown: title, smallest, largest, value, and what setting one does."""
        if self._page == self._num_pages() - 1:
            return self._rotation_page()
        body, sizes = self.state.body, []
        for field, names, set_size in (
            ("lengths", LENGTH_NAMES, self.state.set_length),
            ("thicknesses", THICKNESS_NAMES, self.state.set_thickness),
        ):
            low, high = self.state.bounds(field)
            for k, name in enumerate(names):
                bounds = 100 * float(low[0, k]), 100 * float(high[0, k])
                value = 100 * float(body.tensors()[field][0, k].detach())
                title = f"{name} length [cm]" if field == "lengths" else f"{name} [cm]"
                sizes.append((title, *bounds, value, _in_centimetres(set_size, name)))
        return sizes[_PER_PAGE * self._page : _PER_PAGE * (self._page + 1)]

    def _rotation_page(self) -> list[Slider]:
        index, prior = PART_NAMES.index(self.part), self.state.prior
        rotation = self.state.body.rotations[0, index].rad2deg().tolist()
        low, high = prior.lower_limits[index].rad2deg().tolist(), prior.upper_limits[index].rad2deg().tolist()
        return [
            (f"{self.part.replace('_', ' ')}, {_AXES[k]} [deg]", low[k], high[k], rotation[k], self._turn(k))
            for k in range(3)
        ]

    def _turn(self, axis: int) -> Callable[[float], None]:
        return lambda degrees: self.state.set_rotation(self.part, axis, math.radians(degrees))

    def _num_pages(self) -> int:
        return -(-(len(LENGTH_NAMES) + len(THICKNESS_NAMES)) // _PER_PAGE) + 1

    def _add_slider(self, index: int) -> Any:
        y = 0.85 - 0.075 * index
        widget = self.scene.plotter.add_slider_widget(
            lambda value: None if self._filling else self.slide(index, value),
            (0.0, 1.0),
            pointa=(0.02, y),
            pointb=(0.2, y),
            title=" ",
            title_height=0.014,
            fmt="%.1f",
            slider_width=0.02,
            tube_width=0.004,
            color="#22262b",
            interaction_event="always",
        )
        shown = widget.GetRepresentation()
        shown.SetLabelHeight(0.014)
        shown.SetEndCapLength(0.004)
        shown.SetEndCapWidth(0.012)
        shown.SetSliderWidth(0.012)
        return widget

    def _fill_page(self) -> None:
        """Give the sliders the page's titles, bounds and values."""
        self._filling = True
        page = self.page()
        for k, widget in enumerate(self._widgets):
            widget.SetEnabled(k < len(page))
            if k < len(page):
                title, low, high, value, _ = page[k]
                shown = widget.GetRepresentation()
                shown.SetTitleText(title)
                shown.SetMinimumValue(low)
                shown.SetMaximumValue(max(high, low + 1e-3))
                shown.SetValue(value)
        self._filling = False

    def _try(self, action: Callable[[], None]) -> None:
        self.scene.message = ""
        try:
            action()
        except InputError as error:
            self.playing = False
            self.scene.message = str(error)
        self.refresh()

    def _play(self) -> None:
        self.playing = not self.playing

    def _step(self) -> None:
        self.playing = False
        self.state.step()

    def _random(self) -> None:
        self._seed += 1
        self.state.reset(body_of(RANDOM, self._seed))

    def _next_target(self) -> None:
        names = (*PRESETS, RANDOM)
        self._target = (self._target + 1) % len(names)
        self._seed += 1
        self.state.aim(target_of(body_of(names[self._target], self._seed)))
        self.scene.message = f"target: {names[self._target]}"

    def _cycle(self, name: str, choices: tuple[Any, ...], *, again: bool = True) -> None:
        """The next choice of a setting; ``again``: from the start, so that runs can be compared."""
        now = choices.index(getattr(self.state.settings, name))
        self.state.configure(**{name: choices[(now + 1) % len(choices)]})
        if again:
            self.state.restart()

    def _toggle_skeleton(self) -> None:
        self.scene.skeleton_only = not self.scene.skeleton_only

    def _turn_page(self, by: int) -> None:
        self._page = (self._page + by) % self._num_pages()

    def _next_part(self, by: int) -> None:
        self.part = _TURNING[(_TURNING.index(self.part) + by) % len(_TURNING)]
        self._page = self._num_pages() - 1

    def _picked(self, actor: Any) -> None:
        if actor in self.scene.parts:
            self.pick(PART_NAMES[self.scene.parts.index(actor)])

    def _save(self) -> None:
        from PIL import Image

        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            for name in ("body.npz", "ellipbody.glb"):
                self.state.save(self.folder / name)
            Image.fromarray(self.scene.screenshot()).save(self.folder / "demo.png")
        except OSError as error:
            raise InputError(f"{self.folder}: {error.strerror or error}; expected a folder to write to") from error
        self.scene.message = f"saved body.npz, ellipbody.glb and demo.png in {self.folder}"

    def show(self) -> None:
        """Open the window, until it is closed.

        Raises:
            InputError: If there is no display for it.
        """
        kind = self.scene.plotter.render_window.GetClassName()
        if kind in _UNSEEN:  # what VTK falls back to without a word where it can't reach the display
            raise InputError(
                f"demo: the display can't be reached (VTK took {kind}); expected one, or --record out.gif or out.html, "
                "which need none"
            )
        self.scene.plotter.show(title="partdr demo")

    def profile(self, count: int = 30) -> dict[str, float]:
        """Median time from a change to its drawn picture, by what is changed [ms]."""
        title, low, high, _, _ = self.page()[0]
        values = [low + (high - low) * k / count for k in range(count)]
        self.slide(0, values[0])
        moved = [_time(lambda value=value: self.slide(0, value)) for value in values]  # type: ignore[misc]
        self.state.restart()
        self.playing = True
        stepped = [_time(self.tick) for _ in range(count)]
        self.playing = False
        return {f"slider {title}": statistics.median(moved), "iteration": statistics.median(stepped)}


def _in_centimetres(set_size: Callable[[str, float], None], name: str) -> Callable[[float], None]:
    return lambda value: set_size(name, value / 100)


def _time(action: Callable[[], None]) -> float:
    began = time.perf_counter()
    action()
    return (time.perf_counter() - began) * 1000
