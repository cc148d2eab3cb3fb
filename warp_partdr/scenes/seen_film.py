"""A film and the camera that took it: its people as sights of a scene."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..cameras import Perspective, zoomed
from ..detection.film_people import FilmPeople, kept_size, pack_owners, row_keypoints
from ..errors import check_type
from ..fit.photo import mask_labels
from ..inputs.calibrated_camera import CalibratedCamera
from .scene import Sight, View


@dataclass(frozen=True)
class SeenFilm:
    """Film of a camera that stands still.

    Attributes:
        people: Of the film, in pixels without distortion.
        view: The camera, of the film's pixels, and its place.
        lens: The camera whose distortion was taken away; None: there is none.
    """

    people: FilmPeople
    view: View
    lens: CalibratedCamera | None = None

    @classmethod
    def of(cls, people: FilmPeople, camera: Perspective | None = None) -> SeenFilm:
        """Film whose camera's frame is the world; default: a focal length as long as the picture's diagonal.

        Raises:
            TypeError: If an argument is of another type.
        """
        check_type("people", people, FilmPeople, "of find_film_people")
        check_type("camera", camera, Perspective | None, "such as Perspective.of_picture(size, focal=1500)")
        size = people.image_size
        return cls(people, View(camera or Perspective.of_picture(size, focal=math.hypot(*size))))

    @classmethod
    def calibrated(cls, people: FilmPeople, camera: CalibratedCamera) -> SeenFilm:
        """Film of a calibrated camera, whose distortion is taken away.

        Raises:
            InputError: If the camera's pictures have another size.
        """
        size = people.image_size
        camera.check_size(size)
        camera = replace(camera, size=size)
        if not camera.distorts:
            return cls(people, View.of(camera))
        rows, small = people.rows.copy(), camera.resized(kept_size(size))
        seen = rows["keypoints"]
        points = camera.undistort_points(seen[..., :2])
        there = np.isfinite(points).all(-1, keepdims=True) & (seen[..., 2:] > 0)
        rows["keypoints"] = np.where(there, np.concatenate([points, seen[..., 2:]], axis=-1), 0.0)
        packed = [pack_owners(small.undistort_picture(people.owners(frame))) for frame in range(len(people.times))]
        return cls(replace(people, rows=rows, packed=tuple(packed)), View.of(camera), camera)

    @property
    def small_view(self) -> View:
        """The view of sights."""
        camera = zoomed(self.view.camera, self._zoom, kept_size(self.people.image_size))
        assert isinstance(camera, Perspective)
        return replace(self.view, camera=camera)

    def sights(self, rows: np.ndarray, person: int, view: int) -> Iterator[Sight]:
        """Sights of a person's rows, frames as they are there, in pixels of ``small_view``."""
        for row in rows:
            full, frame = row_keypoints(row), int(row["frames"])
            keypoints = replace(full, points=full.points * np.float32(self._zoom))
            parts = mask_labels(self.people.owners(frame).astype(np.int32), int(row["places"]))
            yield Sight(keypoints, parts, person, frame, view)

    @property
    def _zoom(self) -> float:
        return kept_size(self.people.image_size)[1] / self.people.image_size[1]
