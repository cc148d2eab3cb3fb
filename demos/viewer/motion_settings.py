"""Opening a fitted film for the demo: its settings, its folder, and the films that its cameras took."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..clothing.load import load_model
from ..errors import InputError
from ..results.load_film import FilmView, load_film_fit
from .motion_state import MotionState


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
        view: Of a scene.
        folder: The scene's.
        given: The user's word: a folder with the film or, of the only view, the film; "" for none.
        alone: Whether it is the only view.
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
