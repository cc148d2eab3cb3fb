"""Bones, flesh and limbs of N people, found from their keypoints, as arrays for kernels.

All people have one skeleton. In each person's row, the bones whose keypoints are known come first; their number is
given beside the row.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from typing import NamedTuple, TypeVar

import numpy as np

from ..body.labels import LabelSet
from ..body.landmarks import mirror_name, without_side
from ..body.skeletons import Skeleton, skeleton
from ..body.template import JOINT_NAMES, MEAN_STATURE, PARENTS, PART_NAMES, SHAPE_INDICES, template
from .keypoints import confident
from .person import LOOSE_REACH, MIN_SEED_RADIUS, REACH, SEED_RADIUS, loose_ends

LIMBS: dict[str, tuple[str, ...]] = {
    "arms": ("upper_arm", "forearm", "hand"),
    "legs": ("upper_leg", "lower_leg", "foot"),
}

# Shares of the person's height.
_TRUNK = 0.06  # radius of flesh about the lines between shoulders and hips
_HEAD = 0.16  # radius of a head and its hair about any point of the face
_ENDS = {"hand": ("wrist", 0.11), "foot": ("ankle", 0.15)}  # their lengths, any way from the joint
_MARGIN = 0.01  # about how far keypoints are off

_FACE = ("nose", "left_eye", "right_eye", "left_ear", "right_ear", "head", "head_top")
_CORNERS = ("left_shoulder", "right_hip", "right_shoulder", "left_hip")

_SHORTEST = 1e-12  # [px^2], of a line's square
_SLACK = 1.0  # [px], more than the rounding of a distance

Segment = tuple[str, str, float]  # landmarks at both ends, and a radius as a share of the person's height
Point = TypeVar("Point")


@dataclass(frozen=True)
class Bones:
    """Bones of N people, and of others beside them.

    Attributes:
        reaches: Distances from bones and from loose ends, beyond which no pixel is the person's, and the distance
            within which a pixel lies along a bone [px], shape (N, 3).
        lines: Bones between confident keypoints, then lone keypoints and loose ends, as rows of
            ``kernels.own_pixels.Bone``, shape (N, S, 12).
        counts: Number of bones that are known, which are the first of ``lines``, shape (N,), int32.
        theirs: Bones of other people who come near, one person's after another's, as rows of the same kind, shape
            (T, 12).
        first_theirs: Index of the first of ``theirs`` beside each person, and their number T, shape (N + 1,), int32.
    """

    reaches: np.ndarray
    lines: np.ndarray
    counts: np.ndarray
    theirs: np.ndarray
    first_theirs: np.ndarray


@dataclass(frozen=True)
class Flesh:
    """Segments near which the groups of N people may be.

    Attributes:
        lines: Segments, one group's after another's: start, vector to the end, its squared length, and the flesh's
            radius as a share of the height, -1 where an end is missing, shape (N, F, 6).
        firsts: First segment of each group from 0 on, and their number, shape (G + 2,), int32.
        complete: Value 1 for groups whose keypoints are all known, shape (N, G + 1), uint8.
    """

    lines: np.ndarray
    firsts: np.ndarray
    complete: np.ndarray


@dataclass(frozen=True)
class Limbs:
    """Bones of limbs of N people.

    Attributes:
        lines: Start and vector to the end, shape (N, L, 4).
        around: Region that is ignored if the limb is missing: start, vector to the end, its squared length, and the
            largest squared distance from it, shape (N, L, 6), float32.
        known: Value 1 where both ends are known, shape (N, L), uint8.
    """

    lines: np.ndarray
    around: np.ndarray
    known: np.ndarray


class Points(NamedTuple):
    """Keypoints of some people with one skeleton."""

    form: str | Skeleton
    points: np.ndarray  # (M, J, 2) [px], float32
    confidence: np.ndarray  # (M, J)
    beside: np.ndarray  # (M,) index of the one among N people whom they are beside


def limbs_of(form: str | Skeleton, points: np.ndarray, confidence: np.ndarray, heights: np.ndarray) -> Limbs:
    """Find limbs of N people from points (N, J, 2) [px], float32, confidence (N, J), and heights (N,) [px]."""
    joints, extents = limb_table(form)
    ends = points[:, joints]
    limbs = np.concatenate([ends[:, :, 0], ends[:, :, 1] - ends[:, :, 0]], axis=2).astype(np.float64)
    whole = np.stack([ends[:, :, 0], ends[:, :, 1] + (ends[:, :, 1] - ends[:, :, 0]) * extents[:, 1:]], axis=2)
    limits = (extents[:, 0] * heights[:, None]) ** 2
    below = limits.astype(np.float32)
    below = np.where(below > limits, np.nextafter(below, np.float32(0.0)), below)  # compared with in float64
    around = np.concatenate([_lines(whole, np.float64), below[..., None]], axis=2).astype(np.float32)
    return Limbs(limbs, around, _both(confident(confidence), joints).astype(np.uint8))


def _both(confident: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """True for pairs of joints (S, 2) that are both among the confident ones (N, J), shape (N, S)."""
    return confident[:, joints[:, 0]] & confident[:, joints[:, 1]]


def _lines(ends: np.ndarray, dtype: type) -> np.ndarray:
    """Start, vector to the end and its squared length, computed in ``dtype`` from ends (..., 2, 2): (..., 5)."""
    vectors: np.ndarray = ends[..., 1, :].astype(dtype) - ends[..., 0, :].astype(dtype)
    squares = np.maximum(vectors[..., :1] ** 2 + vectors[..., 1:] ** 2, dtype(_SHORTEST))
    return np.concatenate([ends[..., 0, :], vectors, squares], axis=-1).astype(np.float64)


def _known_first(lines: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lines (N, S, D) in an order that begins with the known ones (N, S), and the number of those (N,)."""
    order = np.argsort(~known, axis=1, kind="stable")
    return np.take_along_axis(lines, order[..., None], axis=1), known.sum(axis=1, dtype=np.int32)


def bones_of(
    form: str | Skeleton, points: np.ndarray, confidence: np.ndarray, heights: np.ndarray, others: Sequence[Points]
) -> Bones:
    """Find bones of N people, given as for ``limbs_of``, and of others: skeleton edges, lone joints, and loose ends."""
    known_joints = confident(confidence)
    pairs, known = _bone_joints_of(form, known_joints)
    loose, joints = loose_ends(form, known_joints), np.arange(points.shape[1])
    ends = points[:, np.concatenate([pairs, np.stack([joints, joints], axis=1)])]
    reach = np.maximum(REACH * heights, MIN_SEED_RADIUS)
    seeds = np.maximum(SEED_RADIUS * heights, MIN_SEED_RADIUS)
    reaches = np.stack([reach, LOOSE_REACH * heights, seeds], axis=1)
    are_loose = np.arange(ends.shape[1]) >= len(pairs)
    lines = _bone_rows(
        ends, np.where(are_loose, reaches[:, 1:2], reaches[:, :1]), np.where(are_loose, -1.0, reaches[:, 2:])
    )
    lines, counts = _known_first(lines, np.concatenate([known, loose], axis=1))
    theirs, first_theirs = _others_bones(others, points, known_joints, reaches, np.any(loose, axis=1))
    return Bones(reaches, lines, counts, theirs, first_theirs)


def _bone_rows(ends: np.ndarray, reaches: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Rows of ``kernels.own_pixels.Bone`` for lines between ends (..., 2, 2), shape (..., 12)."""
    low, high = ends.min(axis=-2), ends.max(axis=-2)
    limits = [reaches[..., None] ** 2, radii[..., None], low, high, reaches[..., None] + _SLACK]
    return np.concatenate([_lines(ends, np.float64), *limits], axis=-1)


def _bone_joints_of(form: str | Skeleton, confident: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Joints at both ends of a skeleton's edges, then each joint twice, (S, 2), and a mask of those N people have.

    In the mask, (N, S), a person has an edge if both its joints are among the confident ones, (N, J). The person has a
    joint twice if it is confident and none of its neighbours is.
    """
    pairs, neighbours = _edges(form)
    edges = _both(confident, pairs[: len(pairs) - confident.shape[1]])
    return pairs, np.concatenate([edges, confident & ~(confident @ neighbours)], axis=1)


@lru_cache
def _edges(form: str | Skeleton) -> tuple[np.ndarray, np.ndarray]:
    """Joints at both ends of a skeleton's edges, then each joint twice, (S, 2); and a mask of neighbours, (J, J)."""
    joints = np.arange(len(skeleton(form)))
    edges = np.array(skeleton(form).edges, dtype=np.int64).reshape(-1, 2)
    neighbours = np.zeros((len(joints), len(joints)), dtype=bool)
    neighbours[edges[:, 0], edges[:, 1]] = neighbours[edges[:, 1], edges[:, 0]] = True
    return np.concatenate([edges, np.stack([joints, joints], axis=1)]), neighbours


def _others_bones(
    others: Sequence[Points], points: np.ndarray, known: np.ndarray, reaches: np.ndarray, loose: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """``Bones.theirs`` and ``first_theirs``: bones of others that come near a region that may be the person's."""
    if not others:
        return np.zeros((0, 12)), np.zeros(len(points) + 1, dtype=np.int32)
    reach = reaches[:, 0]
    farthest = np.where(loose, np.maximum(reaches[:, 1], reach), reach) + reach
    positions = points.astype(np.float64)
    low = np.where(known[..., None], positions, np.inf).min(axis=1) - farthest[:, None]
    high = np.where(known[..., None], positions, -np.inf).max(axis=1) + farthest[:, None]
    found: list[np.ndarray] = []
    owners: list[np.ndarray] = []
    for each in others:
        pairs, has_pair = _bone_joints_of(each.form, confident(each.confidence))
        person, row = has_pair.nonzero()
        ends, beside = each.points[person[:, None], pairs[row]], each.beside[person]
        near = (ends.min(axis=1) <= high[beside]).all(axis=1) & (ends.max(axis=1) >= low[beside]).all(axis=1)
        found.append(_bone_rows(ends[near], reach[beside[near]], np.zeros(near.sum())))
        owners.append(beside[near])
    owner = np.concatenate(owners)
    counts = np.bincount(owner, minlength=len(points))
    first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
    return np.concatenate(found)[np.argsort(owner, kind="stable")], first


def flesh_of(form: str | Skeleton, points: np.ndarray, confidence: np.ndarray, labels: LabelSet | None) -> Flesh:
    """Find flesh of N people's groups, if there are labels, from points (N, J, 2) [px], float32, and confidence."""
    table = _flesh_table(form, () if labels is None else tuple(labels.groups.items()))
    known = _both(confident(confidence), table.joints)
    radii = np.where(known, table.radii, -1.0)
    lines = np.concatenate([_lines(points[:, table.joints], np.float32), radii[..., None]], axis=2)
    complete = np.zeros((len(points), len(table.firsts) - 1), dtype=np.uint8)
    for group, parts in enumerate(table.parts, start=1):
        complete[:, group] = 1
        for rows, any_serves in parts:
            complete[:, group] &= known[:, rows].any(axis=1) if any_serves else known[:, rows].all(axis=1)
    return Flesh(lines, table.firsts, complete)


class _FleshTable(NamedTuple):
    """Segments of all groups, one group's after another, and what must be known of a group."""

    joints: np.ndarray  # at both ends, (F, 2)
    radii: np.ndarray  # (F,)
    firsts: np.ndarray  # first segment of each group from 0 on, and their number, (G + 2,), int32
    parts: list[list[tuple[list[int], bool]]]  # of each group from 1 on: segments of a part, and if any of them serves


@lru_cache(maxsize=256)
def _flesh_table(form: str | Skeleton, groups: tuple[tuple[str, tuple[str, ...]], ...]) -> _FleshTable:
    """Flesh of groups. It is that of all their parts and of their mirror images' parts, for sides may be exchanged."""
    names, known = dict(groups), {name: joint for joint, name in enumerate(skeleton(form).landmarks)}
    segments_of = segments_of_parts(known)
    joints: list[tuple[int, int]] = []
    radii: list[float] = []
    firsts, needed = [0, 0], []
    for name in names:
        either = [each for each in dict.fromkeys((name, mirror_name(name))) if each in names]
        parts = [part for each in either for part in names[each]]
        rows: dict[tuple[int, int, float], int] = {}
        for part in parts:
            for segment in segments_of[part]:  # parts share them
                rows.setdefault(segment, len(joints) + len(rows))
        joints += ((start, end) for start, end, _ in rows)
        radii += (radius for *_, radius in rows)
        firsts.append(len(joints))
        any_serves = ("head", "neck")
        needed.append(
            [
                ([rows[each] for each in segments_of[part]], without_side(part) in any_serves or not segments_of[part])
                for part in parts
            ]
        )
    table = np.array(joints, dtype=np.int64).reshape(-1, 2)
    return _FleshTable(table, np.array(radii, dtype=np.float64), np.array(firsts, dtype=np.int32), needed)


def segments_of_parts(points: Mapping[str, Point]) -> dict[str, list[tuple[Point, Point, float]]]:
    """Segments near which each part may be, between points of any kind; one of them is enough for a head or neck."""
    known = frozenset(points)
    return {
        part: [(points[start], points[end], radius) for start, end, radius in _part_segments(part, known)]
        for part in PART_NAMES
    }


def _part_segments(part: str, known: frozenset[str]) -> Iterator[Segment]:
    """Segments near which a part may be; empty if its keypoints are missing."""
    kind = without_side(part)
    side = part.removesuffix(kind)
    if kind in ("hip", "abdomen", "chest", "shoulder"):
        if known >= set(_CORNERS):
            for start, end in combinations(_CORNERS, 2):
                yield start, end, _TRUNK
    elif kind in ("head", "neck"):
        for name in _FACE:
            if name in known:
                yield name, name, _HEAD
    elif kind in _ENDS:
        joint, length = _ENDS[kind]
        if side + joint in known:
            yield side + joint, side + joint, length
    else:
        start, end = _bone_joints(part)
        if known >= {start, end}:
            thickness = float(template().mean_thicknesses[SHAPE_INDICES[PART_NAMES.index(part)][1]])
            yield start, end, thickness / (2 * MEAN_STATURE)


def _bone_joints(name: str) -> tuple[str, str]:
    """Joints at both ends of a part's bone."""
    part = PART_NAMES.index(name)
    return JOINT_NAMES[PARENTS[part] + 1], JOINT_NAMES[part + 1]


@lru_cache
def limb_names(form: str | Skeleton) -> tuple[str, ...]:
    """Names of the L limb parts whose bones a skeleton has, from one of its joints to another."""
    known = set(skeleton(form).landmarks)
    every = (f"{side}_{kind}" for side in ("left", "right") for kinds in LIMBS.values() for kind in kinds)
    return tuple(name for name in every if without_side(name) not in _ENDS and known >= set(_bone_joints(name)))


@lru_cache
def limb_table(form: str | Skeleton) -> tuple[np.ndarray, np.ndarray]:
    """Joints of limbs' bones, shape (L, 2), and ``limb_extent`` of each, shape (L, 2)."""
    landmarks, names = skeleton(form).landmarks, limb_names(form)
    joints = [[landmarks.index(end) for end in _bone_joints(name)] for name in names]
    return np.array(joints, dtype=np.int64).reshape(-1, 2), np.array([limb_extent(each) for each in names]).reshape(
        -1, 2
    )


def limb_extent(name: str) -> tuple[np.float64, np.float64]:
    """Half the width of a limb as a share of the height, and its length beyond its bone as a share of the bone's."""
    mean = template()
    length, thickness, _ = SHAPE_INDICES[PART_NAMES.index(name)]
    further = np.float64(0.0)
    if name.endswith("forearm"):
        hand = SHAPE_INDICES[PART_NAMES.index(name.replace("forearm", "hand"))][0]
        further = mean.mean_lengths[hand] / mean.mean_lengths[length]
    return mean.mean_thicknesses[thickness] / (2 * MEAN_STATURE) + _MARGIN, further


@lru_cache(maxsize=1024)
def limb_sides(form: str | Skeleton, part_groups: bytes) -> np.ndarray:
    """Group of each limb and of its mirror image, 0 where a label set does not distinguish them: (L, 2), int32.

    ``part_groups`` are the label set's, as bytes.
    """
    names, table = limb_names(form), np.frombuffer(part_groups, dtype=np.uint8)
    parts = [[1 + PART_NAMES.index(each) for each in (name, mirror_name(name))] for name in names]
    sides = table[np.array(parts, dtype=np.int64).reshape(-1, 2)].astype(np.int32)
    return np.where(sides[:, :1] != sides[:, 1:], sides, 0)


def limb_of(form: str | Skeleton) -> list[int]:
    """Index in ``LIMBS`` of the limb to which each limb's bone belongs, L numbers."""
    every = list(LIMBS.values())
    return [next(n for n, kinds in enumerate(every) if without_side(name) in kinds) for name in limb_names(form)]
