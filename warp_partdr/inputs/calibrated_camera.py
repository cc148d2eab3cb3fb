"""Calibrated camera, and its distortion, which is removed from keypoints, labels and pictures before a fit.

Without distortion, a picture has the same size, the same principal point, and square pixels. The Brown-Conrady model
(Brown, 1966; the rational form as in OpenCV) shows a point x, y at depth 1 at::

    x' = x s + 2 p1 x y + p2 (r^2 + 2 x^2)        s = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6)
    y' = y s + p1 (r^2 + 2 y^2) + 2 p2 x y
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import torch

from ..body.labels import IGNORE
from ..cameras import Perspective, is_rotation
from ..errors import InputError
from .keypoints import Keypoints2D
from .part_labels import PartLabels

_MOST_STEPS = 50  # of Newton's iteration; a few are enough
_CLOSE = 1e-12  # largest error at depth 1; about 1e-9 px
_STEP = 1e-6  # for the differences that give its derivatives
_WIDEST = np.linspace(0.0, 10.0, 10_001)  # radii at depth 1, up to 84 degrees beside the axis
_FARTHEST = 1e6  # distance of the world's origin from a camera, in the file's unit: a kilometre in millimetres
_MOST_PIXELS = 1e6  # [px], largest focal length and coordinate of a principal point
_LEAST_FOCAL = 1.0  # [px]; a smaller number is a share of the picture
_FOCAL_SHARES = (0.1, 100.0)  # range of a focal length in longer sides of the picture: 157 to 0.6 degrees
_MOST_STRETCH = 2.5  # largest f_x / f_y or f_y / f_x: a picture with every second row of the sensor has 2
_MOST_SIDES = 2.0  # sides by which the principal point may lie outside of a picture that is cut out of a sensor's
_BLOCKS = (8, 16, 32, 64)  # [px]; codecs pad pictures to multiples of one, at the right and at the bottom
_WHOLE = 0.01  # [px], error of a whole number of pixels
_ROUNDING = 1.0  # [px], error of a side of a resized picture


@dataclass(frozen=True)
class CalibratedCamera:
    """Camera with known lens and position: X_camera = R X_world + t.

    Attributes:
        focal: Focal lengths (f_x, f_y) [px].
        principal: Principal point (u, v) [px], where the middle of the first pixel is at (0.5, 0.5): OpenCV's + 0.5.
        distortion: Coefficients k1, k2, p1, p2, k3, k4, k5, k6; those left out are 0.
        rotation: Rotation R, world to camera, shape (3, 3), float64.
        translation: Translation t [m], shape (3,), float64.
        size: Size (H, W) of its pictures [px]; None: unknown.

    Raises:
        InputError: If a number is out of range or R is no rotation.
    """

    focal: tuple[float, float]
    principal: tuple[float, float]
    distortion: tuple[float, ...] = ()
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))
    translation: np.ndarray = field(default_factory=lambda: np.zeros(3))
    size: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        if not all(0 < each < math.inf for each in self.focal) or not all(map(math.isfinite, self.principal)):
            raise InputError(f"focal, principal: {self.focal}, {self.principal}; expected pixels, focal above 0")
        self._check_lens()
        if len(self.distortion) > 8 or not all(map(math.isfinite, self.distortion)):
            raise InputError(f"distortion: {self.distortion}; expected up to 8 numbers, k1, k2, p1, p2, k3, k4, k5, k6")
        if self.rotation.shape != (3, 3) or not is_rotation(torch.from_numpy(self.rotation)):
            raise InputError("rotation: not orthonormal, or a mirror image; expected a rotation, world to camera")
        distance = float(np.linalg.norm(self.translation))
        if self.translation.shape != (3,) or not distance <= _FARTHEST:
            raise InputError(
                f"translation: {self.translation.tolist()}; expected 3 numbers in metres, {_FARTHEST:g} at most"
            )

    def _check_lens(self) -> None:
        """Raise InputError if no camera has this focal length or principal point, such as shares of the picture."""
        least, most = _LEAST_FOCAL, _MOST_PIXELS
        picture = ""
        if self.size is not None:
            least = _FOCAL_SHARES[0] * max(self.size)
            most = _FOCAL_SHARES[1] * max(self.size)
            picture = f" for a picture of {self.size[1]} x {self.size[0]} px"
        if not all(least <= each <= most for each in self.focal):
            raise InputError(f"focal: {self.focal}; expected pixels, {least:g} to {most:g}{picture}")
        if max(self.focal) > _MOST_STRETCH * min(self.focal):
            raise InputError(f"focal: {self.focal}; expected two lengths within a factor of {_MOST_STRETCH:g}")
        ranges = [(-_MOST_PIXELS, _MOST_PIXELS)] * 2
        if self.size is not None:
            ranges = [(-_MOST_SIDES * side, (1 + _MOST_SIDES) * side) for side in self.size[::-1]]
        if not all(low <= each <= high for each, (low, high) in zip(self.principal, ranges, strict=True)):
            expected = " and ".join(f"{low:g} to {high:g}" for low, high in ranges)
            raise InputError(f"principal: {self.principal}; expected pixels, {expected}{picture}")

    @property
    def without_distortion(self) -> Perspective:
        """Camera of the pictures after their distortion is removed, B = 1."""
        focal = self._square
        return Perspective(torch.tensor([[focal, focal]]), torch.tensor([self.principal]))

    def undistort_points(self, points: np.ndarray) -> np.ndarray:
        """Remove distortion from points (..., 2) [px] of the picture as taken; float64.

        A point that no point without distortion is mapped to becomes NaN: the lens shows nothing there.
        """
        distorted = (np.asarray(points, dtype=np.float64) - self.principal) / self.focal
        found = distorted.copy()
        step_right, step_down = _STEP * np.eye(2)
        for _ in range(_MOST_STEPS):
            errors = self._distort(found) - distorted
            if not (np.abs(errors) > _CLOSE).any():
                break
            # The inverse of the 2 x 2 derivatives, which differences give closely enough for quadratic convergence.
            right = (self._distort(found + step_right) - self._distort(found - step_right)) / (2 * _STEP)
            down = (self._distort(found + step_down) - self._distort(found - step_down)) / (2 * _STEP)
            determinant = right[..., 0] * down[..., 1] - right[..., 1] * down[..., 0]
            steps = np.stack(
                [
                    errors[..., 0] * down[..., 1] - errors[..., 1] * down[..., 0],
                    errors[..., 1] * right[..., 0] - errors[..., 0] * right[..., 1],
                ],
                axis=-1,
            )
            with np.errstate(all="ignore"):
                found = found - steps / determinant[..., None]
        with np.errstate(invalid="ignore"):
            errors = np.abs(self._distort(found) - distorted).max(axis=-1)
            wrong = ~((errors < 1e3 * _CLOSE) & (np.linalg.norm(found, axis=-1) <= self._reach))
        found[wrong] = np.nan
        return found * self._square + self.principal

    def distort_points(self, points: np.ndarray) -> np.ndarray:
        """Distort points (..., 2) [px] as the lens does; float64. Points that it can't show become NaN."""
        undistorted = (np.asarray(points, dtype=np.float64) - self.principal) / self._square
        with np.errstate(invalid="ignore"):
            beyond = ~(np.linalg.norm(undistorted, axis=-1) <= self._reach)
        distorted = self._distort(undistorted) * self.focal + self.principal
        distorted[beyond] = np.nan
        return distorted

    def undistort_keypoints(self, keypoints: Keypoints2D) -> Keypoints2D:
        """Remove distortion from keypoints of the picture as taken; those that the lens can't show become missing."""
        points = self.undistort_points(keypoints.points)
        visible = np.isfinite(points).all(axis=1) & keypoints.visible
        confidence = np.where(visible, keypoints.confidence, 0.0).astype(np.float32)
        points = np.where(visible[:, None], points, 0.0).astype(np.float32)
        return replace(keypoints, points=points, confidence=confidence)

    def undistort_parts(self, parts: PartLabels) -> PartLabels:
        """Remove distortion from part labels of the picture as taken; pixels that it lacks become 255, ignore."""
        maps, instances = parts.maps, parts.instances
        return PartLabels(
            parts.label_set,
            self.undistort_picture(parts.groups, fill=IGNORE),
            None if maps is None else np.moveaxis(self.undistort_picture(np.moveaxis(maps, 0, -1)), -1, 0),
            None
            if instances is None
            else np.moveaxis(self.undistort_picture(np.moveaxis(instances, 0, -1), fill=IGNORE), -1, 0),
        )

    def undistort_picture(self, picture: np.ndarray, *, fill: int = 0) -> np.ndarray:
        """Remove distortion from a picture as taken, (H, W) or (H, W, C).

        Each pixel takes the nearest pixel's value, or ``fill`` if the picture as taken does not show it.

        Raises:
            InputError: If the camera's pictures have another size.
        """
        size = (picture.shape[0], picture.shape[1])
        self.check_size(size)
        inside, pixels = (self if self.size is not None else replace(self, size=size))._source_pixels
        undistorted = picture[pixels]
        undistorted[~inside] = fill
        return undistorted

    def check_size(self, size: tuple[int, int]) -> None:
        """Raise InputError if the camera's pictures have another size (H, W)."""
        if self.size is not None and self.size != size:
            expected = f"{self.size[1]} x {self.size[0]}"
            raise InputError(f"picture: {size[1]} x {size[0]} px; expected {expected}, as calibrated")

    def fitted(self, size: tuple[int, int]) -> CalibratedCamera:
        """Camera for the same pictures at another size (H, W): resized, and with or without the padding of a codec.

        A codec pads 1080 rows to 1088, at the bottom or at the right, where the principal point does not move.

        Raises:
            InputError: If pictures of this size have another shape.
        """
        if self.size is None or self.size == size:
            return replace(self, size=size)
        zooms = [new / own for new, own in zip(size, self.size, strict=True)]
        # One side gives the zoom, and the other one is rounded or padded.
        for zoom in (1.0, max(zooms), min(zooms)):
            if _same_shape(self.size, size, zoom):
                return self._zoomed(zoom, size)
        self.check_size(size)
        return self

    def resized(self, size: tuple[int, int]) -> CalibratedCamera:
        """Camera for the same pictures at a size (H, W) of about the same shape. The camera's size must be known."""
        assert self.size is not None
        return self._zoomed(size[1] / self.size[1], size)

    def _zoomed(self, zoom: float, size: tuple[int, int]) -> CalibratedCamera:
        focal = (zoom * self.focal[0], zoom * self.focal[1])
        principal = (zoom * self.principal[0], zoom * self.principal[1])
        return replace(self, focal=focal, principal=principal, size=size)

    def in_frame_of(self, first: CalibratedCamera) -> CalibratedCamera:
        """Camera in another world, whose frame is that of the camera ``first``."""
        rotation = self.rotation @ first.rotation.T
        return replace(self, rotation=rotation, translation=self.translation - rotation @ first.translation)

    @property
    def distorts(self) -> bool:
        """True if removing the distortion changes its pictures."""
        return any(self.distortion) or self.focal[0] != self.focal[1]

    @cached_property
    def _source_pixels(self) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
        """Mask of the pixels without distortion that the picture as taken shows, and their rows and columns there."""
        assert self.size is not None
        rows, columns = np.mgrid[: self.size[0], : self.size[1]]
        distorted = self.distort_points(np.stack([columns, rows], axis=-1) + 0.5)
        inside = np.all([distorted >= 0, distorted < self.size[::-1]], axis=(0, -1))
        u, v = np.moveaxis(np.where(inside[..., None], distorted, 0.0).astype(np.int64), -1, 0)
        return inside, (v, u)

    @property
    def _square(self) -> float:
        """Focal length without distortion [px]."""
        return math.sqrt(self.focal[0] * self.focal[1])

    @cached_property
    def _reach(self) -> float:
        """Radius at depth 1 up to which distortion keeps the order of radii."""
        with np.errstate(all="ignore"):
            distorted = _WIDEST * self._stretch(_WIDEST**2)
            outward = np.diff(distorted) > 0
        return math.inf if outward.all() else float(_WIDEST[outward.argmin()])

    def _stretch(self, square: np.ndarray) -> np.ndarray:
        """Factor by which distortion stretches radii, given their squares."""
        k1, k2, _, _, k3, k4, k5, k6 = (*self.distortion, *[0.0] * (8 - len(self.distortion)))
        return (1 + square * (k1 + square * (k2 + square * k3))) / (1 + square * (k4 + square * (k5 + square * k6)))

    def _distort(self, points: np.ndarray) -> np.ndarray:
        """Distort points (..., 2) at depth 1 as the lens does."""
        _, _, p1, p2 = (*self.distortion, *[0.0] * 4)[:4]
        x, y = np.moveaxis(points, -1, 0)
        with np.errstate(all="ignore"):
            square = x * x + y * y
            stretch = self._stretch(square)
            across = x * stretch + 2 * p1 * x * y + p2 * (square + 2 * x * x)
            down = y * stretch + p1 * (square + 2 * y * y) + 2 * p2 * x * y
        return np.stack([across, down], axis=-1)


def _same_shape(own: tuple[int, int], new: tuple[int, int], zoom: float) -> bool:
    """True if sizes [px] agree after a zoom, except for rounding; or if one side agrees and the other one is padded."""
    sides = [(zoom * one, other) for one, other in zip(own, new, strict=True)]
    if all(abs(one - other) <= _ROUNDING for one, other in sides):
        return True
    if all(abs(one - other) > _WHOLE for one, other in sides):
        return False
    # Pictures are padded before they are resized, or after.
    return all(
        abs(zoom * one - other) <= _WHOLE or _is_padded(zoom * one, other) or _is_padded(one, other / zoom)
        for one, other in zip(own, new, strict=True)
    )


def _is_padded(one: float, other: float) -> bool:
    """True if the longer length [px] is the next multiple of a codec's block after the shorter one."""
    short, long = sorted((one, other))
    whole = abs(short - round(short)) < _WHOLE
    return whole and any(long == block * math.ceil(short / block) for block in _BLOCKS)
