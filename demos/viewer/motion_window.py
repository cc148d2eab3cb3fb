"""The window of a fitted film: a slider through time, buttons and keys, and frames that pass while it plays."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from .buttons import Button, Entry, Slider, flip
from .controlled import ControlledWindow, median_time
from .motion_scene import PlottedMotion
from .motion_state import SPEEDS, MotionState
from .plotted import WINDOW, Look
from .recording import Filming

_MOST_BUTTONS = 16  # people with a button of their own
_LONGEST = 0.25  # [s] that may pass between two pictures; what takes longer, such as a menu, is no part of the film


class MotionWindow(ControlledWindow):
    """Buttons, keys and a slider around people who move; ``off_screen`` for a browser, tests and ``profile``."""

    scene: PlottedMotion
    tall = 1.5

    def __init__(
        self,
        state: MotionState,
        films: Sequence[Path | None],
        folder: Path,
        *,
        off_screen: bool = False,
        more: bool = False,
    ) -> None:
        self.state, self.folder = state, folder
        scene = PlottedMotion(state, films, off_screen=off_screen, smooth=False)
        filming = Filming(scene, folder, self.refresh)
        self._clock = time.perf_counter()
        self._play_button = Button("play", "space", "play or pause", self._play, lambda: state.playing)
        self._rows = self._make_rows(scene, filming)
        keys: dict[str, Callable[[], None]] = {"Home": partial(state.go, 0), "End": partial(state.go, state.count - 1)}
        keys |= {entry.key: entry.do for row in self._rows for entry in row if isinstance(entry, Button) and entry.key}
        super().__init__(scene, filming, keys, state, more=more)
        scene.arrange(Look(WINDOW, more, controls=True))
        scene.look()
        self._update()

    def sentence(self) -> str:
        """One sentence that says what one sees and can do, or what has just happened."""
        if self.scene.message or self.scene.pictures.fault:
            return self.scene.message or self.scene.pictures.fault
        count = len(self.state.people)
        who = "one person" if count == 1 else f"{count} people"
        return f"Press play: you see {who} of a film in 3D, and the film with their bodies drawn over it."

    def first_row(self) -> list[Entry]:
        """Play and the slider through time."""
        return [self._play_button, self._time()]

    def all_rows(self) -> list[list[Entry]]:
        """The slider through time, then all buttons."""
        return [self._rows[0], [self._time()], *self._rows[1:]]

    def _time(self) -> Slider:
        return Slider("time [s]", 0.0, float(self.state.saved.times[-1]), self.state.seconds, self._go_to)

    def _go_to(self, seconds: float) -> None:
        self.state.playing = False
        self.state.go_to(seconds)

    def _make_rows(self, scene: PlottedMotion, filming: Filming) -> list[list[Entry]]:
        state = self.state
        return [
            [
                self._play_button,
                Button("<", "Left", "the frame before", partial(state.step, -1)),
                Button(">", "Right", "the next frame", partial(state.step, 1)),
                Button("start", "BackSpace", "the first frame", partial(state.go, 0)),
                filming.button(),
                Button("view", "r", "turn the 3D view back to where it was", scene.look),
            ],
            [
                "speed",
                *(
                    Button(f"{speed:g}", f"F{index}", f"times the film's speed: {speed:g}", *self._speed(speed))
                    for index, speed in enumerate(SPEEDS, start=1)
                ),
            ],
            [
                "show",
                Button("background", "b", "the films behind the people", *_switch(scene.pictures, "over_film")),
                Button("ground", "g", "a grid at the lowest point, 1 m apart", *_switch(scene, "ground")),
                Button("cameras", "c", "where the cameras stand", *_switch(scene, "cameras")),
            ],
            [
                "people",
                Button("everyone", "e", "show everyone", state.show_all, lambda: not state.hidden),
                Button("one", "o", "show one person alone; again: the next one", state.show_next),
                *(self._person(person) for person in state.people[:_MOST_BUTTONS]),
            ],
        ]

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
