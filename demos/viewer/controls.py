"""Actions of the window's buttons and keys: on the body, its refinement, and how they are shown."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, get_args

import torch

from ..body.parameters import BodyParameters
from ..body.posing import Posed
from ..body.template import LOCKED_PARTS, PART_NAMES
from ..clothing.anny import anny
from ..clothing.model import DetailedModel
from ..clothing.registration import Registered, RegistrationOptions, register
from ..errors import InputError
from ..render.options import Gradient
from .buttons import Button
from .recording import FILM, Film
from .scene import Scene
from .settings import DRAWN_SIZES, QUALITIES, RendererName, Supervision
from .sliders import PAGES
from .state import DemoState
from .targets import NETWORK, PRESETS, RANDOM, body_of, body_target, network_body

_TURNING = tuple(name for k, name in enumerate(PART_NAMES) if k not in LOCKED_PARTS)
_BESIDE, _FARTHER = (-0.1, -0.25), 1.1  # of the 3D view, half of it being 1: room for sliders and buttons
_BODY, _MESHES, _PICTURE = "body.npz", "ellipbody.glb", "demo.png"


class Clothing:
    """Registers Anny, once as a mean adult and then as edits of that one, which may grow beyond natural people.

    Args:
        options: Of the registrations; the defaults if None.
    """

    def __init__(self, options: RegistrationOptions | None = None) -> None:
        self._options = options
        self._mean: Registered | None = None

    @property
    def model(self) -> DetailedModel:
        """The model that bodies are clothed in."""
        return anny()

    def vertices(self, posed: Posed) -> torch.Tensor:
        """Those of the detailed body that clothes B = 1 posed body, in its frame [m], shape (V, 3); takes seconds."""
        if self._mean is None:
            self._mean = register(BodyParameters.mean(1).posed(), self.model, options=self._options)
        return register(posed, self.model, start=self._mean, options=self._options).detailed.vertices[0]


class Controls:
    """The buttons, the keys, and what the window remembers for them.

    Args:
        state: What is played with.
        scene: How it is shown; its ``message`` tells what was done.
        folder: Where to save to and load from; made when it is saved to.
        redraw: Draws the window at once, before something that takes long.
        seed: Of the last random body so far; the next takes the one after.

    Attributes:
        rows: The buttons, each row with its label first.
        keys: What each key does.
        playing: Whether the refinement runs.
        page: Which of ``PAGES`` of sliders is open.
        part: The part that the rotation sliders turn.
        clothing: Makes the detailed body.
        film: Pictures for a GIF.
    """

    def __init__(self, state: DemoState, scene: Scene, folder: Path, redraw: Callable[[], None], seed: int) -> None:
        self._state, self._scene, self._folder, self._redraw = state, scene, folder, redraw
        self.playing = False
        self.page = 0
        self.part = "left_upper_arm"
        self.clothing = Clothing()
        self.film = Film()
        self._seed = seed
        self._given = state.target
        self._presets = {name: body_of(name) for name in PRESETS}
        self.rows = self._make_rows()
        self.keys: dict[str, Callable[[], None]] = {
            **{button.key: button.do for row in self.rows for button in row if button.key and button.do},
            "t": self._next_target,
            "c": lambda: self._cycle("supervision", get_args(Supervision)),
            "m": lambda: self._cycle("renderer", get_args(RendererName)),
            "g": lambda: self._cycle("gradient", get_args(Gradient)),
            "x": lambda: self._cycle("size", DRAWN_SIZES),
        }

    def _make_rows(self) -> list[list[Button]]:
        state = self._state
        starts = [
            Button(name, f"start from {name}", f"F{k + 1}", partial(self._start, name), partial(self._starts, name))
            for k, name in enumerate(PRESETS)
        ]
        targets = [
            Button(name, f"target: {name}", "", partial(self._set_target, name), partial(self._has_target, name))
            for name in self._targets()
        ]
        qualities = [
            Button(
                name,
                f"{', '.join(str(value) for value in changes.values())} px; from the start",
                f"F{k + 6}",
                partial(state.configure, **changes),
                partial(self._has, **changes),
            )
            for k, (name, changes) in enumerate(QUALITIES.items())
        ]
        return [
            [
                Button(""),
                Button("play", "play or pause the refinement", "space", self._play, lambda: self.playing),
                Button("step", "one iteration", "n", self._step),
                Button("restart", "back to the start", "BackSpace", state.restart),
                Button("   "),
                Button("save", f"save {_BODY}, {_MESHES} and {_PICTURE} in {self._folder}", "d", self._save),
                Button("load", f"start from {self._folder / _BODY}", "l", self._load),
                Button(
                    "film",
                    f"begin to film the window; again: write {self._folder / FILM}",
                    "f",
                    self._film,
                    lambda: self.film.running,
                ),
                Button("view", "turn the 3D view back to where it was", "r", self.look),
            ],
            [
                Button("start"),
                *starts,
                Button(RANDOM, "start from a random body", "F5", partial(self._start, RANDOM)),
                Button(
                    NETWORK,
                    "start from what the label network says of the target, as partdr fit does",
                    "k",
                    lambda: state.reset(network_body(state.target)),
                ),
            ],
            [Button("target  [t]"), *targets],
            [
                Button("follow  [c]"),
                *self._choices("supervision", get_args(Supervision), "follow {}; from the start"),
                Button("   "),
                Button(
                    "z gradient",
                    "with or without PartDR's z gradient (of parts; partdr, E0 to E3); from the start",
                    "z",
                    self._toggle_depth,
                    lambda: state.settings.has_depth,
                ),
            ],
            [Button("quality"), *qualities],
            [
                Button("renderer  [m]"),
                *self._choices("renderer", get_args(RendererName), "draw with {}; from the start"),
                Button("   gradient  [g]  "),
                *self._choices("gradient", get_args(Gradient), "gradient of exact ellipsoids: {}; from the start"),
            ],
            [
                Button("size  [x]"),
                *self._choices("size", DRAWN_SIZES, "pictures of {} pixels a side; from the start"),
                Button("   show  "),
                Button(
                    "skeleton",
                    "skeletons of body and target",
                    "o",
                    self._toggle_skeleton,
                    lambda: self._scene.skeleton_only,
                ),
                Button(
                    "outline arrows",
                    "the labels' pull along silhouettes, in x and y and, by colour, z",
                    "i",
                    self._toggle_outline,
                    lambda: self._scene.outline_arrows,
                ),
                Button(
                    "detailed",
                    "the detailed body that fits these ellipsoids; takes seconds",
                    "a",
                    self._clothe,
                    lambda: self._scene.detailed,
                ),
            ],
            [
                Button("sliders"),
                Button("<", "previous page", "bracketleft", partial(self._turn_page, -1)),
                *(
                    Button(kind, f"sliders: {kind}", "", partial(self.open, kind), partial(self._opened, kind))
                    for kind in ("lengths", "thicknesses", "camera", "part")
                ),
                Button(">", "next page", "bracketright", partial(self._turn_page, 1)),
                Button("   "),
                Button("previous part", "turn the part before; or click on one", "comma", lambda: self._next_part(-1)),
                Button("next part", "turn the next part; or click on one", "period", lambda: self._next_part(1)),
            ],
        ]

    def _choices(self, name: str, values: tuple[Any, ...], hint: str) -> list[Button]:
        """A button for each value of a setting."""
        state = self._state
        return [
            Button(
                str(value),
                hint.format(value),
                "",
                partial(state.configure, **{name: value}),
                partial(self._has, **{name: value}),
            )
            for value in values
        ]

    def _play(self) -> None:
        self.playing = not self.playing

    def _step(self) -> None:
        self.playing = False
        self._state.step()

    def _start(self, name: str) -> None:
        if self._starts(name):  # with the same start, what was tried from it stays
            self._state.restart()
            return
        self._seed += 1
        self._state.reset(body_of(name, self._seed))

    def _starts(self, name: str) -> bool:
        return name in self._presets and _same(self._state.start, self._presets[name])

    def _targets(self) -> tuple[str, ...]:
        return (*PRESETS, RANDOM) if self._given.truth is not None else ("given", *PRESETS, RANDOM)

    def _set_target(self, name: str) -> None:
        if name != RANDOM and self._has_target(name):
            return
        self._seed += 1
        self._state.set_target(self._given if name == "given" else body_target(body_of(name, self._seed)))

    def _has_target(self, name: str) -> bool:
        truth = self._state.target.truth
        known = next((kind for kind, body in self._presets.items() if truth is not None and _same(truth, body)), RANDOM)
        return name == ("given" if truth is None else known)

    def _next_target(self) -> None:
        names = self._targets()
        now = next(k for k, name in enumerate(names) if self._has_target(name))
        self._set_target(names[(now + 1) % len(names)])

    def _has(self, **settings: Any) -> bool:
        return all(getattr(self._state.settings, name) == value for name, value in settings.items())

    def _cycle(self, name: str, choices: tuple[Any, ...]) -> None:
        """The next choice of a setting."""
        now = choices.index(getattr(self._state.settings, name))
        self._state.configure(**{name: choices[(now + 1) % len(choices)]})

    def _toggle_depth(self) -> None:
        settings = self._state.settings
        if settings.offers_depth:
            self._state.configure(depth_gradient=not settings.depth_gradient)
        else:
            self._scene.message = "PartDR's z gradient: only of parts, with partdr or E0 to E3"

    def _toggle_skeleton(self) -> None:
        self._scene.skeleton_only = not self._scene.skeleton_only

    def _toggle_outline(self) -> None:
        self._scene.outline_arrows = not self._scene.outline_arrows
        if self._scene.outline_arrows and self._has(supervision="keypoints"):
            self._scene.message = "keypoints pull on no outline; follow the silhouette or the parts"

    def _clothe(self) -> None:
        if self._scene.detailed:
            self._scene.undress()
            return
        self.playing = False
        self._scene.message = "registering the detailed body ..."
        self._redraw()
        began, model = time.perf_counter(), self.clothing.model
        vertices = self.clothing.vertices(self._state.posed())
        took = time.perf_counter() - began
        self._scene.wear(vertices.numpy(), model.faces.numpy(), model.face_parts.numpy())
        self._scene.message = f"{model.name}, registered in {took:.1f} s; gone when the body moves"

    def look(self) -> None:
        """See the body as at first, above the buttons."""
        self._scene.look()
        camera = self._scene.plotter.camera
        camera.SetWindowCenter(*_BESIDE)
        camera.view_angle *= _FARTHER

    def pick(self, part: str) -> None:
        """Turn to the sliders of a part."""
        if part in _TURNING:
            self.part = part
        else:
            self._scene.message = f"{part.replace('_', ' ')} doesn't turn by itself"
        self.open("part")

    def open(self, kind: str) -> None:
        """Turn to the first page of sliders of a kind."""
        self.page = PAGES.index((kind, 0))

    def _opened(self, kind: str) -> bool:
        return PAGES[self.page][0] == kind

    def _turn_page(self, by: int) -> None:
        self.page = (self.page + by) % len(PAGES)

    def _next_part(self, by: int) -> None:
        self.part = _TURNING[(_TURNING.index(self.part) + by) % len(_TURNING)]
        self.open("part")

    def _save(self) -> None:
        from PIL import Image

        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            for name in (_BODY, _MESHES):
                self._state.save(self._folder / name)
            Image.fromarray(self._scene.screenshot()).save(self._folder / _PICTURE)
        except OSError as error:
            raise InputError(f"{self._folder}: {error.strerror or error}; expected a folder to write to") from error
        self._scene.message = f"saved {_BODY}, {_MESHES} and {_PICTURE} in {self._folder}"

    def _film(self) -> None:
        if self.film.running or self.film.waits:
            self.finish_film()
        else:
            self.film.start()

    def finish_film(self) -> None:
        """Write what was filmed.

        Raises:
            InputError: If it can't be written; the next time it is tried again.
        """
        self.film.running = False  # the message below isn't filmed
        self._scene.message = f"writing {self._folder / FILM} ..."
        self._redraw()
        count = self.film.write(self._folder)
        self._scene.message = f"{count} pictures in {self._folder / FILM}" if count else "nothing was filmed"

    def _load(self) -> None:
        self._state.load(self._folder / _BODY)
        self._scene.message = f"starts from {self._folder / _BODY}"


def _same(one: BodyParameters, other: BodyParameters) -> bool:
    return all(torch.equal(one.tensors()[name].detach(), tensor) for name, tensor in other.tensors().items())
