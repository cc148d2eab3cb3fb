"""The exact renderer's gradient "coverage": the derivative of the loss as an integral over the picture.

The loss is the integral of costs[label shown at (x, y)] of the pixel that holds (x, y), which is ``area_cost``, and the
gradient is its derivative. Central differences of ``area_cost`` would be that, but pixels whose costs differ make
kinks, and opposite sides of an ellipsoid nearly cancel: 1 % of noise and more. So ``coverage_gradient`` sums over the
borders on many lines a pixel, and differences check it where they can.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .ellipsoids import EllipsoidScene, boxes, drawable, fronts, meet, ray_in_unit_space


def dense_costs(maps: np.ndarray) -> np.ndarray:
    """Costs of area that shows background, label 1 to K, or anything else: (K + 2, H, W)."""
    nothing = np.zeros((1, *maps.shape[1:]))
    return np.concatenate([nothing, maps, nothing])


def target_costs(target: np.ndarray, num_labels: int) -> np.ndarray:
    """Costs of area as of ``dense_costs``, for L_seg.

    A wrong pixel misses one map and dirties another. Labels 0 and 255 have no map.
    """
    shown = np.arange(num_labels + 2)[:, None, None]
    has_map = (shown > 0) & (shown <= num_labels)
    costs = np.where(shown == target, 0.0, has_map.astype(float) + (target > 0))
    return np.where(target == 255, 0.0, costs)


@dataclass(frozen=True)
class PictureBorders:
    """Places where lines along one axis of the picture leave the part ``before`` and enter ``after`` (0 = background).

    ``kind`` says whose surface bounds: 1 = the outline of ``before``, -1 = that of ``after``, 0 = a crease, where both
    are there and equally deep, at ``depth``.
    """

    x: np.ndarray
    y: np.ndarray
    before: np.ndarray
    after: np.ndarray
    kind: np.ndarray
    depth: np.ndarray


def borders_on_lines(
    scene: EllipsoidScene, size: tuple[int, ...], axis: int, lines: int, spacing: float = 1 / 32, halvings: int = 24
) -> PictureBorders:
    """All borders on ``lines`` lines a pixel along ``axis``: looked for between places ``spacing`` px apart."""
    along = np.arange(size[1 - axis] / spacing + 1) * spacing
    across = (np.arange(size[axis] * lines) + 0.5) / lines
    depth, shown = np.full((len(across), len(along)), np.inf), np.zeros((len(across), len(along)), dtype=int)
    bounds = boxes(scene)
    for k in np.flatnonzero(drawable(scene)).tolist():
        spot = tuple(
            slice(*np.searchsorted(places, (bounds[k, way], bounds[k, way + 2])))
            for places, way in ((across, 1 - axis), (along, axis))
        )
        front = fronts(scene, *on_line(axis, *np.meshgrid(along[spot[1]], across[spot[0]])), [k])[k]
        shown[spot] = np.where(front < depth[spot], k + 1, shown[spot])
        depth[spot] = np.minimum(front, depth[spot])

    def shown_at(along: np.ndarray, across: np.ndarray) -> np.ndarray:
        depths = fronts(scene, *on_line(axis, along, across))
        return np.where(np.isfinite(depths.min(0)), depths.argmin(0) + 1, 0)

    row, place = np.nonzero(shown[:, 1:] != shown[:, :-1])
    todo = along[place], along[place + 1], across[row], shown[row, place], shown[row, place + 1]
    found = []
    while len(todo[0]):
        low, high, across, before, after = todo
        end = high
        for _ in range(halvings):
            middle = (low + high) / 2
            same = shown_at(middle, across) == before
            low, high = np.where(same, middle, low), np.where(same, high, middle)
        entered = shown_at(high, across)
        found.append((low, high, across, before, entered))
        rest = entered != after  # something narrow lies in between
        todo = tuple(values[rest] for values in (high, end, across, entered, after))
    low, high, across, before, after = (np.concatenate(values) for values in zip(*found, strict=True))
    kind = np.zeros(len(low), dtype=int)
    for k in range(len(scene.centres)):
        kind[(after == k + 1) & ~np.isfinite(fronts(scene, *on_line(axis, low, across), [k])[k])] = -1
        kind[(before == k + 1) & ~np.isfinite(fronts(scene, *on_line(axis, high, across), [k])[k])] = 1
    x, y = on_line(axis, (low + high) / 2, across)
    return PictureBorders(x, y, before, after, kind, fronts(scene, x, y).min(0))


def on_line(axis: int, along: np.ndarray, across: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates (x, y) of places on lines along an axis."""
    return (along, across) if axis == 0 else (across, along)


def cost_index(scene: EllipsoidScene, costs: np.ndarray) -> np.ndarray:
    """Index in ``costs`` that each part takes, 0 = background."""
    return np.minimum(np.r_[0, scene.labels], len(costs) - 1)


def area_cost(scene: EllipsoidScene, costs: np.ndarray, lines: int = 16) -> float:
    """Integral of costs[label shown] over the picture: exact along x, by the midpoint rule along y."""
    size = costs.shape[1:]
    borders = borders_on_lines(scene, size, 0, lines)
    label_of = cost_index(scene, costs)
    summed = np.concatenate([np.zeros((*costs.shape[:2], 1)), costs.cumsum(2)], 2)

    def cost_left_of(part: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Cost of the line through y from the picture's left border to x, if it showed this part."""
        label, row, column = label_of[part], y.astype(int), np.minimum(x.astype(int), size[1] - 1)
        return summed[label, row, column] + costs[label, row, column] * (x - column)

    # A line that shows a, b, c up to x1, x2, W costs a(x1) - a(0) + b(x2) - b(x1) + c(W) - c(x2).
    y = (np.arange(size[0] * lines) + 0.5) / lines
    depths = fronts(scene, np.full_like(y, size[1]), y)
    last = np.where(np.isfinite(depths.min(0)), depths.argmin(0) + 1, 0)
    total = cost_left_of(last, np.full_like(y, size[1]), y).sum()
    for part, sign in ((borders.before, 1.0), (borders.after, -1.0)):
        total += sign * cost_left_of(part, borders.x, borders.y).sum()
    return total / lines


def front_near(scene: EllipsoidScene, k: int, x: np.ndarray, y: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Depth of ellipsoid k's front, to first order, where it is nearly ``depth``: smooth across its outline too."""
    origin, direction = ray_in_unit_space(scene, k, x, y)
    place = origin + depth * direction
    return depth - ((place**2).sum(0) - 1) / (2 * (place * direction).sum(0))


def border_value(scene: EllipsoidScene, borders: PictureBorders, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A function that is 0 on each border and positive on the side of ``before``."""
    value = np.zeros_like(x)
    for k in range(len(scene.centres)):
        for parts, sign in ((borders.before, 1.0), (borders.after, -1.0)):
            mine = (parts == k + 1) & (borders.kind == sign)
            value[mine] += sign * meet(scene, k, x[mine], y[mine])[0]
            mine = (parts == k + 1) & (borders.kind == 0)
            value[mine] -= sign * front_near(scene, k, x[mine], y[mine], borders.depth[mine])
    return value


def turned(axes: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Axes turned by a rotation vector (Rodrigues)."""
    angle = np.linalg.norm(turn)
    K = np.cross(np.eye(3), turn / angle)  # K v = turn x v / angle
    return (np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K) @ axes


NAMES = ("centres", "turns", "semi_axes", "camera")  # turns: small rotations from the left


def moved(scene: EllipsoidScene, name: str, index: tuple[int, ...], step: float) -> EllipsoidScene:
    """The scene with one of the numbers changed that ``coverage_gradient`` is about."""
    if name == "turns":
        axes = scene.axes.copy()
        axes[index[0]] = turned(axes[index[0]], step * np.eye(3)[index[1]])
        return replace(scene, axes=axes)
    values = getattr(scene, name).copy()
    values[index] += step
    return replace(scene, **{name: values})


def no_gradient(scene: EllipsoidScene) -> dict[str, np.ndarray]:
    """Zeros of each of NAMES: (P, 3), (P, 3), (P, 3) and (4,)."""
    return {name: np.zeros(4 if name == "camera" else scene.centres.shape) for name in NAMES}


def coverage_gradient(
    scene: EllipsoidScene, costs: np.ndarray, lines: int = 16, tiny: float = 1e-6
) -> dict[str, np.ndarray]:
    """Derivative of the area's cost with respect to NAMES.

    Where phi = 0 is a border, a change of phi moves it by -dphi / |grad phi| along its normal, and what the loss then
    gains on a bit of border is (cost before - cost after) times way times length. Lines along x take the share n_x^2 of
    each bit and lines along y the share n_y^2, so that none has to divide by how steeply it meets the border.
    """
    label_of = cost_index(scene, costs)
    gradients = no_gradient(scene)
    for axis in (0, 1):
        borders = borders_on_lines(scene, costs.shape[1:], axis, lines)
        x, y = borders.x, borders.y
        row, column = np.minimum(y.astype(int), costs.shape[1] - 1), np.minimum(x.astype(int), costs.shape[2] - 1)
        excess = costs[label_of[borders.before], row, column] - costs[label_of[borders.after], row, column]
        step = tiny / scene.camera[0] * np.linalg.norm(scene.camera[:2])
        slope_x = (border_value(scene, borders, x + step, y) - border_value(scene, borders, x - step, y)) / (2 * step)
        slope_y = (border_value(scene, borders, x, y + step) - border_value(scene, borders, x, y - step)) / (2 * step)
        across = np.abs(slope_x if axis == 0 else slope_y)
        weight = excess * across / (slope_x**2 + slope_y**2) / lines
        for name, gradient in gradients.items():
            for index in np.ndindex(gradient.shape):
                ahead, back = (border_value(moved(scene, name, index, s), borders, x, y) for s in (tiny, -tiny))
                gradient[index] += (weight * (ahead - back)).sum() / (2 * tiny)
    return gradients
