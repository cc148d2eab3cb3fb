"""Crops of many people whose part labels are known, weighed and cut out together: they share NumPy's calls.

Of each the same, to the bit, as of ``weigh_evidence`` and ``crop_evidence``, which those are left to who need a closer
look.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch

from ..body.labels import IGNORE
from ..cameras import Crop, Perspective
from .agreement import (
    COARSE,
    FAR,
    LIMBS,
    Flesh,
    are_swapped,
    compared_limbs,
    count_sides,
    disagreement_of,
    limb_bones,
    limbs_of,
    side_places,
    sum_sides,
)
from .connected_pixels import ranges
from .evidence import MOST_DISAGREEMENT, WINDOW_SIDE, keypoint_warnings, take_pixels
from .ignored_labels import STRAY, are_missing, are_stray, ignore_limbs, limb_places
from .keypoints import LARGEST_PLACE, Keypoints2D, person_height
from .observation import LABEL_SIZE, CutOut, WeighedPerson, crop_squares, observe_together
from .part_labels import PartLabels
from .person import centres
from .selection import Areas, PeopleBones, is_labelled, own_labels, select_people

_PIXELS = 2**22  # of pictures that are looked at together


class LabelledPerson(NamedTuple):
    """A person of a picture whose part labels are known."""

    keypoints: Keypoints2D
    parts: PartLabels
    others: Sequence[Keypoints2D] = ()  # in the picture
    camera: Perspective | None = None  # the picture's


def cut_labels(people: Sequence[LabelledPerson], label_size: int = LABEL_SIZE) -> list[CutOut | None]:
    """Evidence, whose labels are left out, observation and crop of each person, on the CPU.

    None of those who need a closer look: whose keypoints can't be used or disagree with the labels; whose labels may be
    stray, are by person or probabilities, or belong to a picture with a side above ``WINDOW_SIDE``.
    """
    found: list[CutOut | None] = [None] * len(people)
    plain = [place for place, person in enumerate(people) if _is_plain(person)]
    groups = np.cumsum([people[place].parts.groups.size for place in plain]) // _PIXELS
    for some in np.split(np.array(plain, dtype=np.int64), np.flatnonzero(np.diff(groups)) + 1):
        if some.size:
            chosen = some.tolist()
            for place, cut in zip(chosen, _cut_together([people[each] for each in chosen], label_size), strict=True):
                found[place] = cut
    return found


def _is_plain(person: LabelledPerson) -> bool:
    """True if a person can be looked at together with others."""
    parts, keypoints = person.parts, person.keypoints
    return (
        parts.maps is None
        and parts.instances is None
        and max(parts.groups.shape) <= WINDOW_SIDE
        and keypoints.points.dtype == np.float32
        and person_height(keypoints) > 0  # so some are visible, and in different places
        and bool(np.abs(keypoints.points).max() <= LARGEST_PLACE)
    )


def _cut_together(people: Sequence[LabelledPerson], label_size: int) -> list[CutOut | None]:
    """Cut out people with one label map each, of pictures that memory holds; None: needs a closer look."""
    bodies = PeopleBones.of([each.keypoints for each in people], [each.others for each in people])
    areas = Areas.of([each.parts.groups for each in people], bodies.boxes)
    own = select_people(areas, bodies)
    known, far, stray = _glance(people, areas, bodies.heights)
    limbs = _Limbs.of(people)
    sides = limbs.sides(people, areas)
    elsewhere = disagreement_of(sides, known, far) > MOST_DISAGREEMENT
    places = np.flatnonzero(own.found & ~stray & ~elsewhere & ~are_swapped(sides).any(axis=1)).tolist()
    found: list[CutOut | None] = [None] * len(people)
    if not places:
        return found
    low = np.minimum(bodies.extents[:, :2], np.stack([own.columns[:, 0], own.rows[:, 0]], axis=1))[places]
    high = np.maximum(bodies.extents[:, 2:], np.stack([own.columns[:, 1], own.rows[:, 1]], axis=1) + 1)[places]
    middles, halves = crop_squares(low, high)
    missing = limbs.missing(areas)
    pictures = [
        ignore_limbs(
            own_labels(people[n].parts.groups, areas, n) if own.changed[n] else people[n].parts.groups,
            float(bodies.heights[n]),
            missing[n],
        )
        for n in places
    ]
    targets = _targets(pictures, middles, halves, label_size)
    weighed: list[WeighedPerson] = []
    for target, n in zip(targets, places, strict=True):
        keypoints, parts, _, camera = people[n]
        height, width = parts.groups.shape
        window, points = Crop(0.0, 0.0, 1.0, (height, width)), keypoints.points[keypoints.visible]
        warnings = keypoint_warnings(keypoints)
        weighed.append(WeighedPerson(keypoints, points, window, target, parts.label_set, warnings, camera))
    for n, cut in zip(places, observe_together(weighed, middles, halves, "cpu"), strict=True):
        found[n] = cut
    return found


def _glance(
    people: Sequence[LabelledPerson], areas: Areas, heights: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Numbers of pixels whose distance from flesh is known, of those that are ``FAR``, and who may have stray ones.

    Of each person, shape (N,), by the pixels that ``glance`` looks at.
    """
    flesh = Flesh.of([each.keypoints for each in people], [each.parts.label_set for each in people])
    strides = np.array([max(-(-max(each.parts.groups.shape) // COARSE), 1) for each in people])
    skipped = -areas.boxes[:, :2] % strides[:, None]
    thin = [
        areas[n][top::stride, left::stride]
        for n, ((top, left), stride) in enumerate(zip(skipped.tolist(), strides.tolist(), strict=True))
    ]
    labels = np.concatenate([each.ravel() for each in thin])
    pixels = np.flatnonzero(is_labelled(labels))
    # All that pixels of a row share is repeated: faster than to look it up for each.
    heights_of_thin, widths = np.array([each.shape for each in thin]).T
    whose = np.repeat(np.arange(len(people)), heights_of_thin)
    ends = np.cumsum(widths[whose])
    counts = np.diff(np.searchsorted(pixels, ends), prepend=0)
    steps, corners = strides[whose], (areas.boxes[:, :2] + skipped + 0.5)[whose]
    y = (corners[:, 0] + ranges(np.zeros_like(heights_of_thin), heights_of_thin) * steps).repeat(counts)
    x = pixels * steps.repeat(counts) + (corners[:, 1] - (ends - widths[whose]) * steps).repeat(counts)
    keys = labels[pixels] + flesh.people[whose].repeat(counts)
    distances = flesh.distances(keys, x, y, heights[whose].repeat(counts), enough=FAR)
    sizes, far, farther = (
        np.bincount(some, minlength=len(flesh.counts))
        for some in (keys, keys[distances > FAR], keys[distances > STRAY])
    )
    there = flesh.counts > 0
    every, known, far = (np.add.reduceat(each, flesh.people) for each in (sizes, sizes * there, far * there))
    people_of = np.searchsorted(flesh.people, np.arange(len(there)), side="right") - 1
    stray = are_stray(every[people_of], farther, farther) & there
    return known, far, np.logical_or.reduceat(stray, flesh.people)


class _Limbs(NamedTuple):
    """Limbs of N people between confident keypoints."""

    whose: np.ndarray  # person of each, shape (L,)
    names: list[tuple[str, ...]]  # of each person's
    starts: np.ndarray  # (x, y) [px], shape (L, 2)
    ends: np.ndarray
    sizes: np.ndarray  # (H, W) of the people's pictures, shape (N, 2)

    @classmethod
    def of(cls, people: Sequence[LabelledPerson]) -> _Limbs:
        names, starts, ends = zip(*(limb_bones(each.keypoints) for each in people), strict=True)
        whose = np.repeat(np.arange(len(people)), [len(each) for each in names])
        sizes = np.array([each.parts.groups.shape for each in people])
        return cls(whose, list(names), np.concatenate(starts), np.concatenate(ends), sizes)

    def sides(self, people: Sequence[LabelledPerson], areas: Areas) -> np.ndarray:
        """Numbers of ``Agreement`` of each person's ``LIMBS`` (``compare_sides``), shape (N, limbs, 3)."""
        tables = [compared_limbs(names, each.parts.label_set) for names, each in zip(self.names, people, strict=True)]
        compared, owns, mirrors = (np.concatenate(each) for each in zip(*tables, strict=True))
        shown = self._shown(areas, compared, *side_places(self.starts[compared], self.ends[compared]))
        limbs = [number for names in self.names for number in limbs_of(names)]
        limbs_on = (self.whose * len(LIMBS) + np.array(limbs, dtype=np.int64))[compared]
        return sum_sides(count_sides(*shown, owns[compared], mirrors[compared]), limbs_on, len(people))

    def missing(self, areas: Areas) -> list[list[tuple[str, np.ndarray, np.ndarray]]]:
        """Limbs of each person that the labels miss, as ``ignore_limbs`` takes them."""
        every = np.ones(len(self.whose), dtype=bool)
        found = are_missing(*self._shown(areas, every, *limb_places(self.starts, self.ends)))
        limbs: list[list[tuple[str, np.ndarray, np.ndarray]]] = [[] for _ in self.names]
        names = [name for some in self.names for name in some]
        for place in np.flatnonzero(found).tolist():
            limbs[self.whose[place]].append((names[place], self.starts[place], self.ends[place]))
        return limbs

    def _shown(
        self, areas: Areas, chosen: np.ndarray, rows: np.ndarray, columns: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Group ids at places of chosen limbs, and which of these are in the pictures (``labels_at``)."""
        whose = self.whose[chosen][:, None]
        height, width = self.sizes[whose].transpose(2, 0, 1)
        inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        return areas.at(whose, rows, columns), inside


def _targets(
    pictures: Sequence[np.ndarray], middles: np.ndarray, halves: np.ndarray, label_size: int
) -> tuple[torch.Tensor, ...]:
    """Labels in square crops of pictures, beyond which 255, as of ``Evidence.target``: each (S, S), uint8."""
    lows, sides = middles - halves[:, None], 2 * halves[:, None]
    columns, rows = (
        np.floor(centres(low, low + sides, LABEL_SIZE, LABEL_SIZE // label_size)).astype(np.int64)
        for low in np.hsplit(lows, 2)
    )
    sizes = np.array([each.shape for each in pictures])
    inside = [(each >= 0) & (each < size) for each, size in zip((rows, columns), np.hsplit(sizes, 2), strict=True)]
    firsts = np.stack([each.argmax(axis=1) for each in inside], axis=1)
    stops = firsts + np.stack([each.sum(axis=1) for each in inside], axis=1)
    targets = np.full((len(pictures), label_size, label_size), IGNORE, dtype=np.uint8)
    for n, (picture, (top, left), (bottom, right)) in enumerate(
        zip(pictures, firsts.tolist(), stops.tolist(), strict=True)
    ):
        targets[n, top:bottom, left:right] = take_pixels(picture, rows[n, top:bottom], columns[n, left:right])
    return torch.from_numpy(targets).unbind()
