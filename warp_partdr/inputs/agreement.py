"""Agreement of one person's part labels and keypoints, measured along the bones between confident keypoints."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from itertools import combinations, compress
from typing import NamedTuple, TypeVar

import numpy as np

from ..body.labels import BACKGROUND, IGNORE, LabelSet
from ..body.landmarks import mirror_name, without_side
from ..body.skeletons import Skeleton, skeleton
from ..body.template import JOINT_NAMES, MEAN_STATURE, PARENTS, PART_NAMES, SHAPE_INDICES, template
from .connected_pixels import ranges
from .keypoints import Keypoints2D, person_height
from .person import squared_distances

LIMBS: dict[str, tuple[str, ...]] = {
    "arms": ("upper_arm", "forearm", "hand"),
    "legs": ("upper_leg", "lower_leg", "foot"),
}

COARSE = 192  # [px]
_AT_ONCE = 2**13  # places, whose numbers stay in the processor's cache
_SAMPLES = 48  # points along a bone
_JOINT = 0.1  # share of a bone at either end that may show the next part
_FEWEST = 24  # samples below which nothing is said
_SWAPPED = 0.75  # share of the samples on either side's label from which on two limbs are taken for each other

# Shares of the person's height.
_TRUNK = 0.06  # radius of flesh about the lines between shoulders and hips
_HEAD = 0.16  # radius of a head and its hair about any point of the face
_ENDS = {"hand": ("wrist", 0.11), "foot": ("ankle", 0.15)}  # their lengths, any way from the joint
FAR = 0.05  # beyond all that

_FACE = ("nose", "left_eye", "right_eye", "left_ear", "right_ear", "head", "head_top")
_CORNERS = ("left_shoulder", "right_hip", "right_shoulder", "left_hip")

Segment = tuple[str, str, float]  # landmarks at both ends, and a radius as a share of the person's height
Place = TypeVar("Place")


class Agreement(NamedTuple):
    """Counts of samples along the bones of one pair of limbs."""

    own: int  # on the limb's own label
    mirrored: int  # on that of the other side
    other: int  # on any other part's

    @property
    def swapped(self) -> bool:
        """True if left and right are exchanged between labels and keypoints."""
        return bool(are_swapped(np.array(self)))


def limb_bones(keypoints: Keypoints2D) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """Parts, starts and ends [px] of the limbs' bones between two confident keypoints, shape (N, 2)."""
    names, joints = _limbs_of(keypoints.skeleton, keypoints.confident.tobytes())
    starts, ends = keypoints.points[joints]
    return names, starts, ends


@lru_cache(maxsize=4096)
def _limbs_of(form: str | Skeleton, confident: bytes) -> tuple[tuple[str, ...], np.ndarray]:
    """Parts and joints at both ends, shape (2, N), of ``limb_bones``."""
    sure = np.flatnonzero(np.frombuffer(confident, dtype=bool)).tolist()
    landmarks = skeleton(form).landmarks
    found = list(limbs_between({landmarks[joint]: joint for joint in sure}))
    joints = np.array([(start, end) for _, start, end in found], dtype=np.int64).reshape(-1, 2).T
    return tuple(name for name, *_ in found), joints


def limbs_between(points: Mapping[str, Place]) -> Iterator[tuple[str, Place, Place]]:
    """Name of the part, start and end of each limb's bone between the given points, which may be of any kind.

    ``points`` are by landmark.
    """
    for name in (f"{side}_{kind}" for side in ("left", "right") for kinds in LIMBS.values() for kind in kinds):
        if without_side(name) not in _ENDS and (ends := _bone_ends(name, points)):
            yield name, *ends


def _bone_joints(name: str) -> tuple[str, str]:
    """Joints at both ends of a part's bone."""
    part = PART_NAMES.index(name)
    return JOINT_NAMES[PARENTS[part] + 1], JOINT_NAMES[part + 1]


def _bone_ends(name: str, points: Mapping[str, Place]) -> tuple[Place, Place] | None:
    """Start and end of a part's bone; None if a keypoint is missing."""
    start, end = _bone_joints(name)
    return (points[start], points[end]) if start in points and end in points else None


def compare_sides(groups: np.ndarray, keypoints: Keypoints2D, labels: LabelSet) -> dict[str, Agreement]:
    """Compare arms and legs that have keypoints and whose sides the label set distinguishes.

    ``groups``, shape (H, W), here and below, hold this person's ids alone (``select_person``).
    """
    names, starts, ends = limb_bones(keypoints)
    compared, owns, mirrors = compared_limbs(names, labels)
    if not compared.any():
        return {}
    rows, columns = side_places(starts[compared], ends[compared])
    found = count_sides(*labels_at(groups, rows, columns), owns[compared], mirrors[compared])
    (sums,) = sum_sides(found, np.array(limbs_of(names))[compared], 1).tolist()
    return {limb: Agreement(*each) for limb, each in zip(LIMBS, sums, strict=True) if any(each)}


def compared_limbs(names: tuple[str, ...], labels: LabelSet) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """True for parts whose sides a label set distinguishes; group ids of parts, and of their mirror images; (N,)."""
    owns, mirrors = labels.part_groups[_limb_parts(names)]
    return (owns != BACKGROUND) & (owns != mirrors), owns, mirrors


def side_places(starts: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the pixels along N bones that ``count_sides`` counts, shape (N, samples)."""
    return places_along(starts, ends, samples=_SAMPLES, margin=_JOINT)


def count_sides(shown: np.ndarray, inside: np.ndarray, owns: np.ndarray, mirrors: np.ndarray) -> np.ndarray:
    """Numbers of ``Agreement`` of each of N bones by the group ids at its pixels (N, samples), shape (N, 3)."""
    on_own, on_mirrored = shown == owns[:, None], shown == mirrors[:, None]
    other = ~(on_own | on_mirrored | (shown == BACKGROUND) | (shown == IGNORE))
    return np.stack([np.count_nonzero(each & inside, axis=1) for each in (on_own, on_mirrored, other)], axis=1)


def sum_sides(counts: np.ndarray, limbs: np.ndarray, people: int) -> np.ndarray:
    """Sums of ``count_sides`` over the bones (N, 3) of each of some people's ``LIMBS``, shape (people, limbs, 3).

    The bones are of the limbs with these numbers (N,), counted on from one person to the next.
    """
    sums = np.zeros((people * len(LIMBS), 3), dtype=np.int64)
    np.add.at(sums, limbs, counts)
    return sums.reshape(people, len(LIMBS), 3)


def are_swapped(sums: np.ndarray) -> np.ndarray:
    """``Agreement.swapped`` of limbs by their numbers (..., 3)."""
    own, mirrored, _ = np.moveaxis(sums, -1, 0)
    found: np.ndarray = (own + mirrored >= _FEWEST) & (mirrored >= _SWAPPED * (own + mirrored))
    return found


@lru_cache(maxsize=1024)
def limbs_of(parts: tuple[str, ...]) -> list[int]:
    """Numbers of those of ``LIMBS`` that parts belong to."""
    every = list(LIMBS.values())
    return [next(n for n, kinds in enumerate(every) if without_side(part) in kinds) for part in parts]


@lru_cache(maxsize=1024)
def _limb_parts(names: tuple[str, ...]) -> np.ndarray:
    """Part labels of parts and of their mirror images, shape (2, N)."""
    both = names, tuple(mirror_name(name) for name in names)
    return np.array([[1 + PART_NAMES.index(name) for name in some] for some in both], dtype=np.int64).reshape(2, -1)


def disagreement(compared: Mapping[str, Agreement], seen: Beyond) -> float:
    """Measure of disagreement between labels and keypoints, regardless of sides, from ``compare_sides`` and ``glance``.

    The share of the limbs' bones that run over other parts' labels, plus four times the share of labels that lie far
    from any bone of their part. At most 0.87 for 120 people of PartBench, "realistic" and "hard"; their labels read as
    Sapiens' or ATR's have at least 1.3.
    """
    known, far = np.array(len(seen.distances)), np.count_nonzero(seen.distances > FAR)
    return float(disagreement_of(np.array(list(compared.values())).reshape(-1, 3), known, np.array(far)))


def disagreement_of(sums: np.ndarray, known: np.ndarray, far: np.ndarray) -> np.ndarray:
    """Measure of disagreement of N people, shape (N,); see ``disagreement``.

    Args:
        sums: Three numbers of pixels of each limb's bone, shape (N, limbs, 3).
        known: Numbers of pixels whose distance is known, shape (N,).
        far: Numbers of these that are far, shape (N,).
    """
    totals = sums.sum(axis=-2)
    bones = totals.sum(axis=-1)
    other = np.where(bones >= 2 * _FEWEST, totals[..., 2] / np.maximum(bones, 1), 0.0)
    return np.asarray(other + 4 * far / np.maximum(known, 1))


def places_along(
    starts: np.ndarray, ends: np.ndarray, *, samples: int, margin: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of evenly spaced points of N bones, shape (N, samples).

    (x, y) [px] at the bones' ends, shape (N, 2); ``margin`` is the share of a bone that is left out at either end.
    """
    along = _evenly(samples, margin)
    places = np.floor(starts[:, None] + along * (ends - starts)[:, None]).astype(np.int64)
    return places[..., 1], places[..., 0]


def labels_at(groups: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Group ids at places, and which of these are in the picture."""
    height, width = groups.shape
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    if not inside.all():
        rows, columns = np.where(inside, rows, 0), np.where(inside, columns, 0)
    return groups[rows, columns], inside


@lru_cache
def _evenly(samples: int, margin: float) -> np.ndarray:
    """Shares of a bone at its samples, shape (N, 1)."""
    return np.linspace(margin, 1 - margin, samples)[:, None]


class Flesh(NamedTuple):
    """Segments near which the groups of N people may be, one group's after another."""

    table: np.ndarray  # start (x, y), way to the end and its square, radius as a share of the height, shape (S, 6)
    firsts: np.ndarray  # a group's first segment, shape (K,)
    counts: np.ndarray  # and their number; 0 if a keypoint is missing
    people: np.ndarray  # place in these of each person's group 0, shape (N,)

    @classmethod
    def of(cls, people: Sequence[Keypoints2D], labels: Sequence[LabelSet]) -> Flesh:
        """Flesh of people by their confident keypoints, of groups by their label set."""
        groups = {id(each): tuple(each.groups.items()) for each in labels}
        known = [
            _segments_of(groups[id(each)], person.skeleton, person.confident.tobytes())
            for person, each in zip(people, labels, strict=True)
        ]
        starts, ends = np.concatenate(
            [person.points[joints] for person, (joints, *_) in zip(people, known, strict=True)]
        ).transpose(1, 0, 2)
        way = ends - starts
        squares, radii = way[:, :1] ** 2 + way[:, 1:] ** 2, np.concatenate([radii for _, radii, _ in known])
        counts = np.concatenate([counts for *_, counts in known])
        sizes = np.cumsum([0, *(len(counts) for *_, counts in known)])
        table = np.concatenate([starts, way, squares, radii[:, None]], axis=1)
        return cls(table, np.cumsum(counts) - counts, counts, sizes[:-1])

    def distances(
        self, keys: np.ndarray, x: np.ndarray, y: np.ndarray, heights: np.ndarray, *, enough: float = -math.inf
    ) -> np.ndarray:
        """Distances of places (P,) beyond groups' flesh, negative within, as shares of people's heights; inf without.

        Of what is not farther than ``enough`` no more than that need be true: a group's first segment often says it.
        """
        found = np.full(len(keys), np.inf)
        there = np.flatnonzero(self.counts[keys])
        for first in range(0, len(there), _AT_ONCE):
            part = there[first : first + _AT_ONCE]
            found[part] = self._beyond(self.firsts[keys[part]], x[part], y[part], heights[part])
        left = there[(found[there] > enough) & (self.counts[keys[there]] > 1)]
        for first in range(0, len(left), _AT_ONCE // 4):
            part = left[first : first + _AT_ONCE // 4]
            counts = self.counts[keys[part]] - 1
            lines = ranges(self.firsts[keys[part]] + 1, counts)
            beyond = self._beyond(lines, *(each[part].repeat(counts) for each in (x, y, heights)))
            found[part] = np.minimum(found[part], np.minimum.reduceat(beyond, np.cumsum(counts) - counts))
        return found

    def _beyond(self, lines: np.ndarray, x: np.ndarray, y: np.ndarray, heights: np.ndarray) -> np.ndarray:
        """Distance of each place beyond the flesh of one segment, negative within, as a share of the height."""
        table = self.table.take(lines, axis=0).T
        beyond = squared_distances(x - table[0], y - table[1], *table[2:5])
        np.sqrt(beyond, out=beyond)  # in place, for memory takes most of the time
        beyond /= heights
        beyond -= table[5]
        return beyond


@lru_cache(maxsize=4096)
def _segments_of(
    groups: tuple[tuple[str, tuple[str, ...]], ...], form: str | Skeleton, confident: bytes
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Segments of all groups and of their mirror images, whose keypoints are all known, one group's after another.

    Joints at both ends, shape (S, 2), radii as shares of the height, and the groups' numbers of segments, from that of
    background on, shape (G + 1,).
    """
    parts, landmarks = dict(groups), skeleton(form).landmarks
    known = frozenset(compress(landmarks, np.frombuffer(confident, dtype=bool).tolist()))
    joints: list[tuple[int, int]] = []
    radii: list[float] = []
    counts = [0]
    for name in parts:
        either = [each for each in dict.fromkeys((name, mirror_name(name))) if each in parts]
        found = [list(_part_segments(part, known)) for each in either for part in parts[each]]
        segments = dict.fromkeys(each for some in found for each in some) if all(found) else {}  # parts share them
        joints += ((landmarks.index(start), landmarks.index(end)) for start, end, _ in segments)
        radii += (radius for *_, radius in segments)
        counts.append(len(segments))
    return np.array(joints, dtype=np.int64).reshape(-1, 2), np.array(radii), np.array(counts)


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


def segments_of_parts(points: Mapping[str, Place]) -> dict[str, list[tuple[Place, Place, float]]]:
    """Segments near which each part may be, of which a head or neck needs one, between points of any kind."""
    known = frozenset(points)
    return {
        part: [(points[start], points[end], radius) for start, end, radius in _part_segments(part, known)]
        for part in PART_NAMES
    }


class Beyond(NamedTuple):
    """Distances of groups' pixels from their bones and flesh, one group's after the other's."""

    labelled: int  # pixels that were looked at, of any group
    groups: np.ndarray  # those groups that have some, and whose keypoints are all known
    sizes: np.ndarray  # numbers of their pixels
    rows: np.ndarray
    columns: np.ndarray
    distances: np.ndarray  # beyond the flesh, negative within, as a share of the person's height

    def farther(self, least: float) -> np.ndarray:
        """Numbers of each group's pixels that are farther away."""
        return np.add.reduceat(self.distances > least, np.cumsum(self.sizes) - self.sizes, dtype=np.int64)


def coarse(groups: np.ndarray) -> int:
    """Stride at which a picture has at most ``COARSE`` pixels a side: enough to see whether something is wrong."""
    return max(math.ceil(max(groups.shape) / COARSE), 1)


def glance(groups: np.ndarray, keypoints: Keypoints2D, labels: LabelSet) -> Beyond:
    """Distances (``distances_beyond``) at the stride of ``coarse``."""
    return distances_beyond(groups, keypoints, labels, stride=coarse(groups))


def distances_beyond(
    groups: np.ndarray, keypoints: Keypoints2D, labels: LabelSet, *, stride: int = 1, only: int | None = None
) -> Beyond:
    """Distances of each visible group whose keypoints are all known; mirror images count as well.

    Looks at every so many-th row and column (``stride``), and at all groups or ``only`` one.
    """
    flesh = Flesh.of([keypoints], [labels])
    thin = np.ascontiguousarray(groups[::stride, ::stride])
    places = np.flatnonzero((thin != BACKGROUND) & (thin != IGNORE) if only is None else thin == only)
    shown = thin.ravel()[places]
    known = np.flatnonzero(flesh.counts[shown])
    order = known[np.argsort(shown[known], kind="stable")]
    rows, columns = np.divmod(places[order], thin.shape[1])
    rows, columns = rows * stride, columns * stride
    heights = np.full(len(order), person_height(keypoints))
    distances = flesh.distances(shown[order], columns + 0.5, rows + 0.5, heights)
    sizes = np.bincount(shown[order], minlength=len(flesh.counts))
    return Beyond(len(places), np.flatnonzero(sizes), sizes[sizes > 0], rows, columns, distances)
