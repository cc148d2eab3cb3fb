"""Search of films for everything that a fit needs: people, matched frames, and cameras."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from ..cameras import Perspective
from ..errors import told_as
from ..inputs.calibrated_camera import CalibratedCamera
from ..networks.detection.film_people import find_film_people
from ..networks.predictors.film_predictions import GivenNetworks, find_film_predictions
from ..solve.ellipsoids.stages import Progress
from ..solve.scene.options import SceneOptions
from .film_cameras import place_film_cameras
from .film_pieces import FilmPieces
from .film_times import film_starts
from .matched_times import match_films
from .observed_film import ObservedFilm


@dataclass(frozen=True)
class FilmSearch:
    """Search for the people and the cameras of films.

    Attributes:
        films: Files of films that were taken at the same time.
        options: Options of the fit, with the network for keypoints and a person's height.
        lens: Function that returns the lens of a film, by its file and (H, W) [px]. None is the usual lens.
        device: Device to run on, "cpu" or a CUDA device.
        min_score: Least confidence that there is a person.
        networks: Networks of others that are asked about each person. If it is None, only the packaged ones are used.
        rig: Calibrated cameras. If it is None, several cameras are placed by the people.
        person: Index of the person who alone places the cameras. If it is None, everyone does.
        align: Switch for films that did not start together. If it is True, their time offsets are searched for.
    """

    films: Sequence[Path]
    options: SceneOptions
    lens: Callable[[Path, tuple[int, int]], Perspective | None]
    device: str
    min_score: float
    networks: GivenNetworks | None = None
    rig: Sequence[CalibratedCamera] | None = None
    person: int | None = None
    align: bool = False

    @property
    def places_cameras(self) -> bool:
        """True if cameras are placed by the people, which takes a person's height into account."""
        return self.rig is None and len(self.films) > 1

    def find(self, pieces: FilmPieces, progress: Progress) -> list[ObservedFilm]:
        """Finds the people and the cameras of the films, and matches the films frame by frame.

        Args:
            pieces: Results of an earlier run, to which new results are added.
            progress: Function that is called with (stage name, steps done, all steps).

        Raises:
            InputError: If a film can't be read, it shows nobody, or time offsets or cameras can't be found.
        """
        films = [self._observe(index, pieces, progress) for index in range(len(self.films))]
        with ExitStack() as named:
            for index, path in enumerate(self.films):
                named.enter_context(told_as(f"films[{index}]", path))
            starts = None
            if self.align:
                starts = pieces.starts(partial(film_starts, films, device=self.device, progress=progress))
            films = match_films(films, starts)
            if not self.places_cameras:
                return films
            place_all = partial(
                place_film_cameras,
                films,
                stature=self.options.stature,
                person=self.person,
                device=self.device,
                progress=progress,
            )
            return pieces.placed(films, place_all)

    def _observe(self, index: int, pieces: FilmPieces, progress: Progress) -> ObservedFilm:
        """People of one film, and its camera. A camera that is placed by people is at the origin for now."""
        path = self.films[index]
        report = partial(progress, "people" if len(self.films) == 1 else f"people of {path.name}")
        if self.networks is None:
            find = partial(
                find_film_people,
                path,
                min_score=self.min_score,
                device=self.device,
                progress=report,
                landmarks=self.options.landmarks,
            )
            people = pieces.people(index, find)
            predictions = None
        else:
            predict = partial(
                find_film_predictions,
                path,
                self.networks,
                min_score=self.min_score,
                device=self.device,
                progress=report,
                landmarks=self.options.landmarks,
            )
            people, predictions = pieces.predictions(index, self.networks, predict)
        if self.rig is not None:
            return ObservedFilm.calibrated(people, self.rig[index], given=predictions)
        return ObservedFilm.of(people, self.lens(path, people.image_size), given=predictions)
