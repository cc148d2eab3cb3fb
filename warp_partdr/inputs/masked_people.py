"""Crops of many people whose masks are known: their evidence is weighed, and their labels cut out, on the device.

Of each the same, to the bit, as ``weigh_evidence`` and ``crop_evidence`` of a mask alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import torch
import warp as wp

from ..body.labels import label_set
from ..cameras import Crop, Perspective
from ..interop.arrays import warp_array
from ..interop.streams import on_torch_stream
from ..interop.torch_threads import one_torch_thread
from ..kernels import mask_targets, own_pixels
from ..kernels.launch import run_slices, split_batch
from .agreement import COARSE, FAR
from .body_lines import BodyLines, body_lines
from .evidence import (
    MOST_DISAGREEMENT,
    check_places,
    elsewhere_warning,
    keypoint_warnings,
    person_windows,
    stray_warning,
)
from .ignored_labels import LIMB_SAMPLES, MISSING_SHARE, STRAY, are_stray
from .keypoints import LARGEST_PLACE, Keypoints2D, confident
from .observation import LABEL_SIZE, CutOut, WeighedPerson, crop_squares, observe_together
from .person import reach_boxes

MASK_LABELS = label_set("full1")
_PIXELS = {"cpu": 2**24, "cuda": 2**26}  # of areas that are looked at together
_NEVER = 2**30  # more than any row or column


class MaskedPerson(NamedTuple):
    """A person of a picture in which it is known whom each pixel shows."""

    keypoints: Keypoints2D
    owners: torch.Tensor  # whom each pixel shows, 0 = nobody, shape (H, W), int32; people may share it
    number: int  # the person's there
    camera: Perspective | None = None  # the picture's


@dataclass(frozen=True)
class _Windows:
    """Windows of N people (``person_windows``), keypoints in them, and the areas of them that are looked at."""

    starts: np.ndarray  # (N, 2) left and top in the picture [px]
    zooms: np.ndarray  # (N,)
    sizes: np.ndarray  # (N, 2) height and width
    points: np.ndarray  # (N, J, 2)
    confidence: np.ndarray  # (N, J)
    areas: np.ndarray  # (N, 4) top, left, height and width

    @property
    def ends(self) -> np.ndarray:
        return self.starts + self.sizes[:, ::-1] / self.zooms[:, None]

    def __getitem__(self, part: slice) -> _Windows:
        return _Windows(*(getattr(self, each.name)[part] for each in fields(self)))


def cut_masks(people: Sequence[MaskedPerson], device: torch.device | str) -> list[CutOut]:
    """Evidence, whose labels are left out, observation and crop of each person.

    Raises:
        InputError: If somebody's keypoints can't be used.
    """
    device = torch.empty(0, device=device).device  # with its number, which Warp asks for
    found: dict[int, CutOut] = {}
    for form in dict.fromkeys(person.keypoints.skeleton for person in people):
        places = [place for place, person in enumerate(people) if person.keypoints.skeleton == form]
        found |= zip(places, _cut_alike([people[place] for place in places], device), strict=True)
    return [found[place] for place in range(len(people))]


@one_torch_thread()
def _cut_alike(people: Sequence[MaskedPerson], device: torch.device) -> list[CutOut]:
    """Cut out people with one skeleton, as ``cut_masks`` does."""
    form = people[0].keypoints.skeleton
    points = np.stack([person.keypoints.points for person in people])
    confidence = np.stack([person.keypoints.confidence for person in people])
    _check_all(people, points, confidence)
    sizes = np.array([person.owners.shape for person in people])
    starts, zooms, insides = person_windows(form, points, confidence, sizes)
    there = _Windows(starts, zooms, insides, points, confidence, np.zeros((len(people), 4), np.int64))
    mine = _inside(there, points)
    boxes = reach_boxes(form, mine, confidence)
    low, high = np.floor(boxes[:, 1::-1]) - 1, np.ceil(boxes[:, :1:-1]) + 1
    low, high = (each.clip(0, insides).astype(np.int64) for each in (low, high))
    windows = replace(there, points=mine, areas=np.concatenate([low, high - low], axis=1))
    groups = np.cumsum((high - low).prod(axis=1)) // _PIXELS[device.type]
    steps = [0, *(np.flatnonzero(np.diff(groups)) + 1).tolist(), len(people)]
    return [
        each
        for start, stop in pairwise(steps)
        for each in _cut_together(people[start:stop], windows[start:stop], device)
    ]


def _check_all(people: Sequence[MaskedPerson], points: np.ndarray, confidence: np.ndarray) -> None:
    """``check_places`` of those who may fail."""
    visible = confidence > 0
    first = np.take_along_axis(points, visible.argmax(axis=1)[:, None, None], axis=1)
    differ = (visible & (points != first).any(axis=2)).any(axis=1)
    known = ((np.abs(points) <= LARGEST_PLACE).all(axis=2) | ~visible).all(axis=1)
    for place in np.flatnonzero(~(differ & known)).tolist():
        check_places(people[place].keypoints)


def _inside(windows: _Windows, points: np.ndarray) -> np.ndarray:
    """Keypoints (N, J, 2) of pictures in pixels of windows; missing ones stay at 0 (``crop_keypoints``)."""
    scale = windows.sizes[:, ::-1] / (windows.ends - windows.starts)
    moved = (points - windows.starts[:, None]) * scale[:, None]
    return np.where(windows.confidence[..., None] > 0, moved, 0.0).astype(np.float32)


def _cut_together(people: Sequence[MaskedPerson], windows: _Windows, device: torch.device) -> list[CutOut]:
    """Cut out people whose areas memory holds."""
    keypoints = [person.keypoints for person in people]
    lines = body_lines(keypoints[0].skeleton, windows.points, windows.confidence)
    with on_torch_stream(device) as where:
        work = _Work(people, windows, lines, device, wp.get_device(where))
        counts = work.measured()
        labelled, complete = counts[:, 1] >= 0, lines.num_flesh > 0
        stray = are_stray(*counts[:, [4, 5, 7]].T) & complete
        if stray.any():
            counts = work.without_stray(stray)
        known, far = counts[:, 4], counts[:, 6]
        elsewhere = complete & (4 * far / np.maximum(known, 1) > MOST_DISAGREEMENT)
        # Without labels there is no window.
        starts = np.where(labelled[:, None], windows.starts, 0.0)
        zooms = np.where(labelled, windows.zooms, 1.0)
        own = np.stack([each.keypoints.points for each in people])
        mine = np.where(labelled[:, None, None], windows.points, np.where(windows.confidence[..., None] > 0, own, 0.0))
        low, high = _extents(mine, confident(windows.confidence), counts)
        middles, halves = crop_squares(low, high)
        corners = starts + (middles - halves[:, None]) / zooms[:, None]
        targets = work.targets(corners, 2 * halves / zooms)
    found: list[WeighedPerson] = []
    for n, person in enumerate(people):
        height, width = windows.sizes[n].tolist() if labelled[n] else (1, 1)
        told = [*keypoint_warnings(person.keypoints)]
        told += [stray_warning(MASK_LABELS.group_names)] if stray[n] else []
        told += [elsewhere_warning(MASK_LABELS)] if elsewhere[n] else []
        weighed = WeighedPerson(
            person.keypoints,
            mine[n, windows.confidence[n] > 0],
            Crop(float(starts[n, 0]), float(starts[n, 1]), float(zooms[n]), (height, width)),
            targets[n] if labelled[n] else None,
            MASK_LABELS if labelled[n] else None,
            tuple(told),
            person.camera,
        )
        found.append(weighed)
    return observe_together(found, middles, halves, device)


def _extents(points: np.ndarray, sure: np.ndarray, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest (x, y) of keypoints and of the pixels that were counted, shape (N, 2)."""
    places = points.astype(np.float64)
    low = np.where(sure[..., None], places, np.inf).min(axis=1)
    high = np.where(sure[..., None], places, -np.inf).max(axis=1)
    some = counts[:, 1:2] >= 0
    low = np.where(some, np.minimum(low, counts[:, [2, 0]]), low)
    high = np.where(some, np.maximum(high, counts[:, [3, 1]] + 1), high)
    return low, high


class _Work:
    """Arrays of N people on the device, and the launches; on CPU, threads share the people."""

    def __init__(
        self,
        people: Sequence[MaskedPerson],
        windows: _Windows,
        lines: BodyLines,
        device: torch.device,
        where: wp.Device,
    ) -> None:
        self._device, self._windows, self._lines = device, windows, lines
        pictures = {id(person.owners): person.owners for person in people}
        packed = [each.to(device, torch.int32).reshape(-1) for each in pictures.values()]
        first = dict(zip(pictures, np.cumsum([0, *map(len, packed)]).tolist(), strict=False))
        shown = [(first[id(each.owners)], *each.owners.shape, each.number) for each in people]
        boxes = np.concatenate(
            [windows.starts[:, ::-1], (windows.ends - windows.starts)[:, ::-1] / windows.sizes], axis=1
        )
        rows, columns = windows.areas[:, 2], windows.areas[:, 3]
        self._rows, ends = (np.concatenate([[0], np.cumsum(each)]) for each in (rows, rows * columns))
        of_people = [np.array(shown), windows.sizes, windows.areas, self._rows, ends[:-1]]
        owners = packed[0] if len(packed) == 1 else torch.cat(packed)
        numbers = [self._array(each.astype(np.int32)) for each in of_people]
        shown_people = own_pixels.gather(
            own_pixels.PeopleArrays, [warp_array(owners), *numbers[:2], self._array(boxes), *numbers[2:]]
        )
        strides = np.maximum(np.ceil(windows.sizes.max(axis=1) / COARSE), 1).astype(np.int32)
        bodies = own_pixels.gather(
            own_pixels.BodyArrays,
            [
                self._array(lines.bones, own_pixels.Bone),
                self._array(lines.num_bones),
                self._array(lines.flesh, own_pixels.Flesh),
                self._array(lines.num_flesh),
                self._array(lines.heights),
                self._array(strides),
            ],
        )
        count = int(ends[-1])
        kinds = (torch.uint8, torch.uint8, torch.int32, torch.uint8)
        held = [torch.empty(count, dtype=kind, device=device) for kind in kinds]
        pixels = own_pixels.gather(own_pixels.PixelArrays, [warp_array(each) for each in held])
        self._arrays = shown_people, bodies, pixels
        self._parts = split_batch(len(people), on_cpu=where.is_cpu)
        if len(self._parts) > 1:
            for module in (own_pixels, mask_targets):
                wp.load_module(module, device=where)

    def _array(self, values: np.ndarray, kind: Any = None) -> wp.array:
        return warp_array(torch.from_numpy(np.ascontiguousarray(values)).to(self._device), kind)

    def _launch(self, launch: Callable[[slice], None]) -> None:
        """Launch on the rows of each thread's people."""
        run_slices(lambda part: launch(slice(int(self._rows[part.start]), int(self._rows[part.stop]))), self._parts)

    def measured(self) -> np.ndarray:
        """Find the people's own pixels, and measure them: ``own_pixels.NUM_COUNTS`` of each."""
        self._launch(partial(own_pixels.launch_own, *self._arrays))
        return self._counts()

    def without_stray(self, chosen: np.ndarray) -> np.ndarray:
        """Ignore stray pixels of chosen people, and measure again."""
        self._launch(partial(own_pixels.launch_stray, *self._arrays, STRAY, self._array(chosen.astype(np.uint8))))
        return self._counts()

    def _counts(self) -> np.ndarray:
        start = np.array([_NEVER, -1] * 2 + [0] * (own_pixels.NUM_COUNTS - 4), dtype=np.int32)
        counts = torch.from_numpy(np.tile(start, (len(self._windows.zooms), 1))).to(self._device)
        self._launch(partial(own_pixels.launch_counts, *self._arrays, (FAR, STRAY), warp_array(counts)))
        return counts.cpu().numpy()

    def targets(self, corners: np.ndarray, sides: np.ndarray) -> torch.Tensor:
        """Labels in crops with these corners (x, y) and sides, shape (N, S, S), uint8."""
        people, _, pixels = self._arrays
        lines, count = self._lines, len(sides)
        missing = torch.empty(lines.around.shape[:2], dtype=torch.uint8, device=self._device)
        limbs = own_pixels.gather(
            mask_targets.LimbArrays,
            [
                self._array(lines.limbs, mask_targets.Line),
                self._array(lines.around, own_pixels.Bone),
                self._array(lines.num_limbs),
                warp_array(missing),
            ],
        )
        mask_targets.launch_limbs(people, self._array(np.linspace(0, 1, LIMB_SAMPLES)), MISSING_SHARE, limbs)
        steps = ((corners + sides[:, None]) - corners) / LABEL_SIZE
        crops = [
            self._array(np.concatenate([corners[:, ::-1], steps[:, ::-1]], axis=1)),
            self._array(self._windows.zooms),
        ]
        drawn = torch.empty(count, LABEL_SIZE, LABEL_SIZE, dtype=torch.uint8, device=self._device)
        launch = partial(mask_targets.launch_targets, people, limbs, pixels, crops, warp_array(drawn))
        run_slices(launch, self._parts)
        return drawn
