"""Bones, flesh and limbs of many people by their keypoints, as arrays for kernels.

All people have one skeleton. Lines that are there stand first in each person's row; how many they are stands beside.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..body.landmarks import without_side
from ..body.skeletons import Skeleton, skeleton
from .agreement import limbs_between, segments_of_parts
from .ignored_labels import limb_extent
from .keypoints import confident, person_heights
from .person import LOOSE_REACH, MIN_SEED_RADIUS, REACH, SEED_RADIUS, loose_ends

_SHORTEST = 1e-12  # [px^2], of a line's square


@dataclass(frozen=True)
class BodyLines:
    """Lines of N people, and their numbers.

    Attributes:
        heights: Of the people [px], shape (N,).
        bones: Between confident keypoints, and points that must be near, shape (N, S, 7), float32: start (x, y), way to
            the end, its square, squared distance up to which pixels are near, distance up to which they are seeds.
        num_bones: Shape (N,), int32.
        flesh: Segments near which the parts are, shape (N, F, 6): the same first five, then the flesh's radius as a
            share of the height.
        num_flesh: Shape (N,); 0 where keypoints of a part are missing.
        limbs: Bones of limbs, shape (N, L, 4): start and way to the end.
        around: What is ignored about them where they are missing, shape (N, L, 7), float32, as ``bones``.
        num_limbs: Shape (N,).
    """

    heights: np.ndarray
    bones: np.ndarray
    num_bones: np.ndarray
    flesh: np.ndarray
    num_flesh: np.ndarray
    limbs: np.ndarray
    around: np.ndarray
    num_limbs: np.ndarray


def body_lines(form: str | Skeleton, points: np.ndarray, confidence: np.ndarray) -> BodyLines:
    """Lines of N people: points (N, J, 2) [px], float32, and confidence (N, J)."""
    sure, heights = confident(confidence), person_heights(form, points, confidence)
    bones, num_bones = _first(_bones(form, points, sure, heights), _are_bones(form, sure))
    segments, parts = _flesh(form)
    ends = points[:, segments[:, :2].astype(np.int64)]
    flesh = np.concatenate(
        [_lines(ends, np.float32), np.broadcast_to(segments[:, 2:], (len(points), len(segments), 1))], axis=2
    )
    there = _both(sure, segments[:, :2].astype(np.int64))
    complete = np.ones(len(points), dtype=bool)
    for rows, any_serves in parts:
        complete &= there[:, rows].any(axis=1) if any_serves else there[:, rows].all(axis=1)
    flesh, num_flesh = _first(flesh, there & complete[:, None])
    joints, extents = _limbs(form)
    ends = points[:, joints]
    limbs = np.concatenate([ends[:, :, 0], ends[:, :, 1] - ends[:, :, 0]], axis=2).astype(np.float64)
    whole = np.stack([ends[:, :, 0], ends[:, :, 1] + (ends[:, :, 1] - ends[:, :, 0]) * extents[:, 1:]], axis=2)
    limits = (extents[:, 0] * heights[:, None]) ** 2
    below = limits.astype(np.float32)
    below = np.where(below > limits, np.nextafter(below, np.float32(0.0)), below)  # compared with in float64
    around = np.concatenate([_lines(whole, np.float64), below[..., None], below[..., None]], axis=2).astype(np.float32)
    there = _both(sure, joints)
    (limbs, num_limbs), (around, _) = _first(limbs, there), _first(around, there)
    return BodyLines(heights, bones.astype(np.float32), num_bones, flesh, num_flesh, limbs, around, num_limbs)


def _both(sure: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Pairs of joints (S, 2) that are both among the confident ones (N, J), shape (N, S)."""
    return sure[:, joints[:, 0]] & sure[:, joints[:, 1]]


def _lines(ends: np.ndarray, kind: type) -> np.ndarray:
    """Start, way to the end and its square, of ends (N, S, 2, 2), counted in a precision: (N, S, 5)."""
    way: np.ndarray = ends[:, :, 1].astype(kind) - ends[:, :, 0].astype(kind)
    squares = np.maximum(way[..., :1] ** 2 + way[..., 1:] ** 2, kind(_SHORTEST))
    return np.concatenate([ends[:, :, 0], way, squares], axis=2).astype(np.float64)


def _first(lines: np.ndarray, there: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lines (N, S, D) with those that are there first, and how many they are."""
    order = np.argsort(~there, axis=1, kind="stable")
    return np.take_along_axis(lines, order[..., None], axis=1), there.sum(axis=1, dtype=np.int32)


def _bones(form: str | Skeleton, points: np.ndarray, sure: np.ndarray, heights: np.ndarray) -> np.ndarray:
    """Edges of the skeleton, then each joint alone, then each as a loose end, shape (N, E + 2 J, 7)."""
    joints = np.arange(points.shape[1])
    edges = np.array(skeleton(form).edges, dtype=np.int64).reshape(-1, 2)
    ends = points[:, np.concatenate([edges, np.stack([joints, joints], axis=1), np.stack([joints, joints], axis=1)])]
    near = np.maximum(REACH * heights, MIN_SEED_RADIUS)[:, None] ** 2
    seeds = np.maximum(SEED_RADIUS * heights, MIN_SEED_RADIUS)[:, None]
    loose = (LOOSE_REACH * heights)[:, None] ** 2
    own, alone = (len(points), len(edges) + len(joints)), (len(points), len(joints))
    limits = np.concatenate([np.broadcast_to(near, own), np.broadcast_to(loose, alone)], axis=1)
    radii = np.concatenate([np.broadcast_to(seeds, own), np.full(alone, -1.0)], axis=1)
    return np.concatenate([_lines(ends, np.float64), limits[..., None], radii[..., None]], axis=2)


def _are_bones(form: str | Skeleton, sure: np.ndarray) -> np.ndarray:
    """True for the rows of ``_bones`` that are there, shape (N, E + 2 J)."""
    edges = np.array(skeleton(form).edges, dtype=np.int64).reshape(-1, 2)
    whole = _both(sure, edges)
    alone = sure.copy()
    for edge, there in zip(edges, whole.T, strict=True):
        alone[:, edge] &= ~there[:, None]
    return np.concatenate([whole, alone, loose_ends(form, sure)], axis=1)


@lru_cache
def _flesh(form: str | Skeleton) -> tuple[np.ndarray, list[tuple[list[int], bool]]]:
    """Segments (F, 3) of all parts: two joints and a radius; rows of each part, and whether any of them serves."""
    names = {name: joint for joint, name in enumerate(skeleton(form).landmarks)}
    parts = segments_of_parts(names)
    rows = {segment: row for row, segment in enumerate(dict.fromkeys(each for some in parts.values() for each in some))}
    table = [
        ([rows[each] for each in some], without_side(part) in ("head", "neck") or not some)
        for part, some in parts.items()
    ]
    return np.array(list(rows), dtype=np.float64).reshape(-1, 3), table


@lru_cache
def _limbs(form: str | Skeleton) -> tuple[np.ndarray, np.ndarray]:
    """Joints (L, 2) of limbs' bones, and ``limb_extent`` of each (L, 2)."""
    names = {name: joint for joint, name in enumerate(skeleton(form).landmarks)}
    found = list(limbs_between(names))
    joints = np.array([(start, end) for _, start, end in found], dtype=np.int64).reshape(-1, 2)
    return joints, np.array([limb_extent(name) for name, _, _ in found]).reshape(-1, 2)
