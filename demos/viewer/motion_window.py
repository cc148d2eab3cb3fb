"""The window of a fitted film: a slider through time, buttons and keys, and frames that pass while it plays."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from .buttons import Button, Panel, flip
from .controlled import ControlledWindow, median_time
from .motion_scene import VIEW, PlottedMotion
from .motion_state import SPEEDS, MotionState
from .recording import Filming
from .sliders import add_slider

_HINT = "Drag to turn the scene, wheel to zoom, shift and drag to move it; q closes. Point at a button for more."
_ROWS_OF_PEOPLE, _IN_A_ROW = 2, 8  # people with a button of their own
_SLIDER = 44  # [px] above the buttons
_LONGEST = 0.25  # [s] that may pass between two pictures; what takes longer, such as a menu, is no part of the film


class MotionWindow(ControlledWindow):
    """Buttons, keys and a slider around people who move; ``off_screen`` for a browser, tests and ``profile``."""

    scene: PlottedMotion

    def __init__(
        self, state: MotionState, films: Sequence[Path | None], folder: Path, *, off_screen: bool = False
    ) -> None:
        self.state, self.folder = state, folder
        people = -(-min(len(state.people), _ROWS_OF_PEOPLE * _IN_A_ROW) // _IN_A_ROW)
        controls = Panel.height_of(3 + people) + _SLIDER
        scene = PlottedMotion(state, films, controls=controls, off_screen=off_screen, smooth=False)
        filming = Filming(scene, folder, self.refresh)
        self._clock = time.perf_counter()
        rows, keys = self._rows(scene, filming)
        scene.plotter.subplot(0, 0)
        height = (Panel.height_of(len(rows)) + _SLIDER / 2) / VIEW[1]
        self._slider = add_slider(scene.plotter, lambda value: None, (0.03, 0.97), height, "%.0f")
        shown = self._slider.GetRepresentation()
        shown.SetSliderLength(0.012)
        shown.SetMinimumValue(0)
        shown.SetMaximumValue(max(state.count - 1, 1))
        self._slider.AddObserver("InteractionEvent", lambda *_: self.slide(shown.GetValue()))
        panel = Panel(scene.plotter.renderer, rows, _HINT, VIEW)
        keys |= {entry.key: entry.do for row in rows for entry in row if isinstance(entry, Button) and entry.key}
        super().__init__(scene, filming, panel, keys, state)
        self._update()

    def _rows(
        self, scene: PlottedMotion, filming: Filming
    ) -> tuple[list[list[Button | str]], dict[str, Callable[[], None]]]:
        state = self.state
        buttons: list[Button | str] = [self._person(person) for person in state.people]
        shown = [buttons[start : start + _IN_A_ROW] for start in range(0, len(buttons), _IN_A_ROW)][:_ROWS_OF_PEOPLE]
        rows: list[list[Button | str]] = [
            [
                "",
                Button("play", "space", "play or pause", self._play, lambda: state.playing),
                Button("<", "Left", "the frame before", partial(state.step, -1)),
                Button(">", "Right", "the next frame", partial(state.step, 1)),
                Button("start", "BackSpace", "the first frame", partial(state.go, 0)),
                "   ",
                filming.button(),
                Button("view", "r", "turn the 3D view back to where it was", scene.look),
            ],
            [
                "speed",
                *(
                    Button(f"{speed:g}", f"F{index}", f"times the film's speed: {speed:g}", *self._speed(speed))
                    for index, speed in enumerate(SPEEDS, start=1)
                ),
                "   show  ",
                Button("background", "b", "the films behind the people", *_switch(scene.pictures, "over_film")),
                Button("ground", "g", "a grid at the lowest point, 1 m apart", *_switch(scene, "ground")),
                Button("cameras", "c", "where the cameras stand", *_switch(scene, "cameras")),
            ],
            [
                "people",
                Button("everyone", "e", "show everyone", state.show_all, lambda: not state.hidden),
                Button("one", "o", "show one person alone; again: the next one", state.show_next),
            ],
            *(["", *row] for row in shown),
        ]
        return rows, {"Home": partial(state.go, 0), "End": partial(state.go, state.count - 1)}

    def _person(self, person: int) -> Button:
        state, index = self.state, self.state.people.index(person)
        colour = "#{:02x}{:02x}{:02x}".format(*state.colour(person).tolist())
        return Button(
            f"person {person}",
            str(index) if index < 10 else "",
            f"show person {person}, or hide",
            partial(state.switch, person),
            lambda: person not in state.hidden,
            colour,
        )

    def _play(self) -> None:
        self._clock = time.perf_counter()
        flip(self.state, "playing")

    def _speed(self, speed: float) -> tuple[Callable[[], None], Callable[[], bool]]:
        def choose() -> None:
            self.state.speed = speed

        return choose, lambda: self.state.speed == speed

    def slide(self, frame: float) -> None:
        """Move the slider to a frame."""
        self.state.playing = False
        self._try(lambda: self.state.go(round(frame)))

    def tick(self) -> None:
        """Let as much time pass as has passed, if it plays; draw if there is a new frame."""
        if not self.state.playing:
            return
        now, before = time.perf_counter(), self.state.frame
        self.state.advance(min(now - self._clock, _LONGEST))
        self._clock = now
        if self.state.frame != before:
            self._try(lambda: None, clear=False)

    def _update(self) -> None:
        self._slider.GetRepresentation().SetValue(self.state.frame)
        super()._update()

    def profile(self, count: int = 30) -> dict[str, float]:
        """Median time from a change to its drawn picture, by what is changed [ms]."""
        self.scene.screenshot()  # until there is a first picture, PyVista draws none
        frames = [self.state.count * index // count for index in range(count)]
        return {
            "next frame": median_time([partial(self.press, "Right")] * min(count, self.state.count)),
            "slider": median_time([partial(self.slide, frame) for frame in (*frames[::2], *frames[1::2])]),
        }


def _switch(of: object, name: str) -> tuple[Callable[[], None], Callable[[], bool]]:
    """Switch of an object: the function that turns it, and one that tells how it is."""
    return partial(flip, of, name), lambda: bool(getattr(of, name))
