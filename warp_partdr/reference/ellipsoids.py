"""The exact ellipsoids' picture, and PartDR's rule on them: the quadric solved for each ray.

Forward
    1. A pixel shows what its centre's ray meets first: in the space where the ellipsoid is the unit sphere, the ray
       comes as near to the sphere's centre as sqrt(1 - margin), and meets it where the margin is positive.
    2. Of equal depths, the lower index shows. An ellipsoid that reaches the near plane, or the camera, is not drawn.
    3. Label 255 hides what is behind it and means nothing.

Backward, beside the choices of ``partdr``
    4. Every line of pixels that crosses an ellipsoid's outline crosses it twice; there the discriminant of the quadric
       is 0. The crossing's derivative is a force in the picture on that point of the surface, and eq. 12 gives forces
       along z on the front points of the hidden and the hiding ellipsoid.
    5. Forces on surface points X = c + A diag(a) u, u on the unit sphere, become gradients by the chain rule, u held
       fixed.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from .partdr import PixelLine, Rule, depth_slope, line_slope


@dataclass(frozen=True)
class EllipsoidScene:
    """P ellipsoids of one body and their camera.

    Attributes:
        centres: Centres in the camera frame [m], shape (P, 3).
        axes: Axes of each ellipsoid as columns, shape (P, 3, 3).
        semi_axes: Semi-axes [m], shape (P, 3).
        camera: Numbers f_x, f_y, c_x, c_y [px]. Under weak perspective, f is in pixels for each metre.
        labels: Label of each ellipsoid, shape (P,).
        perspective: True for perspective, and False for weak perspective.
        near: Depth of the near plane [m].
    """

    centres: np.ndarray
    axes: np.ndarray
    semi_axes: np.ndarray
    camera: np.ndarray
    labels: np.ndarray
    perspective: bool = False
    near: float = -np.inf


def ray(scene: EllipsoidScene, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Origin and direction (3, ...) of the rays through places of the picture; a ray's parameter is its depth."""
    fx, fy, cx, cy = scene.camera
    across = np.stack([(x - cx) / fx, (y - cy) / fy, np.zeros_like(x)])
    ahead = np.stack([np.zeros_like(x), np.zeros_like(x), np.ones_like(x)])
    return (np.zeros_like(across), across + ahead) if scene.perspective else (across, ahead)


def ray_in_unit_space(scene: EllipsoidScene, k: int, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Origin and direction (3, ...) of the rays of ``ray``, in the space where ellipsoid k is the unit sphere."""
    origin, direction = ray(scene, x, y)
    to_unit = (scene.axes[k] / scene.semi_axes[k]).T
    shape = (3,) + (1,) * (origin.ndim - 1)
    return np.tensordot(to_unit, origin - scene.centres[k].reshape(shape), 1), np.tensordot(to_unit, direction, 1)


def meet(scene: EllipsoidScene, k: int, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Margin (positive where rays meet ellipsoid k) and depth of its front there; elsewhere, of its nearest point."""
    origin, direction = ray_in_unit_space(scene, k, x, y)
    length2 = (direction**2).sum(0)
    closest = -(origin * direction).sum(0) / length2
    margin = 1 - ((origin + closest * direction) ** 2).sum(0)
    return margin, closest - np.sqrt(np.maximum(margin, 0) / length2)


def half_extents(scene: EllipsoidScene) -> np.ndarray:
    """Half of each ellipsoid's size along x, y and z, (P, 3)."""
    return np.sqrt(((scene.axes * scene.semi_axes[:, None]) ** 2).sum(2))


def drawable(scene: EllipsoidScene) -> np.ndarray:
    """True for ellipsoids that lie behind the near plane and do not hold the camera, (P,)."""
    return scene.centres[:, 2] - half_extents(scene)[:, 2] > max(scene.near, 0.0 if scene.perspective else -np.inf)


def boxes(scene: EllipsoidScene) -> np.ndarray:
    """A box (left, top, right, bottom) [px] that holds each drawn ellipsoid's picture, (P, 4)."""
    signs = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), -1).reshape(8, 3)
    corners = scene.centres[:, None] + signs * half_extents(scene)[:, None]
    places = corners[..., :2] / (corners[..., 2:] if scene.perspective else 1.0) * scene.camera[:2] + scene.camera[2:]
    return np.concatenate([places.min(1), places.max(1)], 1)


def fronts(scene: EllipsoidScene, x: np.ndarray, y: np.ndarray, which: Iterable[int] | None = None) -> np.ndarray:
    """Depth of every ellipsoid's front, inf where it is not, (P, ...)."""
    depths = np.full((len(scene.centres), *x.shape), np.inf)
    for k in np.flatnonzero(drawable(scene)).tolist() if which is None else which:
        margin, front = meet(scene, k, x, y)
        depths[k] = np.where(margin > 0, front, np.inf)
    return depths


def pixel_centres(size: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Columns and rows of the centres, each (H, W)."""
    y, x = np.mgrid[: size[0], : size[1]] + 0.5
    return x, y


def ray_cast(scene: EllipsoidScene, size: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Labels, parts (index + 1) and depth of one body: eq. 8 and 9 of ellipsoids."""
    depths = fronts(scene, *pixel_centres(size))
    depth = depths.min(0)
    parts = np.where(np.isfinite(depth), depths.argmin(0) + 1, 0)
    return np.r_[0, scene.labels][parts], parts, depth


def doubt(scene: EllipsoidScene, size: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Certainty of the picture: the smallest |margin| of any ellipsoid at each pixel, and the nearest's lead [m]."""
    x, y = pixel_centres(size)
    margins = [np.abs(meet(scene, k, x, y)[0]) for k in np.flatnonzero(drawable(scene)).tolist()]
    depths = np.sort(fronts(scene, x, y), 0)
    with np.errstate(invalid="ignore"):
        lead = depths[1] - depths[0] if len(depths) > 1 else np.full(size, np.inf)
    return np.min([np.full(size, np.inf), *margins], 0), np.where(np.isfinite(depths[0]), lead, np.inf)


class EllipsoidForces:
    """Gradients, gathered from forces on surface points."""

    def __init__(self, scene: EllipsoidScene) -> None:
        self.scene = scene
        self.centres, self.axes = np.zeros_like(scene.centres), np.zeros_like(scene.axes)
        self.semi_axes, self.camera = np.zeros_like(scene.semi_axes), np.zeros(4)

    def push(self, k: int, point: np.ndarray, force: np.ndarray) -> None:
        """Add dL/dX = force of a surface point."""
        axes, semi_axes = self.scene.axes[k], self.scene.semi_axes[k]
        unit = axes.T @ (point - self.scene.centres[k]) / semi_axes
        self.centres[k] += force
        self.axes[k] += np.outer(force, semi_axes * unit)
        self.semi_axes[k] += (axes.T @ force) * unit

    def push_image(self, k: int, point: np.ndarray, force: np.ndarray) -> None:
        """Add dL/d(u, v) = force of a surface point's picture."""
        fx, fy = self.scene.camera[:2]
        X, Y, Z = point
        if self.scene.perspective:
            jacobian = np.array([[fx / Z, 0, -fx * X / Z**2], [0, fy / Z, -fy * Y / Z**2]])
            plane = np.array([X / Z, Y / Z])
        else:
            jacobian = np.array([[fx, 0, 0], [0, fy, 0]])
            plane = np.array([X, Y])
        self.push(k, point, force @ jacobian)
        self.camera += np.concatenate([force * plane, force])


def point_at(scene: EllipsoidScene, x: float, y: float, depth: float) -> np.ndarray:
    """The point of the scene that is seen at (x, y) in this depth."""
    origin, direction = ray(scene, np.asarray(x), np.asarray(y))
    return origin + depth * direction


def crossings(scene: EllipsoidScene, k: int, axis: int, line: int) -> list[float]:
    """Crossings of a row's (axis 0) or column's centre line with an outline: none, or the low end and the high end."""

    def discriminant(place: np.ndarray) -> np.ndarray:
        centre = np.full_like(place, line + 0.5)
        origin, direction = ray_in_unit_space(scene, k, *((place, centre) if axis == 0 else (centre, place)))
        length2 = (direction**2).sum(0)
        closest = origin - (origin * direction).sum(0) / length2 * direction
        return length2 * (1 - (closest**2).sum(0))  # a difference of squares would cancel where thickness is small

    # A quadratic along the line: three values tell it.
    bounds = boxes(scene)[k]
    middle, half = (bounds[axis] + bounds[2 + axis]) / 2, (bounds[2 + axis] - bounds[axis]) / 2
    before, here, after = discriminant(middle + half * np.array([-1.0, 0.0, 1.0]))
    a, b, c = (after + before) / 2 - here, (after - before) / 2, here
    if b * b - 4 * a * c <= 0:
        return []
    root = np.sqrt(b * b - 4 * a * c)
    return [middle + half * t for t in sorted([(-b - root) / (2 * a), (-b + root) / (2 * a)])]


def outline_depth(scene: EllipsoidScene, k: int, x: float, y: float) -> float:
    """Depth at which a ray touches ellipsoid k."""
    origin, direction = ray_in_unit_space(scene, k, np.asarray(x), np.asarray(y))
    return -(origin @ direction) / (direction @ direction)


def partdr_gradient(scene: EllipsoidScene, parts: np.ndarray, g: np.ndarray, **rule: Any) -> EllipsoidForces:
    """Gradients of centres, axes, semi_axes and camera, from the picture of parts and g of shape (K, H, W).

    ``rule`` are the fields of ``Rule``.
    """
    options = Rule(**rule)
    parts = parts.astype(int)
    forces = EllipsoidForces(scene)
    shown = np.r_[0, scene.labels][parts]
    depth = fronts(scene, *pixel_centres(parts.shape))
    depth = np.where(parts > 0, np.take_along_axis(depth, np.maximum(parts - 1, 0)[None], 0)[0], np.inf)
    for k in np.flatnonzero(drawable(scene)).tolist():
        label = scene.labels[k]
        if label > len(g):
            continue
        for axis in (0, 1):
            images = [image if axis == 0 else image.T for image in (shown, depth, g[label - 1])]
            for line in range(parts.shape[axis]):
                pixels = PixelLine(*(image[line] for image in images))
                for side, crossing in zip((-1, 1), crossings(scene, k, axis, line), strict=False):
                    x, y = (crossing, line + 0.5) if axis == 0 else (line + 0.5, crossing)
                    z = outline_depth(scene, k, x, y)
                    slope = line_slope(pixels, label, side, crossing, z, options)
                    if slope:
                        forces.push_image(k, point_at(scene, x, y, z), slope * np.eye(2)[axis])
    if options.depth_weight:
        add_depth_forces(forces, shown, parts, g, options.depth_weight)
    return forces


def add_depth_forces(
    forces: EllipsoidForces, shown: np.ndarray, parts: np.ndarray, g: np.ndarray, depth_weight: float
) -> None:
    """Add the forces along z: eq. 12 at every pixel that shows something."""
    scene = forces.scene
    depths = fronts(scene, *pixel_centres(parts.shape))
    for row, column in zip(*np.nonzero(parts), strict=True):
        x, y = column + 0.5, row + 0.5
        front = int(parts[row, column]) - 1
        for label in set(scene.labels) - {shown[row, column]}:
            there = np.where(scene.labels == label, depths[:, row, column], np.inf)
            back = int(there.argmin())
            if label > len(g) or not np.isfinite(there[back]):
                continue
            amount = g[label - 1, row, column] * depth_slope(there[back] - depths[front, row, column], depth_weight)
            for k, sign in ((back, 1.0), (front, -1.0)):
                point = point_at(scene, x, y, depths[k, row, column])
                forces.push(k, point, np.array([0, 0, sign * amount]))
