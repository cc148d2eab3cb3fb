"""Films from their files to what a fit takes: people are found, moments matched, and cameras placed."""

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
        films: Files of films of the same moments.
        options: Options of the fit, which say the network for keypoints, and a person's height.
        lens: Lens of a film, by its file and (H, W) [px]; None for a usual one.
        device: "cpu" or a CUDA device.
        min_score: Least confidence that there is a person.
        networks: Networks of others, asked about each person; None: there are none.
        rig: Calibrated cameras; None: several cameras are placed by the people.
        person: Number of the person who alone places the cameras; None: everyone does.
        align: Whether it is to be found which frames show one moment.
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
        """Films frame by frame, with their people and cameras; what is found is kept in pieces.

        Raises:
            InputError: If a film can't be read, nobody is found in it, or moments or cameras can't be found.
        """
        seen = [self._see(place, pieces, progress) for place in range(len(self.films))]
        with ExitStack() as named:
            for place, film in enumerate(self.films):
                named.enter_context(told_as(f"films[{place}]", film))
            starts = None
            if self.align:
                starts = pieces.starts(partial(film_starts, seen, device=self.device, progress=progress))
            seen = match_films(seen, starts)
            if not self.places_cameras:
                return seen
            place_all = partial(
                place_film_cameras,
                seen,
                stature=self.options.stature,
                person=self.person,
                device=self.device,
                progress=progress,
            )
            return pieces.placed(seen, place_all)

    def _see(self, place: int, pieces: FilmPieces, progress: Progress) -> ObservedFilm:
        """People of one film, and its camera; of several, the camera stands nowhere yet if it is not calibrated."""
        film = self.films[place]
        told = partial(progress, "people" if len(self.films) == 1 else f"people of {film.name}")
        score, landmarks = self.min_score, self.options.landmarks
        if self.networks is None:
            find = partial(
                find_film_people, film, min_score=score, device=self.device, progress=told, landmarks=landmarks
            )
            people, observations = pieces.people(place, find), None
        else:
            ask = partial(
                find_film_predictions,
                film,
                self.networks,
                min_score=score,
                device=self.device,
                progress=told,
                landmarks=landmarks,
            )
            people, observations = pieces.observations(place, self.networks, ask)
        if self.rig is not None:
            return ObservedFilm.calibrated(people, self.rig[place], given=observations)
        return ObservedFilm.of(people, self.lens(film, people.image_size), given=observations)
