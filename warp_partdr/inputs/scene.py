"""Scene: calibrated views, and the observations of each person in each frame of each view."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch

from ..cameras import Perspective, check_square, is_rotation
from ..errors import InputError, check_each, check_type, check_whole
from ..interop.checks import FLOATS, check_tensor
from .calibrated_camera import CalibratedCamera
from .keypoints import Keypoints2D
from .part_labels import PartLabels
from .person import check_near

_UNIT = 1e-4  # largest difference between the length of a normal and 1


@dataclass(frozen=True)
class View:
    """View from a camera that stands still: X_camera = R X_world + t.

    Attributes:
        camera: Camera of the whole picture, with square pixels and without distortion, B = 1.
        rotation: Rotation R, world to camera, shape (3, 3).
        translation: Translation t [m], shape (3,).

    Raises:
        ValueError: If ``camera`` is not one camera with square pixels, a shape is wrong, or R is no rotation.

    Examples:
        >>> import torch
        >>> from warp_partdr import Perspective, View
        >>> view = View(Perspective.of_picture((480, 640), fov=60.0), translation=torch.tensor([0.0, 0.0, 3.0]))
        >>> view.eye
        tensor([ 0.,  0., -3.])
        >>> view.to_camera(torch.zeros(3))  # the world's origin is 3 m before the camera
        tensor([0., 0., 3.])
    """

    camera: Perspective
    rotation: torch.Tensor = field(default_factory=lambda: torch.eye(3))
    translation: torch.Tensor = field(default_factory=lambda: torch.zeros(3))

    def __post_init__(self) -> None:
        check_type("camera", self.camera, Perspective, "such as Perspective.of_picture(size, focal=1500)")
        check_square(self.camera)
        check_tensor("rotation", self.rotation, (3, 3), dtypes=FLOATS)
        check_tensor("translation", self.translation, (3,), dtypes=FLOATS)
        if not is_rotation(self.rotation):
            raise ValueError("rotation: not orthonormal, or a mirror image; expected a rotation, world to camera")
        if not self.translation.isfinite().all():
            raise ValueError(f"translation: {self.translation.tolist()}; expected finite numbers [m]")

    @classmethod
    def of(cls, camera: CalibratedCamera) -> View:
        """View from a calibrated camera.

        The view has no distortion. So keypoints and labels must be those of pictures whose distortion is removed.
        """
        rotation = torch.from_numpy(camera.rotation).float()
        translation = torch.from_numpy(camera.translation).float()
        return cls(camera.without_distortion, rotation, translation)

    @property
    def eye(self) -> torch.Tensor:
        """Position of the camera in the world [m], shape (3,)."""
        return -self.translation @ self.rotation

    def to_camera(self, points: torch.Tensor) -> torch.Tensor:
        """Converts points (..., 3) from the world to the camera's coordinates [m]."""
        return points @ self.rotation.to(points).mT + self.translation.to(points)


@dataclass(frozen=True)
class SceneObservation:
    """Observation of one person in one picture of a scene.

    Attributes:
        keypoints: Keypoints of the person, in pixels of the picture.
        parts: Part labels of the picture. Pixels of other people must be 255 (ignored). If it is None, only the
            keypoints are used.
        person: Index of the person, from 0.
        frame: Index of the frame, from 0.
        view: Index of the view in ``Scene.views``.

    Examples:
        >>> from warp_partdr import SceneObservation, read_keypoints, read_parts
        >>> person, parts = read_keypoints("keypoints.json")[0], read_parts("parts.png", "cdcl14")
        >>> seen = SceneObservation(person, parts, person=0, frame=2)
        >>> seen.frame, seen.view
        (2, 0)
    """

    keypoints: Keypoints2D
    parts: PartLabels | None = None
    person: int = 0
    frame: int = 0
    view: int = 0


@dataclass(frozen=True)
class PersonShape:
    """Shape of a person, such as an earlier fit found it.

    Attributes:
        values: Shape values of the detailed model, shape (S,).
        clothes: Thicknesses of clothes and hair [m], shape (8,).
    """

    values: torch.Tensor
    clothes: torch.Tensor


@dataclass(frozen=True)
class Ground:
    """Plane of the points x with normal x = offset.

    Attributes:
        normal: Unit vector that points up, shape (3,), float64.
        offset: Distance of the plane from the origin along the normal [m].

    Raises:
        ValueError: If the normal is no unit vector, or the offset is not finite.
    """

    normal: np.ndarray
    offset: float

    def __post_init__(self) -> None:
        if np.shape(self.normal) != (3,) or not abs(np.linalg.norm(self.normal) - 1) < _UNIT:
            raise ValueError(f"normal: {self.normal}; expected 3 numbers of length 1")
        if not math.isfinite(self.offset):
            raise ValueError(f"offset: {self.offset}; expected a finite number [m]")

    def heights(self, points: np.ndarray) -> np.ndarray:
        """Heights of points (..., 3) above the plane [m], shape (...)."""
        return points @ self.normal - self.offset


@dataclass(frozen=True)
class Scene:
    """People who are observed in the frames of one or several views.

    Attributes:
        views: Views, which share one world.
        observations: Observations in any order. Each person has at most one in each picture. Frames without any
            observation of a person are filled in by the fit.
        frame_rate: Frames per second. It is used if ``times`` is None.
        shapes: Known shapes, by the index of the person. The fit finds the shapes of the other people.
        ground: Ground in the world, if it is known. ``SceneOptions.ground`` must not be 0 then.
        times: Times of the frames [s], which rise, shape (T,). If it is None, frames are evenly spaced.

    Raises:
        InputError: If an index of a person, frame or view is out of range, an observation comes twice, a person has no
            observation, a keypoint is very far from the picture, label sets differ, or times do not rise or are not as
            many as the frames.

    Examples:
        >>> from warp_partdr import Perspective, Scene, SceneObservation, View, read_keypoints
        >>> person = read_keypoints("keypoints.json")[0]
        >>> view = View(Perspective.of_picture((512, 384), focal=600.0))
        >>> scene = Scene([view], [SceneObservation(person, frame=frame) for frame in range(3)], frame_rate=30.0)
        >>> scene.num_people, scene.num_frames, len(scene.views)
        (1, 3, 1)
    """

    views: Sequence[View]
    observations: Sequence[SceneObservation]
    frame_rate: float = 30.0
    shapes: Mapping[int, PersonShape] = field(default_factory=dict)
    ground: Ground | None = None
    times: Sequence[float] | np.ndarray | None = None

    def __post_init__(self) -> None:
        check_each("views", self.views, View, "such as View(camera)")
        check_each("observations", self.observations, SceneObservation, "such as SceneObservation(keypoints)")
        if not self.views or not self.observations:
            raise InputError(f"{'observations' if self.views else 'views'}: none; expected at least one")
        if not 0 < self.frame_rate < math.inf:
            raise InputError(f"frame_rate: {self.frame_rate}; expected frames per second, above 0")
        known: set[tuple[int, int, int]] = set()
        for index, observation in enumerate(self.observations):
            for name in ("person", "frame", "view"):
                check_whole(f"observations[{index}].{name}", getattr(observation, name), 0)
            if observation.view >= len(self.views):
                raise InputError(f"observations[{index}].view: {observation.view}; expected 0 to {len(self.views) - 1}")
            key = observation.person, observation.frame, observation.view
            if key in known:
                raise InputError(
                    f"observations[{index}]: a second one of person, frame, view {key}; expected one at most"
                )
            known.add(key)
        _check_keypoint_positions(self.observations, self.views)
        if missing := sorted(set(range(self.num_people)) - {person for person, _, _ in known}):
            raise InputError(
                f"observations: none of person {missing[0]}; expected some of each person from 0 to "
                f"{self.num_people - 1}"
            )
        for person, shape in self.shapes.items():
            if not 0 <= person < self.num_people:
                raise InputError(f"shapes: one for person {person}; expected people 0 to {self.num_people - 1}")
            check_type(f"shapes[{person}]", shape, PersonShape, "of an earlier fit")
        check_type("ground", self.ground, Ground | None, "such as Ground(np.array([0.0, -1.0, 0.0]), -1.6)")
        if self.times is not None:
            times = np.asarray(self.times)
            if times.shape != (self.num_frames,) or times.dtype.kind not in "iuf":
                raise InputError(f"times: {times.dtype} {times.shape}; expected seconds of {self.num_frames} frames")
            if not np.isfinite(times).all() or (np.diff(times) <= 0).any():
                raise InputError("times: not finite, or not later than the frame before; expected seconds that rise")
        sets = [observation.parts.label_set for observation in self.observations if observation.parts is not None]
        if any(each != sets[0] for each in sets):
            raise InputError("observations: part labels from several label sets; expected one set")

    @property
    def num_people(self) -> int:
        """Number of people, P."""
        return 1 + max(observation.person for observation in self.observations)

    @property
    def num_frames(self) -> int:
        """Number of frames, T."""
        return 1 + max(observation.frame for observation in self.observations)

    @property
    def frame_times(self) -> np.ndarray:
        """Times of the frames [s], shape (T,), float64."""
        if self.times is None:
            return np.arange(self.num_frames) / self.frame_rate
        return np.asarray(self.times, dtype=np.float64)


def _check_keypoint_positions(observations: Sequence[SceneObservation], views: Sequence[View]) -> None:
    """Raises InputError if a keypoint is very far from its picture.

    The largest labels of a view give the size of its pictures. Without labels, the camera gives a rough size.
    """
    sizes: dict[int, tuple[float, float]] = {}
    for observation in observations:
        if observation.parts is not None:
            height, width = sizes.get(observation.view, (0.0, 0.0))
            rows, columns = observation.parts.groups.shape
            sizes[observation.view] = max(height, float(rows)), max(width, float(columns))
    described = {view: f"the picture's {width:.0f}x{height:.0f} pixels" for view, (height, width) in sizes.items()}
    for view in {observation.view for observation in observations} - set(sizes):
        camera = views[view].camera
        side = max(float(camera.focal.max()), 2 * float(camera.centre.abs().max()))
        sizes[view] = side, side
        described[view] = f"the camera's picture, of about {side:.0f} pixels"
    for index, observation in enumerate(observations):
        check_type(f"observations[{index}].keypoints", observation.keypoints, Keypoints2D, "of read_keypoints")
        try:
            check_near(observation.keypoints, sizes[observation.view], described[observation.view])
        except InputError as error:
            raise InputError(f"observations[{index}].{error}") from None
