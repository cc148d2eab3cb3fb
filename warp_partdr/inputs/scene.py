"""Scene: calibrated views, and what was seen of each person in each frame of each view."""

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

_UNIT = 1e-4  # that the length of a normal may be off 1


@dataclass(frozen=True)
class View:
    """Camera that stands still: X_camera = R X_world + t.

    Attributes:
        camera: Of the whole picture, with square pixels and without distortion, B = 1.
        rotation: R, world to camera, shape (3, 3).
        translation: t [m], shape (3,).

    Raises:
        ValueError: If there is not one camera with square pixels, a shape is wrong, or R is no rotation.
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
        """View of a calibrated camera.

        The view has no distortion. So keypoints and labels must be those of pictures whose distortion is removed.
        """
        turn, move = (torch.from_numpy(each).float() for each in (camera.rotation, camera.translation))
        return cls(camera.without_distortion, turn, move)

    @property
    def eye(self) -> torch.Tensor:
        """Place of the camera in the world [m], shape (3,)."""
        return -self.translation @ self.rotation

    def to_camera(self, points: torch.Tensor) -> torch.Tensor:
        """Points of the world (..., 3) in the camera's frame [m]."""
        return points @ self.rotation.to(points).mT + self.translation.to(points)


@dataclass(frozen=True)
class Sight:
    """One person in one picture.

    Attributes:
        keypoints: The person's, in pixels of the picture.
        parts: The picture's part labels, other people's pixels being ignored (255); None: keypoints alone.
        person: Which one, 0 = first.
        frame: When, 0 = first.
        view: Where from, a place in ``Scene.views``.
    """

    keypoints: Keypoints2D
    parts: PartLabels | None = None
    person: int = 0
    frame: int = 0
    view: int = 0


@dataclass(frozen=True)
class PersonShape:
    """Shape of a person who is known from elsewhere.

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
        normal: Up, of length 1, shape (3,), float64.
        offset: From the origin along it [m].

    Raises:
        ValueError: If the normal is no direction, or the offset no number.
    """

    normal: np.ndarray
    offset: float

    def __post_init__(self) -> None:
        if np.shape(self.normal) != (3,) or not abs(np.linalg.norm(self.normal) - 1) < _UNIT:
            raise ValueError(f"normal: {self.normal}; expected 3 numbers of length 1")
        if not math.isfinite(self.offset):
            raise ValueError(f"offset: {self.offset}; expected a finite number [m]")

    def heights(self, points: np.ndarray) -> np.ndarray:
        """Heights of points (..., 3) over the plane [m], shape (...)."""
        return points @ self.normal - self.offset


@dataclass(frozen=True)
class Scene:
    """People in frames seen by views.

    Attributes:
        views: Cameras, which share one world.
        sights: In any order; each person in each picture once at most. Frames in which nobody sees somebody are
            bridged.
        frame_rate: Frames a second, where they come evenly.
        shapes: Of people who are known, by person; the others' are found.
        ground: In the world, where it is known; fits take it with ``SceneOptions.ground``, which else looks for one.
        times: Of the frames [s], rising, shape (T,); None: they come evenly.

    Raises:
        InputError: If a person, frame or view is out of range or comes twice, somebody is never seen, a keypoint is
            very far from the picture, labels differ in their set, or times do not rise or are not of the frames.
    """

    views: Sequence[View]
    sights: Sequence[Sight]
    frame_rate: float = 30.0
    shapes: Mapping[int, PersonShape] = field(default_factory=dict)
    ground: Ground | None = None
    times: Sequence[float] | np.ndarray | None = None

    def __post_init__(self) -> None:
        check_each("views", self.views, View, "such as View(camera)")
        check_each("sights", self.sights, Sight, "such as Sight(keypoints)")
        if not self.views or not self.sights:
            raise InputError(f"{'sights' if self.views else 'views'}: none; expected at least one")
        if not 0 < self.frame_rate < math.inf:
            raise InputError(f"frame_rate: {self.frame_rate}; expected frames a second, above 0")
        seen: set[tuple[int, int, int]] = set()
        for place, sight in enumerate(self.sights):
            for name in ("person", "frame", "view"):
                check_whole(f"sights[{place}].{name}", getattr(sight, name), 0)
            if sight.view >= len(self.views):
                raise InputError(f"sights[{place}].view: {sight.view}; expected 0 to {len(self.views) - 1}")
            key = sight.person, sight.frame, sight.view
            if key in seen:
                raise InputError(f"sights[{place}]: person, frame, view {key} a second time; expected once")
            seen.add(key)
        _check_places(self.sights, self.views)
        if unseen := sorted(set(range(self.num_people)) - {person for person, _, _ in seen}):
            raise InputError(f"sights: person {unseen[0]} in none; expected people 0 to {self.num_people - 1}")
        for person, shape in self.shapes.items():
            if not 0 <= person < self.num_people:
                raise InputError(f"shapes: of person {person}; expected people 0 to {self.num_people - 1}")
            check_type(f"shapes[{person}]", shape, PersonShape, "of an earlier fit")
        check_type("ground", self.ground, Ground | None, "such as Ground(np.array([0.0, -1.0, 0.0]), -1.6)")
        if self.times is not None:
            at = np.asarray(self.times)
            if at.shape != (self.num_frames,) or at.dtype.kind not in "iuf":
                raise InputError(f"times: {at.dtype} {at.shape}; expected seconds of {self.num_frames} frames")
            if not np.isfinite(at).all() or (np.diff(at) <= 0).any():
                raise InputError("times: not finite, or no later than the frame before; expected seconds that rise")
        sets = [sight.parts.label_set for sight in self.sights if sight.parts is not None]
        if any(each != sets[0] for each in sets):
            raise InputError("sights: part labels of several sets; expected one")

    @property
    def num_people(self) -> int:
        """Number of people, P."""
        return 1 + max(sight.person for sight in self.sights)

    @property
    def num_frames(self) -> int:
        """Number of frames, T."""
        return 1 + max(sight.frame for sight in self.sights)

    @property
    def frame_times(self) -> np.ndarray:
        """Times of the frames [s], shape (T,), float64."""
        if self.times is None:
            return np.arange(self.num_frames) / self.frame_rate
        return np.asarray(self.times, dtype=np.float64)


def _check_places(sights: Sequence[Sight], views: Sequence[View]) -> None:
    """Raise InputError if a keypoint is very far from its picture; without labels, the camera tells its rough size."""
    sizes: dict[int, tuple[float, float]] = {}
    for sight in sights:
        if sight.parts is not None:
            height, width = sizes.get(sight.view, (0.0, 0.0))
            rows, columns = sight.parts.groups.shape
            sizes[sight.view] = max(height, float(rows)), max(width, float(columns))
    shown = {view: f"the picture's {width:.0f}x{height:.0f} pixels" for view, (height, width) in sizes.items()}
    for view in {sight.view for sight in sights} - set(sizes):
        camera = views[view].camera
        side = max(float(camera.focal.max()), 2 * float(camera.centre.abs().max()))
        sizes[view], shown[view] = (side, side), f"the camera's picture, of about {side:.0f} pixels"
    for place, sight in enumerate(sights):
        check_type(f"sights[{place}].keypoints", sight.keypoints, Keypoints2D, "of read_keypoints")
        try:
            check_near(sight.keypoints, sizes[sight.view], shown[sight.view])
        except InputError as error:
            raise InputError(f"sights[{place}].{error}") from None
