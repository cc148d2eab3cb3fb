"""Labelled pixels that are a person's own, found for many people at once, of one picture or of many.

They lie along the bones between the confident keypoints, or hang together with such, not too far from the bones. Pixels
nearer to others' bones are theirs.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ..body.labels import BACKGROUND, IGNORE
from ..body.skeletons import Skeleton, skeleton
from ..errors import InputError
from .connected_pixels import Runs, ranges
from .keypoints import Keypoints2D, person_height
from .person import LOOSE_REACH, MIN_SEED_RADIUS, REACH, SEED_RADIUS, label_bounds, loose_ends, squared_distances

_BLOCK = 16  # [px], least side of the squares whose pixels are compared with bones at once,
_BLOCKS = 3  # of which so many are within reach
_PARTS = 4  # of a side, into which those are split that the middle says nothing of
_PAIRS = 2**13  # of places and lines, whose distances are measured at a time
_OUTWARD = np.array([-1.0, -1.0, 1.0, 1.0])  # of a box's edges
_ALONG = np.linspace(0, 1, 8)  # places along a bone, as shares of it


class Lines(NamedTuple):
    """Line segments of N people, one after another."""

    table: np.ndarray  # start (x, y), way to the end and its square, shape (S, 5)
    firsts: np.ndarray  # each person's first, shape (N,)
    counts: np.ndarray  # and their number

    @classmethod
    def of(cls, ends: np.ndarray, counts: np.ndarray) -> Lines:
        """Lines between ends (x, y), shape (S, 2, 2), so many of each person."""
        starts, way = ends[:, 0].astype(np.float64), ends[:, 1].astype(np.float64) - ends[:, 0]
        squares = way[:, :1] ** 2 + way[:, 1:] ** 2
        return cls(np.concatenate([starts, way, squares], axis=1), np.cumsum(counts) - counts, counts)

    def squares(self, people: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Squared distances of some people's places (P,) to the nearest of the person's lines; inf without any."""
        found = np.full(len(people), np.inf)
        for part, firsts, _, values in self._pairs(people, x, y):
            found[part] = np.minimum.reduceat(values, firsts)
        return found

    def nearest(self, people: np.ndarray, x: np.ndarray, y: np.ndarray, off: np.ndarray) -> tuple[np.ndarray, Lines]:
        """Distances as of ``squares``; and of each place the lines of which one is nearest, so far off from there."""
        found = np.full(len(people), np.inf)
        counts, tables = np.zeros(len(people), dtype=np.int64), [self.table[:0]]
        for part, firsts, lines, values in self._pairs(people, x, y):
            distances = np.sqrt(values)
            found[part] = np.minimum.reduceat(distances, firsts)
            near = distances <= (found[part] + 2 * off[part]).repeat(self.counts[people[part]])
            counts[part] = np.add.reduceat(near, firsts, dtype=np.int64)
            tables.append(self.table.take(lines[near], axis=0))
        return found, Lines(np.concatenate(tables), np.cumsum(counts) - counts, counts)

    def _pairs(
        self, people: np.ndarray, x: np.ndarray, y: np.ndarray
    ) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        """Some of the places at a time, of people with lines; their first pairs, the pairs' lines, and squares."""
        asked = np.flatnonzero(self.counts[people])
        step = max(_PAIRS // max(int(self.counts.max(initial=0)), 1), 1)
        for part in (asked[first : first + step] for first in range(0, len(asked), step)):
            counts = self.counts[people[part]]
            lines = ranges(self.firsts[people[part]], counts)
            x0, y0, *ways = self.table.take(lines, axis=0).T
            squares = squared_distances(x[part].repeat(counts) - x0, y[part].repeat(counts) - y0, *ways)
            yield part, np.cumsum(counts) - counts, lines, squares


@dataclass(frozen=True)
class PeopleBones:
    """Bodies of N people as their keypoints tell them.

    Attributes:
        heights: Of the people [px], shape (N,).
        bones: Between confident keypoints, and keypoints at no bone.
        loose: Points whose next joint is missing, where a whole limb may hang.
        theirs: Bones of others that come near.
        extents: Of the confident keypoints: left, top, right, bottom [px], shape (N, 4).
    """

    heights: np.ndarray
    bones: Lines
    loose: Lines
    theirs: Lines
    extents: np.ndarray

    @classmethod
    def of(cls, people: Sequence[Keypoints2D], others: Sequence[Sequence[Keypoints2D]]) -> PeopleBones:
        """Bodies of people, and of others about each."""
        heights = np.array([person_height(each) for each in people])
        joints = [_joints_of(each.skeleton, each.confident.tobytes()) for each in people]
        ends, counts = _joined([each.points[pairs] for each, (pairs, _) in zip(people, joints, strict=True)])
        bones = Lines.of(ends, counts)
        loose, num_loose = _joined([each.points[alone] for each, (*_, alone) in zip(people, joints, strict=True)])
        low = np.minimum.reduceat(ends.min(axis=1), bones.firsts).astype(np.float64)
        high = np.maximum.reduceat(ends.max(axis=1), bones.firsts).astype(np.float64)
        theirs, num_theirs = _joined(
            [each.points[_joints_of(each.skeleton, each.confident.tobytes())[0]] for some in others for each in some]
        )
        whose = np.repeat(np.arange(len(people)), [len(some) for some in others]).repeat(num_theirs)
        found = cls(heights, bones, Lines.of(loose, num_loose), bones, np.concatenate([low, high], axis=1))
        far = found.boxes + (found.reach[:, None] * _OUTWARD)
        come = (theirs.min(axis=1) <= far[whose, 2:]) & (theirs.max(axis=1) >= far[whose, :2])
        come = come.all(axis=1)
        counts = np.bincount(whose[come], minlength=len(people))
        return replace(found, theirs=Lines.of(theirs[come], counts))

    @property
    def reach(self) -> np.ndarray:
        """Distance [px] from bones beyond which nothing is the person's, shape (N,)."""
        return np.maximum(REACH * self.heights, MIN_SEED_RADIUS)

    @property
    def boxes(self) -> np.ndarray:
        """Boxes around all that may be the person's, as ``extents``."""
        farthest = np.maximum(np.where(self.loose.counts > 0, LOOSE_REACH, REACH) * self.heights, MIN_SEED_RADIUS)
        return self.extents + farthest[:, None] * _OUTWARD


def _joined(arrays: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Arrays of ends (S, 2, 2) one after another, and their lengths."""
    lengths = np.array([len(each) for each in arrays], dtype=np.int64)
    return np.concatenate([np.zeros((0, 2, 2), dtype=np.float32), *arrays]), lengths


@lru_cache(maxsize=4096)
def _joints_of(form: str | Skeleton, confident: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Joints at both ends of ``PeopleBones.bones``, and of ``loose``, shape (S, 2)."""
    sure = np.frombuffer(confident, dtype=bool)
    bones = [edge for edge in skeleton(form).edges if sure[edge[0]] and sure[edge[1]]]
    alone = set(np.flatnonzero(sure).tolist()) - {joint for edge in bones for joint in edge}
    pairs = [*bones, *((joint, joint) for joint in alone)]
    loose = np.flatnonzero(loose_ends(form, sure[None])[0])
    return np.array(pairs, dtype=np.int64).reshape(-1, 2), np.stack([loose, loose], axis=1)


@dataclass(frozen=True)
class Areas:
    """Areas of N people's pictures in which their labels are, one after another, with gaps of background.

    Attributes:
        labels: Group ids of all, as ``Runs`` takes pixels, shape (P,), uint8.
        firsts: First pixel of each area, shape (N,).
        boxes: Their top, left, height and width in the pictures [px], shape (N, 4).
        whole: True where there is nothing but background beyond, shape (N,), bool.
    """

    labels: np.ndarray
    firsts: np.ndarray
    boxes: np.ndarray
    whole: np.ndarray

    @classmethod
    def of(cls, pictures: Sequence[np.ndarray], limits: np.ndarray) -> Areas:
        """Areas of pictures (H, W) within limits: left, top, right, bottom, shape (N, 4)."""
        low, high = np.floor(limits[:, 1::-1]).astype(np.int64), np.ceil(limits[:, :1:-1]).astype(np.int64)
        sizes = np.array([each.shape for each in pictures])
        found: dict[int, tuple[slice, slice]] = {}
        boxes: list[tuple[int, int, int, int]] = []
        whole: list[bool] = []
        for picture, (top, left), (bottom, right) in zip(
            pictures, np.clip(low, 0, sizes).tolist(), np.clip(high, 0, sizes).tolist(), strict=True
        ):
            if id(picture) not in found:
                found[id(picture)] = label_bounds(picture != BACKGROUND)
            rows, columns = found[id(picture)]
            box = max(top, rows.start), max(left, columns.start), min(bottom, rows.stop), min(right, columns.stop)
            whole.append(box == (rows.start, columns.start, rows.stop, columns.stop))
            boxes.append((box[0], box[1], max(box[2] - box[0], 0), max(box[3] - box[1], 0)))
        places = np.array(boxes)
        counts = (places[:, 2] + 1) * (places[:, 3] + 1)
        labels = np.zeros(counts.sum() + 1, dtype=np.uint8)
        areas = cls(labels, np.cumsum(counts) - counts + places[:, 3] + 2, places, np.array(whole))
        for number, (picture, (top, left, height, width)) in enumerate(zip(pictures, boxes, strict=True)):
            areas[number][:] = picture[top : top + height, left : left + width]
        return areas

    @property
    def strides(self) -> np.ndarray:
        """Number of pixels from one to that below, shape (N,)."""
        return self.boxes[:, 3] + 1

    def __getitem__(self, number: int) -> np.ndarray:
        """Labels of one area, shape (H, W), which may be written to."""
        height, width = self.boxes[number, 2:].tolist()
        first = int(self.firsts[number])
        return self.labels[first - 1 : first - 1 + height * (width + 1)].reshape(height, width + 1)[:, 1:]

    def at(self, people: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Labels at places in people's pictures, of one shape or such that NumPy makes one; beyond the area 0."""
        return self.labels[self.pixels(people, rows, columns)]

    def pixels(self, people: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Numbers of pixels at places in people's pictures; beyond the area that of a gap, 0."""
        box = self.boxes[people]
        rows, columns = rows - box[..., 0], columns - box[..., 1]
        inside = (rows >= 0) & (rows < box[..., 2]) & (columns >= 0) & (columns < box[..., 3])
        return np.where(inside, self.firsts[people] + rows * self.strides[people] + columns, 0)

    def places(self, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """People of some pixels, and their rows and columns in the pictures."""
        people = np.searchsorted(self.firsts, pixels, side="right") - 1
        rows, columns = np.divmod(pixels - self.firsts[people], self.strides[people])
        return people, rows + self.boxes[people, 0], columns + self.boxes[people, 1]


class Selected(NamedTuple):
    """Pixels of N people that are their own."""

    changed: np.ndarray  # True of those of whose labels some became 255, shape (N,), bool
    found: np.ndarray  # True of those who have own pixels
    rows: np.ndarray  # the first and the last row of those in the picture, shape (N, 2)
    columns: np.ndarray  # the same of columns


def select_people(areas: Areas, bodies: PeopleBones) -> Selected:
    """Keep each person's labels in their area; everybody else's, and stray blobs, become 255, ignore."""
    own = is_labelled(areas.labels)
    far = _far(areas, bodies, own)
    own[far] = False
    runs = Runs(own, areas.firsts, areas.strides)
    kept = runs.reached(_under_bones(areas, bodies, own))
    # Most hangs together with what is right under a bone; what does not is measured.
    if not kept.all():
        kept |= runs.reached(_seeds(areas, bodies, runs.pixels(~kept)))
    lost = np.concatenate([far, runs.pixels(~kept)])
    areas.labels[lost] = IGNORE
    count, changed = len(areas.firsts), ~areas.whole
    changed[areas.places(lost)[0]] = True
    limits = np.full((2, 2, count), -1)  # of columns and rows, lowest and highest
    limits[:, 0] = np.iinfo(np.int64).max
    for ends, pixels in ((0, runs.starts[kept]), (1, runs.starts[kept] + runs.counts[kept] - 1)):
        people, rows, columns = areas.places(pixels)
        for axis, places in ((0, columns), (1, rows)):
            (np.minimum, np.maximum)[ends].at(limits[axis, ends], people, places)
    return Selected(changed, limits[0, 1] >= 0, limits[1].T, limits[0].T)


def is_labelled(labels: np.ndarray) -> np.ndarray:
    """True where group ids are those of a part."""
    return labels - np.uint8(1) < IGNORE - 1  # in bytes, where 0 - 1 is 255


class _Blocks(NamedTuple):
    """Square blocks of pixels of people's areas, as far as these go."""

    people: np.ndarray  # whose, shape (K,)
    boxes: np.ndarray  # first row and column in the area, height and width, shape (K, 4)
    sides: np.ndarray  # of the squares [px], shape (K,)

    def split(self, sides: np.ndarray) -> tuple[_Blocks, np.ndarray]:
        """Smaller blocks, with these sides (K,), and the number of the one here that each is a part of."""
        grids = -(-self.boxes[:, 2:] // sides[:, None])
        counts = grids.prod(axis=1)
        of = np.repeat(np.arange(len(counts)), counts)
        places = np.stack(np.divmod(ranges(np.zeros_like(counts), counts), grids[of, 1]), axis=1) * sides[of, None]
        sizes = np.minimum(self.boxes[of, 2:] - places, sides[of, None])
        boxes = np.concatenate([self.boxes[of, :2] + places, sizes], axis=1)
        return _Blocks(self.people[of], boxes, sides[of]), of

    def chosen(self, which: np.ndarray) -> _Blocks:
        """Some of them."""
        return _Blocks(self.people[which], self.boxes[which], self.sides[which])

    def pixels(self, areas: Areas) -> tuple[np.ndarray, np.ndarray]:
        """Pixels of the blocks, and the number of each one's block."""
        top, left, heights, widths = self.boxes.T
        strides = areas.strides[self.people]
        firsts = areas.firsts[self.people] + top * strides + left
        rows = firsts.repeat(heights) + strides.repeat(heights) * ranges(np.zeros_like(heights), heights)
        return ranges(rows, widths.repeat(heights)), np.arange(len(heights)).repeat(heights * widths)


def _far(areas: Areas, bodies: PeopleBones, labelled: np.ndarray) -> np.ndarray:
    """Labelled pixels, as ``Areas.labels``, that are not near the person's bones, or are nearer to others'.

    Where the middle of a block of pixels says it of all of them, they are not measured; else those of its parts may.
    """
    people, far = np.arange(len(areas.firsts)), []
    blocks = _Blocks(people, np.concatenate([0 * areas.boxes[:, :2], areas.boxes[:, 2:]], axis=1), people)
    lines, of = (bodies.bones, bodies.loose, bodies.theirs), people  # and whose of them are about each block
    sides = np.maximum((bodies.reach / _BLOCKS).astype(np.int64), _BLOCK)
    for _ in range(2):
        blocks, parts = blocks.split(sides[blocks.people])
        certain, possible, lines = _judge(areas, bodies, blocks, of[parts], lines)
        far.append(blocks.chosen(~possible).pixels(areas)[0])
        of = np.flatnonzero(possible & ~certain)
        blocks, sides = blocks.chosen(of), -(-sides // _PARTS)
    pixels, parts = blocks.pixels(areas)
    there = labelled[pixels]
    pixels, of = pixels[there], of[parts[there]]
    whose, rows, columns = areas.places(pixels)
    where = of, columns + 0.5, rows + 0.5
    bones, loose, theirs = (each.squares(*where) for each in lines)
    own, other = (_within(each, bodies.reach[whose]) for each in (bones, theirs))
    near = np.isfinite(own) | (loose <= (LOOSE_REACH * bodies.heights[whose]) ** 2)
    every = np.concatenate(far)
    return np.concatenate([every[labelled[every]], pixels[~near | (own > other)]])


def _judge(
    areas: Areas, bodies: PeopleBones, blocks: _Blocks, of: np.ndarray, lines: Sequence[Lines]
) -> tuple[np.ndarray, np.ndarray, tuple[Lines, Lines, Lines]]:
    """True for blocks whose pixels are near for certain; or may be; and lines for each that may be the nearest there.

    Lines are bones, loose ends and others' bones, of which each block asks ``of`` some.
    """
    y, x = (areas.boxes[blocks.people, :2] + blocks.boxes[:, :2] + blocks.sides[:, None] / 2).T
    off = blocks.sides / math.sqrt(2)
    (own, bones), (ends, loose), (other, theirs) = (each.nearest(of, x, y, off) for each in lines)
    reach, loose_reach = bodies.reach[blocks.people], LOOSE_REACH * bodies.heights[blocks.people]
    certain = (own + off <= reach) | (ends + off <= loose_reach)
    certain &= (other - off > reach) | (own + off < other - off)
    possible = (own - off <= reach) | (ends - off <= loose_reach)
    possible &= ~((other + off <= reach) & (other + off < own - off))
    return certain, possible, (bones, loose, theirs)


def _within(squares: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Distances from their squares; inf beyond reach."""
    return np.sqrt(np.where(squares <= reach**2, squares, np.inf))


def _seeds(areas: Areas, bodies: PeopleBones, pixels: np.ndarray) -> np.ndarray:
    """Pixels, among those given, that lie along bones."""
    people, rows, columns = areas.places(pixels)
    distances = np.sqrt(bodies.bones.squares(people, columns + 0.5, rows + 0.5))
    return pixels[distances <= np.maximum(SEED_RADIUS * bodies.heights, MIN_SEED_RADIUS)[people]]


def _under_bones(areas: Areas, bodies: PeopleBones, mask: np.ndarray) -> np.ndarray:
    """Some pixels of a mask that bones go through: these lie along bones for certain."""
    people = np.repeat(np.arange(len(bodies.heights)), bodies.bones.counts)
    x, y, across, down, _ = bodies.bones.table.T[..., None]
    rows, columns = (np.floor(each).astype(np.int64) for each in (y + _ALONG * down, x + _ALONG * across))
    pixels = areas.pixels(people[:, None], rows, columns)
    return pixels[mask[pixels]]


def select_person(groups: np.ndarray, keypoints: Keypoints2D, others: Sequence[Keypoints2D] = ()) -> np.ndarray:
    """Keep one person's labels; everybody else's, and stray blobs, become 255, ignore: shape (H, W), uint8.

    Raises:
        InputError: If no labelled pixel lies along the person's bones.
    """
    bodies = PeopleBones.of([keypoints], [others])
    areas = Areas.of([groups], bodies.boxes)
    labelled = np.flatnonzero(is_labelled(areas.labels))
    selected = select_people(areas, bodies)
    if not selected.found[0] and not _seeds(areas, bodies, labelled).size:
        raise InputError(
            "keypoints: no labelled pixel along the person's bones; expected keypoints and part labels to agree"
        )
    return own_labels(groups, areas, 0) if selected.changed[0] else groups


def own_labels(groups: np.ndarray, areas: Areas, number: int) -> np.ndarray:
    """A picture's labels with those of a person's area; what is labelled beyond is 255, ignore."""
    top, left, height, width = areas.boxes[number].tolist()
    found = (groups != BACKGROUND) * np.uint8(IGNORE)
    found[top : top + height, left : left + width] = areas[number]
    return found
