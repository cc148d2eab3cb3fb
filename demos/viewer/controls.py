"""Actions of the window's buttons and keys: on the body, its refinement, and how they are shown."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import torch
from PIL import Image

from ..body.parameters import BodyParameters
from ..body.template import LOCKED_PARTS, PART_NAMES
from ..errors import InputError
from ..models.registration import RegistrationOptions
from ..solve.ellipsoids.stepper import SIZES
from .buttons import Button, Entry, Slider, flip
from .recording import Filming
from .scene import PlottedScene
from .settings import CHOICES, QUALITIES
from .skin import ShownSkin
from .sliders import PAGES
from .state import DemoState
from .targets import NETWORK, PRESETS, RANDOM, body_of, body_target, network_body, read_body

_TURNING = tuple(name for k, name in enumerate(PART_NAMES) if k not in LOCKED_PARTS)
_BODY, _MESHES, _PICTURE = "body.npz", "ellipbody.glb", "demo.png"
_Do: TypeAlias = Callable[[str], None]
_IsOn: TypeAlias = Callable[[str], bool]
_GIVEN = "given"  # the user's own target
_HINTS = {
    NETWORK: "start from what the label network says of the target, as partdr fit does",
    "z": "with or without PartDR's z gradient (of parts; partdr, E0 to E3); from the start",
    "outline": "the labels' pull along silhouettes, in x and y and, by colour, z",
    "detailed": "the detailed body around these ellipsoids, or the ellipsoids",
}


class Controls:
    """The buttons, the keys, and what the window remembers for them.

    The scene's ``message`` tells what was done; ``redraw`` draws the window at once, before something that takes long.
    The folder to save to is made when it is needed; the next random body takes the seed after ``seed``.
    """

    def __init__(
        self, state: DemoState, scene: PlottedScene, folder: Path, redraw: Callable[[], None], seed: int
    ) -> None:
        self._state, self._scene, self._folder, self._redraw, self._seed = state, scene, folder, redraw, seed
        self.playing = False
        self.page = 0  # of ``PAGES``
        self.part = "left_upper_arm"  # that the rotation sliders turn
        self.registration: RegistrationOptions | None = None  # of the detailed body
        self._skin: ShownSkin | None = None
        self.filming = Filming(scene, folder, redraw)
        self._given = state.target
        self._presets = {name: body_of(name) for name in PRESETS}
        self.keys: dict[str, Callable[[], None]] = {}
        self.rows = self._make_rows()
        buttons = [entry for row in self.rows for entry in row if isinstance(entry, Button)]
        self.keys |= {button.key: button.do for button in buttons if button.key}

    def _make_rows(self) -> list[list[Entry]]:
        state, scene, folder = self._state, self._scene, self._folder
        bodies = (*PRESETS, RANDOM)
        targets = bodies if self._given.truth is not None else (_GIVEN, *bodies)
        skeleton = partial(flip, scene, "skeleton_only")
        self.play = Button("play", "space", "play or pause the refinement", self._play, lambda: self.playing)
        return [
            [
                self.play,
                Button("step", "n", "one iteration", self._step),
                Button("restart", "BackSpace", "back to the start", state.restart),
                Button("save", "d", f"save {_BODY}, {_MESHES} and {_PICTURE} in {folder}", self._save),
                Button("load", "l", f"start from {folder / _BODY}", self._load),
                self.filming.button(),
                Button("view", "r", "turn the 3D view back to where it was", scene.look),
            ],
            [
                "start",
                *_each(bodies, "start from ", self._start, self._has_start, first_key=1),
                Button(NETWORK, "k", _HINTS[NETWORK], self._start_from_network),
            ],
            self._cycle("target", "t", _each(targets, "target: ", self._set_target, self._has_target)),
            [
                *self._setting("follow", "c", "supervision", "follow {}"),
                Button("z gradient", "z", _HINTS["z"], self._toggle_depth, lambda: state.settings.has_depth),
            ],
            ["quality", *self._settings("{} px", QUALITIES, first_key=6)],
            self._setting("renderer", "m", "renderer", "draw with {}"),
            self._setting("gradient", "g", "gradient", "gradient of exact ellipsoids: {}"),
            self._setting("size", "x", "size", "pictures of {} pixels a side"),
            [
                "show",
                Button("skeleton", "o", "skeletons of body and target", skeleton, lambda: scene.skeleton_only),
                Button("outline arrows", "i", _HINTS["outline"], self._toggle_outline, lambda: scene.outline_arrows),
                Button("detailed", "a", _HINTS["detailed"], self.clothe, lambda: scene.detailed),
            ],
            [
                "sliders",
                Button("<", "bracketleft", "previous page", partial(self._turn_page, -1)),
                *_each(dict(PAGES), "sliders: ", self.open, self.is_open),
                Button(">", "bracketright", "next page", partial(self._turn_page, 1)),
                Button("previous part", "comma", "turn the part before; or click on one", partial(self._next_part, -1)),
                Button("next part", "period", "turn the next part; or click on one", partial(self._next_part, 1)),
            ],
        ]

    def _settings(self, hint: str, choices: dict[str, dict[str, Any]], first_key: int = 0) -> list[Button]:
        """A button for each change of some settings; ``first_key``: number of the first one's function key."""
        return [
            Button(
                text,
                f"F{key}" if first_key else "",
                hint.format(", ".join(map(str, changes.values()))) + "; from the start",
                partial(self._state.configure, **changes),
                partial(self._has, **changes),
            )
            for key, (text, changes) in enumerate(choices.items(), start=first_key)
        ]

    def _setting(self, label: str, key: str, name: str, hint: str) -> list[Entry]:
        """A button for each value of a setting, and a key for the next."""
        return self._cycle(label, key, self._settings(hint, {str(value): {name: value} for value in CHOICES[name]}))

    def _cycle(self, label: str, key: str, buttons: list[Button]) -> list[Entry]:
        """Buttons of which one is lit, after a label with the key that goes on to the next."""

        def go_on() -> None:
            now = next(k for k, button in enumerate(buttons) if button.is_on())
            buttons[(now + 1) % len(buttons)].do()

        self.keys[key] = go_on
        return [f"{label} [{key}]", *buttons]

    def _step(self) -> None:
        self.playing = False
        self._state.step()

    def _start(self, name: str) -> None:
        if self._has_start(name):  # with the same start, what was tried from it stays
            self._state.restart()
            return
        self._seed += 1
        self._state.reset(body_of(name, self._seed))

    def _has_start(self, name: str) -> bool:
        return name in self._presets and _same(self._state.start, self._presets[name])

    def _start_from_network(self) -> None:
        self._state.reset(network_body(self._state.target))

    def _set_target(self, name: str) -> None:
        if name != RANDOM and self._has_target(name):
            return
        self._seed += 1
        self._state.set_target(self._given if name == _GIVEN else body_target(body_of(name, self._seed)))

    def _has_target(self, name: str) -> bool:
        if (truth := self._state.target.truth) is None:
            return name == _GIVEN
        return name == next((kind for kind, body in self._presets.items() if _same(truth, body)), RANDOM)

    def _has(self, **settings: Any) -> bool:
        return all(getattr(self._state.settings, name) == value for name, value in settings.items())

    def _toggle_depth(self) -> None:
        settings = self._state.settings
        if settings.offers_depth:
            self._state.configure(depth_gradient=not settings.depth_gradient)
        else:
            self._scene.message = "PartDR's z gradient: only of parts, with partdr or E0 to E3"

    def _toggle_outline(self) -> None:
        flip(self._scene, "outline_arrows")
        if self._scene.outline_arrows and self._has(supervision="keypoints"):
            self._scene.message = "keypoints pull on no outline; follow the silhouette or the parts"

    def clothe(self) -> None:
        """Show the detailed body, or the ellipsoids again."""
        if self._scene.skin is not None:
            self._scene.skin = None
            return
        if self._skin is None:
            self._skin = ShownSkin(self.registration)
        self._scene.skin = self._skin
        if not self._skin.rests and self._state.settled:
            self._scene.message = (
                f"The detailed body has their pose; its shape takes about {self._skin.seconds:.0f} s ..."
            )

    def settle(self) -> bool:
        """Register the detailed body, if it is shown and the ellipsoids rest; whether there was something to do."""
        skin = self._scene.skin
        if skin is None or skin.rests or not self._state.settled:
            return False
        skin.register(self._state.placed, fitted=self._state.target.truth is None)
        if self._scene.message.endswith("..."):
            self._scene.message = f"{skin.name}, registered in {skin.seconds:.1f} s"
        return True

    def first_sliders(self) -> list[Slider]:
        """Three sliders that explain most: how tall and how broad the body is, and the side that it is seen from."""
        scene = self._scene
        sizes = [self._size("how tall [%]", "lengths"), self._size("how broad [%]", "thicknesses")]
        return [*sizes, Slider("look from the side [°]", -180.0, 180.0, scene.turned, scene.turn)]

    def _size(self, title: str, field: str) -> Slider:
        """Slider of all lengths or thicknesses [% of the mean adult's]."""
        low, high = SIZES[field]
        return Slider(title, 100 * low, 100 * high, 100 * self._state.share(field), partial(self._resize, field))

    def _resize(self, field: str, percent: float) -> None:
        self.playing = False
        self._state.set_share(field, percent / 100)

    def _play(self) -> None:
        if not self.playing and self._state.converged:
            self._state.restart()
        flip(self, "playing")

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

    def is_open(self, kind: str) -> bool:
        """True if a page of sliders of a kind is open."""
        return PAGES[self.page][0] == kind

    def _turn_page(self, by: int) -> None:
        self.page = (self.page + by) % len(PAGES)

    def _next_part(self, by: int) -> None:
        self.pick(_TURNING[(_TURNING.index(self.part) + by) % len(_TURNING)])

    def _save(self) -> None:
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._state.save(self._folder / _BODY, self._folder / _MESHES)
            Image.fromarray(self._scene.screenshot()).save(self._folder / _PICTURE)
        except OSError as error:
            raise InputError(f"{self._folder}: {error.strerror or error}; expected a folder to write to") from error
        self._scene.message = f"saved {_BODY}, {_MESHES} and {_PICTURE} in {self._folder}"

    def _load(self) -> None:
        self._state.reset(read_body(self._folder / _BODY))
        self._scene.message = f"starts from {self._folder / _BODY}"


def _each(names: Iterable[str], hint: str, do: _Do, is_on: _IsOn, first_key: int = 0) -> list[Button]:
    """A button for each of some names; ``first_key``: number of the first one's function key."""
    return [
        Button(name, f"F{key}" if first_key else "", hint + name, partial(do, name), partial(is_on, name))
        for key, name in enumerate(names, start=first_key)
    ]


def _same(one: BodyParameters, other: BodyParameters) -> bool:
    return all(torch.equal(one.tensors()[name].detach(), tensor) for name, tensor in other.tensors().items())
