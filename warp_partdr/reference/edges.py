"""The exact renderer's gradient "edges", every derivative by differences.

1. Each two neighbouring pixels that show different labels have a border between their centres, crossed by the line
   through both.
2. Where one's ellipsoid ends before the other's begins, background lies between: two borders, each an outline. Where
   they overlap, it is the outline of the one that is nearer there, or else a crease, where both are equally near.
3. The border's place along the line moves with the ellipsoids and the camera. A pixel's length of area changes hands
   as it moves, so the loss changes by (cost inside - cost outside) of the pixel that holds the place. A row and a
   column share a border by the squares of its normal.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from .coverage import cost_index, moved, no_gradient
from .ellipsoids import EllipsoidScene, meet

STEP = 1e-7  # small, for fronts are steep near their outlines

Value = Callable[[EllipsoidScene, np.ndarray], float]  # at a place of the picture
# Place, ellipsoid inside, outside (-1 = none), side (1 where outside lies ahead), a function that is positive inside
# and 0 at the border, and the ellipsoids on which it depends.
Border = tuple[np.ndarray, int, int, float, Value, list[int]]


def edges_gradient(
    scene: EllipsoidScene, parts: np.ndarray, costs: np.ndarray
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Gradients by name, as ``coverage_gradient`` gives them, of the picture that shows ``parts``.

    And the same with what every border adds taken as positive: of opposite sides little may be left, and errors are a
    share of what was added.
    """
    total, sizes = no_gradient(scene), no_gradient(scene)
    labels = np.r_[0, scene.labels]
    for axis in (0, 1):
        ahead = np.eye(2)[axis]
        here, there = (parts[:, :-1], parts[:, 1:]) if axis == 0 else (parts[:-1], parts[1:])
        for row, column in np.argwhere(labels[here] != labels[there]):
            start = np.array([column, row]) + 0.5
            for border in borders_between(scene, int(here[row, column]) - 1, int(there[row, column]) - 1, start, ahead):
                for name, at, value in pushes(total, scene, costs, border, axis):
                    total[name][at] += value
                    sizes[name][at] += abs(value)
    return total, sizes


def borders_between(
    scene: EllipsoidScene, first: int, second: int, start: np.ndarray, ahead: np.ndarray
) -> list[Border]:
    """All borders between two pixel centres."""

    def margin(k: int) -> Value:
        return lambda scene, p: float(meet(scene, k, p[0], p[1])[0])

    def depth(k: int) -> Value:
        return lambda scene, p: float(meet(scene, k, p[0], p[1])[1])

    def leave(k: int, start: np.ndarray, ahead: np.ndarray) -> float:
        """Share of the way ahead where an ellipsoid ends, which covers the start; 1 at most."""
        return bisect(lambda t: margin(k)(scene, start + t * ahead))

    ends = [(first, start, ahead, 1.0), (second, start + ahead, -ahead, -1.0)]
    if first >= 0 and second >= 0:
        end, begin = leave(first, start, ahead), 1 - leave(second, start + ahead, -ahead)
        if end >= begin:

            def in_front(scene: EllipsoidScene, p: np.ndarray) -> float:
                return depth(second)(scene, p) - depth(first)(scene, p)

            if end < 1 and in_front(scene, start + end * ahead) > 0:
                return [(start + end * ahead, first, second, 1.0, margin(first), [first])]
            if begin > 0 and in_front(scene, start + begin * ahead) < 0:
                return [(start + begin * ahead, second, first, -1.0, margin(second), [second])]
            t = begin + (end - begin) * bisect(lambda t: in_front(scene, start + (begin + t * (end - begin)) * ahead))
            return [(start + t * ahead, first, second, 1.0, in_front, [first, second])]
    return [(p + leave(k, p, way) * way, k, -1, side, margin(k), [k]) for k, p, way, side in ends if k >= 0]


def bisect(function: Callable[[float], float]) -> float:
    """The place in 0 to 1 where a function stops to be positive."""
    low, high = 0.0, 1.0
    if function(1.0) > 0:
        return 1.0
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if function(middle) > 0 else (low, middle)
    return 0.5 * (low + high)


def pushes(
    like: dict[str, np.ndarray], scene: EllipsoidScene, costs: np.ndarray, border: Border, axis: int
) -> Iterator[tuple[str, tuple[int, ...], float]]:
    """Shares of one border in each number: (name, index, value)."""
    place, inside, outside, side, function, owners = border
    row, column = np.minimum(place[::-1].astype(int), np.array(costs.shape[1:]) - 1)
    index = cost_index(scene, costs)
    excess = costs[index[inside + 1], row, column] - costs[index[outside + 1], row, column]
    slope = np.array(
        [(function(scene, place + step) - function(scene, place - step)) / (2 * STEP) for step in STEP * np.eye(2)]
    )
    share = slope[axis] ** 2 / (slope @ slope)
    for name, gradient in like.items():
        for at in np.ndindex(gradient.shape):
            if name != "camera" and at[0] not in owners:
                continue
            size = STEP if name != "camera" else 1e-5
            change = [function(moved(scene, name, at, sign * size), place) for sign in (1, -1)]
            moves = -(change[0] - change[1]) / (2 * size) / slope[axis]
            yield name, at, excess * side * share * moves
