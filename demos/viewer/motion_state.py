"""The demo of a fitted film without a picture: its settings and files, people's motions, the time shown, and who is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import torch

from ..body.template import PART_NAMES
from ..errors import InputError
from ..models.load import load_model
from ..models.model import Detailed
from ..pipelines.film import Motion
from ..results.film_overlays import PosedMotions
from ..results.load_film import FilmView, SavedFilm, load_film_fit
from ..results.palette import PEOPLE_COLOURS

SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0)
_MEASURED = 48  # frames of a person that tell where the ground is
_HEAD, _FEET = PART_NAMES.index("head"), [PART_NAMES.index(f"{side}_foot") for side in ("left", "right")]


class MotionState:
    """Motions of a film, at a time of it; at its end it begins anew."""

    def __init__(self, saved: SavedFilm, *, speed: float = 1.0) -> None:
        self.saved, self.speed = saved, speed
        self.playing = False
        self.hidden: set[int] = set()  # people
        self._time = 0.0  # [s] since the film's first frame
        self._posed = PosedMotions(saved.motions)
        self._bodies: tuple[int, dict[int, Detailed]] = -1, {}

    @property
    def people(self) -> list[int]:
        """Everyone, shown or not."""
        return list(self.saved.motions)

    @property
    def count(self) -> int:
        """Number of frames."""
        return len(self.saved.times)

    @property
    def frame(self) -> int:
        """The frame that is shown, 0 = first."""
        return max(int(np.searchsorted(self.saved.times, self._time, side="right")) - 1, 0)

    def go(self, frame: int) -> None:
        """Show a frame, or the first or last one."""
        self._time = float(self.saved.times[min(max(frame, 0), self.count - 1)])

    @property
    def seconds(self) -> float:
        """Time of the frame that is shown [s], since the first one."""
        return float(self.saved.times[self.frame])

    def go_to(self, seconds: float) -> None:
        """Show the frame that is nearest to a time [s]."""
        self.go(int(np.abs(np.asarray(self.saved.times) - seconds).argmin()))

    def step(self, by: int) -> None:
        """Stop, and show a frame before or after this one."""
        self.playing = False
        self.go(self.frame + by)

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        end = self.saved.times[-1] + 1 / self.saved.rate
        self._time = float((self._time + seconds * self.speed) % end)

    def bodies(self) -> dict[int, Detailed]:
        """Bodies (B = 1) of those who are shown and there, in the world [m]."""
        if self._bodies[0] != self.frame:
            self._bodies = self.frame, self._posed.at(self.frame)
        return {person: body for person, body in self._bodies[1].items() if person not in self.hidden}

    def show_all(self) -> None:
        """Show everyone."""
        self.hidden = set()

    def show_next(self) -> None:
        """Show one person alone, each time the next one."""
        shown = [person for person in self.people if person not in self.hidden]
        index = self.people.index(shown[0]) + 1 if len(shown) == 1 else 0
        self.hidden = set(self.people) - {self.people[index % len(self.people)]}

    def switch(self, person: int) -> None:
        """Show somebody, or hide them."""
        self.hidden ^= {person}

    def colour(self, person: int) -> np.ndarray:
        """RGB of a person, shape (3,), uint8."""
        return np.asarray(PEOPLE_COLOURS[self.people.index(person) % len(PEOPLE_COLOURS)])

    @cached_property
    def room(self) -> Room:
        """The space that the people move in."""
        ups, some = np.zeros(3), []
        for motion in self.saved.motions.values():
            for body in _samples(motion):
                joints = body.joints[:, list(motion.model.part_joints)].numpy()
                ups += (joints[:, _HEAD] - joints[:, _FEET].mean(1)).mean(0)
                some.append(body.vertices[0, ::4].numpy())
        up = np.zeros(3)
        up[np.abs(ups).argmax()] = np.sign(ups[np.abs(ups).argmax()])
        turn = _upright(up, self.saved.views[0].view.rotation.double().numpy()[2])
        points = np.concatenate(some) @ turn.T
        return Room(turn, points.min(0), points.max(0))


@dataclass(frozen=True)
class Room:
    """The space that people move in, as it is drawn: x right, y up, z toward the viewer, as the first view sees it.

    Attributes:
        turn: Rotation from the world to the room, shape (3, 3).
        low: Least x, y (the ground) and z of the room [m], shape (3,).
        high: Largest x, y and z of the room [m], shape (3,).
    """

    turn: np.ndarray
    low: np.ndarray
    high: np.ndarray


def _upright(up: np.ndarray, look: np.ndarray) -> np.ndarray:
    """Rotation of the world into a room where an axis is up and a direction leads away from the viewer."""
    flat = look - up * (look @ up)
    if np.linalg.norm(flat) < 0.1:  # seen from above
        flat = np.roll(up, 1)
    back = -flat / np.linalg.norm(flat)
    return np.stack([np.cross(up, back), up, back])


def _samples(motion: Motion) -> Iterator[Detailed]:
    """Bodies (B = 1) in a few frames of a motion."""
    step = -(-len(motion.frames) // _MEASURED)
    with torch.no_grad():
        bodies = motion.bodies(slice(0, None, step)).detailed
    for row in range(len(bodies.vertices)):
        yield bodies.select(slice(row, row + 1))


@dataclass(frozen=True)
class MotionSettings:
    """Settings of the demo of a fitted film."""

    film: str = ""  # the film, or the folder that all views' films are in; default: where people.json says
    model: str = "anny"  # detailed model, as `partdr fit --model`
    speed: float = 1.0

    def __post_init__(self) -> None:
        if not 0 < self.speed <= 100:
            raise InputError(f"speed: {self.speed:g}; expected more than 0, up to 100")


def open_motion(folder: Path, settings: MotionSettings) -> tuple[MotionState, list[Path | None]]:
    """Motions in a folder of ``partdr fit FILM``, and the film of each view, None where it isn't there any more."""
    try:
        model = load_model(settings.model)
    except ValueError as error:
        raise InputError(f"model: {error}") from error
    saved = load_film_fit(folder, model)
    films = [find_film(view, folder, settings.film, alone=len(saved.views) == 1) for view in saved.views]
    return MotionState(saved, speed=settings.speed), films


def find_film(view: FilmView, folder: Path, given: str, *, alone: bool) -> Path | None:
    """The film of a view, if it is still there.

    Args:
        view: View of the scene.
        folder: Folder of the scene.
        given: Text that the user gave: a folder with the film or, for the only view, the film. "" is for none.
        alone: True if it is the only view.
    """
    if given and alone and Path(given).is_file():
        return Path(given)
    if given and not Path(given).is_dir():
        raise InputError(f"film: {given}; expected a folder with the films of all views{', or the film' * alone}")
    if not view.film:
        return None
    name = Path(view.film).name
    places = [Path(given) / name] if given else [Path(view.film), folder / name, folder.parent / name]
    return next((path for path in places if path.is_file()), None)
