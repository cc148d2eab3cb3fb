"""Depth by which capsules stand in one another, of our own: what keeps parts and people apart."""

from __future__ import annotations

from itertools import combinations

import numpy as np


def body_overlap_costs(capsules: np.ndarray, allowed: np.ndarray, slack: float, places: np.ndarray) -> np.ndarray:
    """Sums of the squares of depths beyond those allowed [cm^2], shape (B,); two bodies share a pair's half and half.

    Args:
        capsules: Both ends and the radius [m], shape (B, C, 7).
        allowed: Depth that costs nothing within a body [m], infinite if none costs, shape (C, C).
        slack: Depth that costs nothing between two bodies [m].
        places: Index of the place of each body, shape (B,). Only bodies at the same place can meet.
    """
    costs = np.zeros(len(capsules))
    every = [(body, k) for body in range(capsules.shape[0]) for k in range(capsules.shape[1])]
    for (body, one), (other_body, other) in combinations(every, 2):
        if places[body] == places[other_body]:
            free = allowed[one, other] if body == other_body else slack
            depth = penetration(capsules[body, one], capsules[other_body, other]) - free
            for sharing in (body, other_body):
                costs[sharing] += 0.5 * (100 * max(depth, 0.0)) ** 2
    return costs


def penetration(one: np.ndarray, other: np.ndarray) -> float:
    """Sum of the radii less the distance of the lines [m]."""
    return float(one[6] + other[6] - line_distance(one[:3], one[3:6], other[:3], other[3:6]))


def line_distance(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> float:
    """Distance of the lines between a and b, and c and d: within both, or from an end of one to the other."""
    ends = [to_line(a, c, d), to_line(b, c, d), to_line(c, a, b), to_line(d, a, b)]
    matrix = np.stack([b - a, c - d], axis=1)
    if np.linalg.matrix_rank(matrix) == 2:
        shares = np.linalg.lstsq(matrix, c - a, rcond=None)[0]
        if (shares >= 0).all() and (shares <= 1).all():
            return float(np.linalg.norm(matrix @ shares - (c - a)))
    return min(ends)


def to_line(point: np.ndarray, start: np.ndarray, end: np.ndarray) -> float:
    """Distance of a point from the line between two ends."""
    along = end - start
    share = np.clip((point - start) @ along / max(along @ along, 1e-300), 0.0, 1.0)
    return float(np.linalg.norm(point - start - share * along))
