"""Agreement of one person's part labels and keypoints, measured along the bones between confident keypoints."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from functools import lru_cache
from itertools import combinations, compress
from typing import NamedTuple, TypeVar

import numpy as np

from ..body.labels import BACKGROUND, IGNORE, LabelSet
from ..body.landmarks import mirror_name, without_side
from ..body.skeletons import Skeleton, skeleton
from ..body.template import JOINT_NAMES, MEAN_STATURE, PARENTS, PART_NAMES, SHAPE_INDICES, template
from .keypoints import Keypoints2D, person_height
from .person import squared_distances

LIMBS: dict[str, tuple[str, ...]] = {
    "arms": ("upper_arm", "forearm", "hand"),
    "legs": ("upper_leg", "lower_leg", "foot"),
}

COARSE = 192  # [px]
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
_CORNERS = ("left_shoulder", "right_shoulder", "right_hip", "left_hip")

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
        sided = self.own + self.mirrored
        return sided >= _FEWEST and self.mirrored >= _SWAPPED * sided


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
    """The same between points of any kind by landmark."""
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
    table = labels.part_groups[_limb_parts(names)]  # of themselves and their mirror images, (2, N)
    compared = (table[0] != BACKGROUND) & (table[0] != table[1])
    if not compared.any():
        return {}
    counts = {limb: np.zeros(3, dtype=int) for limb in LIMBS}
    owns, mirrors = table[:, compared]
    shown, inside = labels_along(groups, starts[compared], ends[compared], samples=_SAMPLES, margin=_JOINT)
    on_own, on_mirrored = shown == owns[:, None], shown == mirrors[:, None]
    other = ~(on_own | on_mirrored | (shown == BACKGROUND) | (shown == IGNORE))
    found = np.stack([np.count_nonzero(each & inside, axis=1) for each in (on_own, on_mirrored, other)], axis=1)
    for name, each in zip(compress(names, compared.tolist()), found, strict=True):
        counts[next(limb for limb, kinds in LIMBS.items() if without_side(name) in kinds)] += each
    return {limb: Agreement(*each.tolist()) for limb, each in counts.items() if each.any()}


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
    sides = compared.values()
    other = sum(each.other for each in sides)
    bones = sum(each.own + each.mirrored + each.other for each in sides)
    known, far = len(seen.distances), np.count_nonzero(seen.distances > FAR)
    return (other / bones if bones >= 2 * _FEWEST else 0.0) + 4 * far / max(known, 1)


def labels_along(
    groups: np.ndarray, starts: np.ndarray, ends: np.ndarray, *, samples: int, margin: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Group ids at evenly spaced points of N bones, and which of them are in the picture, both of shape (N, samples).

    (x, y) [px] at the bones' ends, shape (N, 2); ``margin`` is the share of a bone that is left out at either end.
    """
    along = _evenly(samples, margin)
    places = np.floor(starts[:, None] + along * (ends - starts)[:, None]).astype(np.int64)
    columns, rows = places[..., 0], places[..., 1]
    height, width = groups.shape
    inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    if not inside.all():
        rows, columns = np.where(inside, rows, 0), np.where(inside, columns, 0)
    return groups[rows, columns], inside


@lru_cache
def _evenly(samples: int, margin: float) -> np.ndarray:
    """Shares of a bone at its samples, shape (N, 1)."""
    return np.linspace(margin, 1 - margin, samples)[:, None]


class _Flesh(NamedTuple):
    """Segments near which groups of parts may be, of those groups that have equally many (S) of them."""

    groups: tuple[int, ...]  # numbers of the G groups
    starts: np.ndarray  # landmarks at the segments' ends, by their place in the list, shape (S, G)
    ends: np.ndarray
    radii: np.ndarray  # shares of the person's height, shape (S, G)


@lru_cache(maxsize=1024)
def _flesh(
    groups: tuple[tuple[str, tuple[str, ...]], ...], landmarks: tuple[str, ...]
) -> tuple[list[_Flesh], np.ndarray, np.ndarray]:
    """Segments of all groups, and of their mirror images, whose keypoints are all known.

    And these groups in that order, and the rank of each among them, shape (256,), uint8; 255 of the others.
    """
    parts, known = dict(groups), frozenset(landmarks)
    alike: dict[int, list[tuple[int, list[Segment]]]] = {}
    for number, name in enumerate(parts, 1):
        either = sorted({name, mirror_name(name)} & parts.keys())
        found = [list(_part_segments(part, known)) for each in either for part in parts[each]]
        if all(found):
            segments = list(dict.fromkeys(each for some in found for each in some))  # parts share them
            alike.setdefault(len(segments), []).append((number, segments))
    tables, ranks = [], np.full(256, 255, dtype=np.uint8)
    for some in alike.values():
        starts, ends = (
            np.array([[landmarks.index(each[end]) for each in segments] for _, segments in some]).T for end in (0, 1)
        )
        radii = np.array([[radius for *_, radius in segments] for _, segments in some]).T
        tables.append(_Flesh(tuple(number for number, _ in some), starts, ends, radii))
    every = np.array([group for table in tables for group in table.groups], dtype=np.int64)
    ranks[every] = np.arange(len(every))
    return tables, every, ranks


def _part_segments(part: str, known: frozenset[str]) -> Iterator[Segment]:
    """Segments near which a part may be; empty if its keypoints are missing."""
    kind = without_side(part)
    side = part.removesuffix(kind)
    if kind in ("hip", "abdomen", "chest", "shoulder"):
        if known >= set(_CORNERS):
            for start, end in combinations(_CORNERS, 2):
                yield start, end, _TRUNK
    elif kind in ("head", "neck"):
        for name in known & set(_FACE):
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
    height, sure = person_height(keypoints), np.flatnonzero(keypoints.confident)
    landmarks = keypoints.format.landmarks
    points = keypoints.points[sure]
    tables, every, ranks = _flesh(tuple(labels.groups.items()), tuple([landmarks[place] for place in sure.tolist()]))
    thin = np.ascontiguousarray(groups[::stride, ::stride])
    keys = np.flatnonzero((thin != BACKGROUND) & (thin != IGNORE) if only is None else thin == only)
    rank = ranks[thin.ravel()[keys]]
    counts = np.bincount(rank, minlength=256)[: len(every)]
    order = np.argsort(rank, kind="stable")[: counts.sum()]  # pixels of one table lie side by side
    rows, columns = np.divmod(keys[order], thin.shape[1])
    rows, columns = rows * stride, columns * stride
    x, y = columns + 0.5, rows + 0.5
    found = [np.zeros(0)]
    first, begin = 0, 0
    for table in tables:
        own = counts[first : first + len(table.groups)]
        first += len(table.groups)
        mine = slice(begin, begin + int(own.sum()))
        begin = mine.stop
        if mine.start == mine.stop:
            continue
        x0, y0 = np.moveaxis(points[table.starts], -1, 0)
        along_x, along_y = np.moveaxis(points[table.ends], -1, 0) - (x0, y0)
        squares = along_x**2 + along_y**2
        lines = np.stack([x0, y0, along_x, along_y, squares, table.radii]).repeat(own, axis=2)
        beyond = squared_distances(x[mine] - lines[0], y[mine] - lines[1], *lines[2:5])
        np.sqrt(beyond, out=beyond)  # in place, for memory takes most of the time
        beyond /= height
        beyond -= lines[5]
        found.append(beyond.min(axis=0))
    return Beyond(len(keys), every[counts > 0], counts[counts > 0], rows, columns, np.concatenate(found))
