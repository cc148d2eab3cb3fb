"""A film and the camera that took it: its people as sights of a scene."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch

from ..body.labels import IGNORE
from ..cameras import Perspective, UsualLens, zoomed
from ..errors import check_type
from ..inputs.calibrated_camera import CalibratedCamera
from ..inputs.scene import Sight, View
from ..networks.detection.film_people import FilmPeople, kept_size, pack_owners, row_keypoints
from ..networks.predictors.film_sights import FilmSights, pack_groups
from .photo import mask_labels


@dataclass(frozen=True)
class SeenFilm:
    """Film of a camera that stands still.

    Attributes:
        people: Of the film, in pixels without distortion.
        view: The camera, of the film's pixels, and its place.
        lens: The camera whose distortion was taken away; None: there is none.
        given: What networks of others see of the people, in the same pixels; None: the packaged ones' masks and
            keypoints serve.
        by_calibration: True if the camera stands where a calibration says.
        warnings: Differences between the film and its camera, a sentence each.
        numbers: Of its frames in the file, rising, -1 where it has none, shape (F,), int64; None: all, from the first
            one on.
    """

    people: FilmPeople
    view: View
    lens: CalibratedCamera | None = None
    given: FilmSights | None = None
    by_calibration: bool = False
    warnings: tuple[str, ...] = ()
    numbers: np.ndarray | None = None

    @classmethod
    def of(cls, people: FilmPeople, camera: Perspective | None = None, *, given: FilmSights | None = None) -> SeenFilm:
        """Film whose camera's frame is the world; by default the camera has a usual lens.

        Raises:
            TypeError: If an argument is of another type.
        """
        check_type("people", people, FilmPeople, "of find_film_people")
        check_type("camera", camera, Perspective | None, "such as Perspective.of_picture(size, focal=1500)")
        check_type("given", given, FilmSights | None, "of find_film_sights")
        size = people.image_size
        return cls(people, View(camera or UsualLens.of_size(size)), given=given)

    @classmethod
    def calibrated(cls, people: FilmPeople, camera: CalibratedCamera, *, given: FilmSights | None = None) -> SeenFilm:
        """Film of a calibrated camera, whose distortion is taken away.

        Pictures may be resized, or padded by a codec, which the film's ``warnings`` say.

        Raises:
            InputError: If the camera's pictures have another shape.
        """
        size = people.image_size
        warnings = _size_warnings(camera, size)
        camera = camera.fitted(size)
        if not camera.distorts:
            return cls(people, View.of(camera), given=given, by_calibration=True, warnings=warnings)
        rows, small = people.rows.copy(), camera.resized(kept_size(size))
        rows["keypoints"] = _without_distortion(rows["keypoints"], camera)
        packed = [pack_owners(small.undistort_picture(people.owners(frame))) for frame in range(len(people.times))]
        if given is not None:
            # One at a time: all of a long film's together take gigabytes.
            seen = (given.groups(row) for row in range(len(given.packed)))
            flat = (None if each is None else small.undistort_picture(each, fill=IGNORE) for each in seen)
            points = _without_distortion(given.keypoints, camera)
            given = replace(given, keypoints=points, packed=tuple(map(pack_groups, flat)))
        people, view = replace(people, rows=rows, packed=tuple(packed)), View.of(camera)
        return cls(people, view, camera, given, by_calibration=True, warnings=warnings)

    def taken(self, frames: np.ndarray, times: np.ndarray) -> SeenFilm:
        """Copy of the film with other frames: some of its own, and gaps where it has none.

        Args:
            frames: Numbers of the frames in the film as it is now, rising, -1 where it has none, shape (T,), int64.
            times: Times of these frames [s], rising, shape (T,).
        """
        given = None if self.given is None else self.given.taken(frames)
        numbers = np.where(frames < 0, -1, self.file_numbers[frames])
        return replace(self, people=self.people.taken(frames, times), given=given, numbers=numbers)

    @property
    def file_numbers(self) -> np.ndarray:
        """Numbers of its frames in the file, -1 where it has none, shape (F,), int64."""
        return np.arange(len(self.people.times)) if self.numbers is None else self.numbers

    @property
    def skipped(self) -> int:
        """Frames at the file's start that are left out."""
        return int(self.file_numbers[self.file_numbers >= 0][0])

    def standing(self, rotation: torch.Tensor, translation: torch.Tensor) -> SeenFilm:
        """Copy of the film whose camera stands elsewhere: X_camera = R X_world + t.

        Args:
            rotation: R, shape (3, 3).
            translation: t [m], shape (3,). It is not the camera's position, which is -R^T t.
        """
        return replace(self, view=View(self.view.camera, rotation, translation), by_calibration=False)

    def scaled(self, factor: float) -> SeenFilm:
        """Copy of the film in a world whose lengths are multiplied by a factor."""
        lens = self.lens and replace(self.lens, translation=factor * self.lens.translation)
        return replace(self, view=replace(self.view, translation=factor * self.view.translation), lens=lens)

    @property
    def camera(self) -> CalibratedCamera:
        """The camera that took the film, with its distortion."""
        if self.lens is not None:
            return self.lens
        seen, (u, v) = self.view, self.view.camera.centre[0].tolist()
        focal = float(seen.camera.focal[0, 0])
        turn, move = seen.rotation.double().numpy(), seen.translation.double().numpy()
        return CalibratedCamera((focal, focal), (u, v), (), turn, move, self.people.image_size)

    @property
    def small_view(self) -> View:
        """View in whose pixels ``sights`` are: the film's, as small as the maps of people are kept."""
        camera = zoomed(self.view.camera, self._zoom, kept_size(self.people.image_size))
        assert isinstance(camera, Perspective)
        return replace(self.view, camera=camera)

    def sights(self, rows: np.ndarray, person: int, view: int) -> Iterator[Sight]:
        """Sights of a person's rows, frames as they are there, in pixels of ``small_view``."""
        for row in rows:
            frame, place = int(row["frames"]), int(row["places"])
            full = None if self.given is None else self.given.keypoints_of(frame, place)
            if full is None:
                full = row_keypoints(row)
            keypoints = replace(full, points=full.points * np.float32(self._zoom))
            if self.given is None or self.given.networks.parts_from is None:
                parts = mask_labels(self.people.owners(frame), place)
            else:  # a mask is of another label set than the others' labels
                parts = self.given.parts_of(frame, place)
            yield Sight(keypoints, parts, person, frame, view)

    @property
    def _zoom(self) -> float:
        return kept_size(self.people.image_size)[1] / self.people.image_size[1]


def _without_distortion(keypoints: np.ndarray, camera: CalibratedCamera) -> np.ndarray:
    """Keypoints (N, K, 3) of the picture as taken; those that the lens can't show are 0."""
    points = camera.undistort_points(keypoints[..., :2])
    there = np.isfinite(points).all(-1, keepdims=True) & (keypoints[..., 2:] > 0)
    return np.where(there, np.concatenate([points, keypoints[..., 2:]], axis=-1), 0.0).astype(keypoints.dtype)


def _size_warnings(camera: CalibratedCamera, size: tuple[int, int]) -> tuple[str, ...]:
    """Warning of pictures of another (H, W) than the camera's."""
    if camera.size is None or camera.size == size:
        return ()
    zoom = camera.fitted(size).focal[0] / camera.focal[0]
    taken = "the difference is taken for a codec's padding" if zoom == 1 else f"the camera is scaled by {zoom:.4g}"
    own, new = (f"{width} x {height} px" for height, width in (camera.size, size))
    return (f"pictures of {new}, calibrated at {own}: {taken}",)
