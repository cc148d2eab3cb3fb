"""A film with the camera that took it, and its people as observations of a scene."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch

from ..body.labels import IGNORE
from ..cameras import Perspective, UsualLens, zoomed
from ..errors import check_type
from ..inputs.calibrated_camera import CalibratedCamera
from ..inputs.scene import SceneObservation, View
from ..networks.detection.film_people import FilmPeople, kept_size, pack_owners, row_keypoints
from ..networks.predictors.film_predictions import FilmPredictions, pack_groups
from .photo import mask_labels


@dataclass(frozen=True)
class ObservedFilm:
    """Film with its people, from a camera that stands still.

    Attributes:
        people: People of the film, in pixels without distortion.
        view: Camera for the film's pixels, and its pose.
        lens: Camera whose distortion was removed. If it is None, there is no distortion.
        given: Predictions about the people by networks of others, in the same pixels. If it is None, the masks and
            keypoints of the packaged networks are used.
        by_calibration: True if the pose of the camera comes from a calibration.
        warnings: Differences between the film and its camera, a sentence each.
        numbers: Indices of its frames in the file, rising, -1 for frames that are missing, shape (F,), int64. If it is
            None, the frames are those of the file from the first one on.

    Examples:
        >>> from warp_partdr import ObservedFilm, Perspective, find_film_people
        >>> people = find_film_people("walk.mp4")
        >>> film = ObservedFilm.of(people, Perspective.of_picture(people.image_size, focal=600.0))
        >>> film.people.num_people, film.view.camera.focal
        (1, tensor([[600., 600.]]))
    """

    people: FilmPeople
    view: View
    lens: CalibratedCamera | None = None
    given: FilmPredictions | None = None
    by_calibration: bool = False
    warnings: tuple[str, ...] = ()
    numbers: np.ndarray | None = None

    @classmethod
    def of(
        cls, people: FilmPeople, camera: Perspective | None = None, *, given: FilmPredictions | None = None
    ) -> ObservedFilm:
        """Film whose world is the frame of its camera.

        Args:
            people: People of the film.
            camera: Camera of the film. The default is one with a usual lens.
            given: Predictions about the people by networks of others.

        Raises:
            TypeError: If an argument has another type.

        Examples:
            >>> from warp_partdr import ObservedFilm, find_film_people
            >>> ObservedFilm.of(find_film_people("walk.mp4")).view.rotation.shape  # a usual lens, at the world's origin
            torch.Size([3, 3])
        """
        check_type("people", people, FilmPeople, "of find_film_people")
        check_type("camera", camera, Perspective | None, "such as Perspective.of_picture(size, focal=1500)")
        check_type("given", given, FilmPredictions | None, "of find_film_predictions")
        size = people.image_size
        return cls(people, View(camera or UsualLens.of_size(size)), given=given)

    @classmethod
    def calibrated(
        cls, people: FilmPeople, camera: CalibratedCamera, *, given: FilmPredictions | None = None
    ) -> ObservedFilm:
        """Film of a calibrated camera, whose distortion is removed.

        The film may be resized, or padded by a codec. Its ``warnings`` then say so.

        Args:
            people: People of the film.
            camera: Camera of the film.
            given: Predictions about the people by networks of others.

        Raises:
            InputError: If the camera's pictures have another shape.
        """
        size = people.image_size
        warnings = _size_warnings(camera, size)
        camera = camera.fitted(size)
        if not camera.distorts:
            return cls(people, View.of(camera), given=given, by_calibration=True, warnings=warnings)
        rows = people.rows.copy()
        small = camera.resized(kept_size(size))
        rows["keypoints"] = _without_distortion(rows["keypoints"], camera)
        packed = [pack_owners(small.undistort_picture(people.owners(frame))) for frame in range(len(people.times))]
        if given is not None:
            given = _given_without_distortion(given, camera, small)
        people = replace(people, rows=rows, packed=tuple(packed))
        view = View.of(camera)
        return cls(people, view, camera, given, by_calibration=True, warnings=warnings)

    def taken(self, frames: np.ndarray, times: np.ndarray) -> ObservedFilm:
        """Returns a copy with other frames: some of its own, and empty ones where it has none.

        Args:
            frames: Indices of the frames in the film as it is now, rising, -1 where it has none, shape (T,), int64.
            times: Times of these frames [s], rising, shape (T,).
        """
        given = None if self.given is None else self.given.taken(frames)
        numbers = np.where(frames < 0, -1, self.file_numbers[frames])
        return replace(self, people=self.people.taken(frames, times), given=given, numbers=numbers)

    @property
    def file_numbers(self) -> np.ndarray:
        """Indices of its frames in the file, -1 where it has none, shape (F,), int64."""
        return np.arange(len(self.people.times)) if self.numbers is None else self.numbers

    @property
    def skipped(self) -> int:
        """Number of frames at the file's start that are left out."""
        return int(self.file_numbers[self.file_numbers >= 0][0])

    def standing(self, rotation: torch.Tensor, translation: torch.Tensor) -> ObservedFilm:
        """Returns a copy whose camera has another pose: X_camera = R X_world + t.

        Args:
            rotation: Rotation R, shape (3, 3).
            translation: Translation t [m], shape (3,). It is not the camera's position, which is -R^T t.
        """
        return replace(self, view=View(self.view.camera, rotation, translation), by_calibration=False)

    def scaled(self, factor: float) -> ObservedFilm:
        """Returns a copy in a world whose lengths are multiplied by a factor."""
        lens = self.lens and replace(self.lens, translation=factor * self.lens.translation)
        return replace(self, view=replace(self.view, translation=factor * self.view.translation), lens=lens)

    @property
    def camera(self) -> CalibratedCamera:
        """Camera that took the film, with its distortion."""
        if self.lens is not None:
            return self.lens
        focal = float(self.view.camera.focal[0, 0])
        u, v = self.view.camera.centre[0].tolist()
        rotation = self.view.rotation.double().numpy()
        translation = self.view.translation.double().numpy()
        return CalibratedCamera((focal, focal), (u, v), (), rotation, translation, self.people.image_size)

    @property
    def small_view(self) -> View:
        """View for the pixels of ``observations``: the film's view, as small as the maps of people are kept."""
        camera = zoomed(self.view.camera, self._zoom, kept_size(self.people.image_size))
        assert isinstance(camera, Perspective)
        return replace(self.view, camera=camera)

    def observations(self, rows: np.ndarray, person: int, view: int) -> Iterator[SceneObservation]:
        """Observations of a person, in pixels of ``small_view``. Frames keep their indices.

        Args:
            rows: Rows of the person in ``people``.
            person: Index of the person in the scene.
            view: Index of the view in the scene.
        """
        for row in rows:
            frame = int(row["frames"])
            index = int(row["places"])
            full = None if self.given is None else self.given.keypoints_of(frame, index)
            if full is None:
                full = row_keypoints(row)
            keypoints = replace(full, points=full.points * np.float32(self._zoom))
            # A mask is never mixed with labels of the given network, because they have different label sets.
            if self.given is None or self.given.networks.parts_from is None:
                parts = mask_labels(self.people.owners(frame), index)
            else:
                parts = self.given.parts_of(frame, index)
            yield SceneObservation(keypoints, parts, person, frame, view)

    @property
    def _zoom(self) -> float:
        """Pixels of the small view for each pixel of the film."""
        return kept_size(self.people.image_size)[1] / self.people.image_size[1]


def _given_without_distortion(
    given: FilmPredictions, camera: CalibratedCamera, small: CalibratedCamera
) -> FilmPredictions:
    """Predictions in pixels without distortion. Labels have the size of the small camera."""
    packed: list[bytes] = []
    for row in range(len(given.packed)):  # one at a time, because the labels of a long film take gigabytes
        groups = given.groups(row)
        packed.append(pack_groups(None if groups is None else small.undistort_picture(groups, fill=IGNORE)))
    return replace(given, keypoints=_without_distortion(given.keypoints, camera), packed=tuple(packed))


def _without_distortion(keypoints: np.ndarray, camera: CalibratedCamera) -> np.ndarray:
    """Keypoints (N, K, 3) in pixels without distortion. Keypoints that the lens can't show are 0."""
    points = camera.undistort_points(keypoints[..., :2])
    valid = np.isfinite(points).all(-1, keepdims=True) & (keypoints[..., 2:] > 0)
    return np.where(valid, np.concatenate([points, keypoints[..., 2:]], axis=-1), 0.0).astype(keypoints.dtype)


def _size_warnings(camera: CalibratedCamera, size: tuple[int, int]) -> tuple[str, ...]:
    """Warning if pictures have another size (H, W) than the camera's."""
    if camera.size is None or camera.size == size:
        return ()
    zoom = camera.fitted(size).focal[0] / camera.focal[0]
    taken = "the difference is taken for a codec's padding" if zoom == 1 else f"the camera is scaled by {zoom:.4g}"
    new = _size_text(size)
    own = _size_text(camera.size)
    return (f"pictures of {new}, calibrated at {own}: {taken}",)


def _size_text(size: tuple[int, int]) -> str:
    """Width and height of a size (H, W), as text."""
    return f"{size[1]} x {size[0]} px"
