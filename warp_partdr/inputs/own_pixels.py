"""Pixels that belong to N people in pictures: they are found, measured, and drawn in crops, on a device.

One person is a batch of one. Part labels and masks are treated alike: a mask is a label of one group.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from threading import Lock
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
import torch
import warp as wp

from ..body.labels import LabelSet
from ..body.skeletons import Skeleton
from ..cameras import Crop
from ..errors import InputError
from ..interop.arrays import tensor_over, warp_array
from ..interop.streams import on_torch_stream
from ..kernels import own_pixels, own_targets
from ..kernels.launch import run_slices, split_batch
from .body_lines import LIMBS, Points, bones_of, flesh_of, limb_of, limb_sides, limbs_of
from .keypoints import Keypoints2D, confident, person_heights
from .person import is_labelled, label_bounds, reach_boxes

CPU = torch.device("cpu")
WINDOW_SIDE = 768  # [px], largest side of a window; a fit keeps a crop of it, at ``LABEL_SIZE``

COARSE = 192  # [px], largest side of a window at the stride at which labels are compared with keypoints
FAR = 0.05  # share of the person's height; a pixel so far beyond a group's flesh is far
STRAY = 0.1  # share of the person's height; no part of a group reaches so far, clothes included

_SIDE_SAMPLES = 48  # points along a bone where sides are compared,
_JOINT = 0.1  # without this share at either end, which may show the next part
_LIMB_SAMPLES = 64  # points along a bone that may be missing
_MISSING_SHARE = 1 / 3  # least share of a bone on background if its limb is missing
_NEVER = 2**30  # more than any row or column

_loaded: set[str] = set()  # devices that have the kernels
_loading = Lock()


class Mask(NamedTuple):
    """Mask of a person: the pixels of a picture with the person's number."""

    owners: torch.Tensor  # number of the person whom each pixel shows, 0 = nobody, (H, W), int32; people may share it
    number: int  # number of this person, from 1 on

    def groups(self) -> np.ndarray:
        """Group ids: 1 for the person, 0 for nobody, 255 for others, shape (H, W), uint8."""
        filled = torch.empty_like(self.owners, dtype=torch.uint8)
        with on_torch_stream(filled.device):
            own_pixels.launch_mask_groups(warp_array(self.owners), self.number, warp_array(filled))
        groups: np.ndarray = filled.cpu().numpy()
        return groups


@dataclass(frozen=True)
class Windows:
    """Windows: parts of pictures around N people with one skeleton, scaled down if they are large.

    Attributes:
        form: Skeleton of the keypoints.
        starts: Left and top in the picture [px], shape (N, 2).
        zooms: Pixels of the window for each pixel of the picture, shape (N,).
        sizes: Height and width of the window [px], shape (N, 2).
        points: Keypoints in the windows [px], 0 where missing, shape (N, J, 2), float32.
        confidence: Confidences of the keypoints, 0 where missing, shape (N, J).
    """

    form: str | Skeleton
    starts: np.ndarray
    zooms: np.ndarray
    sizes: np.ndarray
    points: np.ndarray
    confidence: np.ndarray

    @classmethod
    def of(cls, form: str | Skeleton, points: np.ndarray, confidence: np.ndarray, sizes: np.ndarray) -> Windows:
        """Choose windows in pictures with sizes (H, W), shape (N, 2): the whole picture unless it is large."""
        limits = sizes[:, ::-1].astype(np.float64)
        low, high, zooms = np.zeros_like(limits), limits, np.ones(len(sizes))
        small = sizes.max(axis=1, keepdims=True) <= WINDOW_SIDE
        if not small.all():
            boxes = reach_boxes(form, points, confidence, person_heights(form, points, confidence))
            left_top = np.floor(np.minimum(np.maximum(boxes[:, :2], 0.0), limits - 1.0))
            right_bottom = np.ceil(np.minimum(np.maximum(boxes[:, 2:], left_top + 1.0), limits))
            low, high = np.where(small, 0.0, left_top), np.where(small, limits, right_bottom)
            zooms = np.minimum(1.0, WINDOW_SIDE / (high - low).max(axis=1))
        inside = np.maximum(((high - low) * zooms[:, None]).astype(np.int64), 1)[:, ::-1]
        return cls.at(form, points, confidence, low, zooms, inside)

    @classmethod
    def at(
        cls,
        form: str | Skeleton,
        points: np.ndarray,
        confidence: np.ndarray,
        starts: np.ndarray,
        zooms: np.ndarray,
        sizes: np.ndarray,
    ) -> Windows:
        """Build windows from corners, zooms and sizes, and from keypoints (N, J, 2) in pixels of the pictures."""
        found = cls(form, starts, zooms, sizes, points, confidence)
        return replace(found, points=found.convert_points(points, confidence, slice(None)))

    @property
    def ends(self) -> np.ndarray:
        """Right and bottom in the picture [px], shape (N, 2)."""
        return self.starts + self.sizes[:, ::-1] / self.zooms[:, None]

    @cached_property
    def heights(self) -> np.ndarray:
        """Heights of the people [px], shape (N,)."""
        return person_heights(self.form, self.points, self.confidence)

    def convert_points(self, points: np.ndarray, confidence: np.ndarray, rows: slice | np.ndarray) -> np.ndarray:
        """Convert keypoints (M, J, 2) from pixels of pictures to pixels of windows; missing ones become 0."""
        scale = self.sizes[rows, ::-1] / (self.ends - self.starts)[rows]
        converted = (points - self.starts[rows, None]) * scale[:, None]
        return np.where(confidence[..., None] > 0, converted, 0.0).astype(np.float32)

    def crop(self, row: int) -> Crop:
        """Return one window as a crop."""
        (left, top), (height, width) = self.starts[row].tolist(), self.sizes[row].tolist()
        return Crop(left, top, float(self.zooms[row]), (height, width))

    def areas(self, pictures: Sequence[np.ndarray | Mask]) -> np.ndarray:
        """Areas of the windows that hold all pixels that may be the people's: top, left, height and width, (N, 4)."""
        boxes = reach_boxes(self.form, self.points, self.confidence, self.heights)
        low = (np.floor(boxes[:, 1::-1]) - 1).clip(0, self.sizes).astype(np.int64)
        high = (np.ceil(boxes[:, :1:-1]) + 1).clip(0, self.sizes).astype(np.int64)
        for n, picture in enumerate(pictures):
            if not isinstance(picture, Mask) or picture.owners.device.type == "cpu":
                low[n], high[n] = self._bounds(n, picture, low[n], high[n])
        return np.concatenate([low, high - low], axis=1)

    def _bounds(
        self, n: int, picture: np.ndarray | Mask, low: np.ndarray, high: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Part of an area, from one (row, column) to another, that holds all labels, and a pixel more for the zoom."""
        start, zoom = self.starts[n, ::-1], self.zooms[n]
        top, left = np.maximum(np.floor(start + low / zoom).astype(np.int64) - 1, 0).tolist()
        bottom, right = (np.ceil(start + high / zoom).astype(np.int64) + 1).tolist()
        if isinstance(picture, Mask):
            labelled = picture.owners[top:bottom, left:right].numpy() == picture.number
        else:
            labelled = picture[top:bottom, left:right]  # 0 is BACKGROUND
        rows, columns = label_bounds(labelled)
        first = np.floor((np.array([top + rows.start, left + columns.start]) - start) * zoom).astype(np.int64) - 1
        stop = np.ceil((np.array([top + rows.stop, left + columns.stop]) - start) * zoom).astype(np.int64) + 1
        first = np.clip(first, low, high)
        return first, np.clip(stop, first, high)


class Measures(NamedTuple):
    """Measures of N people's own pixels; counts have the shape (N, G + 1)."""

    low: np.ndarray  # lowest (x, y) of the pixels [px], shape (N, 2); inf without pixels
    high: np.ndarray  # highest (x, y), beyond the last pixel, shape (N, 2); -inf without pixels
    complete: np.ndarray  # true for groups whose keypoints are all known, shape (N, G + 1), bool
    counts: np.ndarray  # pixels of each group, counted at a stride (``COARSE``)
    within: np.ndarray  # pixels among them within the group's flesh, 0 where its keypoints are not all known
    far: np.ndarray  # pixels among them that are ``FAR`` from it
    stray: np.ndarray  # pixels among them that are as far as ``STRAY`` from it


class OwnPixels:
    """Pixels of N people in windows of pictures, on a device; threads of the CPU share the people.

    It launches kernels, so use it inside ``on_torch_stream``.

    Args:
        pictures: Group ids of each person's picture, shape (H, W), or the person's mask; people may share them.
        windows: Windows around the people.
        device: Torch's device, with its index, such as "cuda:0".
        labels: Label set of the group ids; None: groups are not measured.
        known: Group ids of a single person in the whole window, if they are known already, shape (H, W), uint8; only on
            the CPU.

    Raises:
        ValueError: If ``known`` have another shape than the window.
    """

    def __init__(
        self,
        pictures: Sequence[np.ndarray | Mask],
        windows: Windows,
        device: torch.device,
        *,
        labels: LabelSet | None = None,
        known: np.ndarray | None = None,
    ) -> None:
        self.windows, self.labels = windows, labels
        self._device = device
        count = len(pictures)
        if known is not None and (known.shape != tuple(windows.sizes[0]) or known.dtype != np.uint8):
            raise ValueError(f"groups: {known.dtype} {known.shape}; expected uint8 {tuple(windows.sizes[0].tolist())}")
        areas = windows.areas(pictures) if known is None else np.array([[0, 0, *windows.sizes[0]]])
        self._rows = np.concatenate([[0], np.cumsum(areas[:, 2])])
        ends = np.cumsum(areas[:, 2] * areas[:, 3])
        firsts = np.concatenate([[0], ends[:-1]])
        packed, sources = _pack(pictures, device)
        boxes = np.concatenate(
            [windows.starts[:, ::-1], (windows.ends - windows.starts)[:, ::-1] / windows.sizes], axis=1
        )
        self._people = own_pixels.gather(
            own_pixels.PeopleArrays,
            [
                *packed,
                self._array(sources.astype(np.int32)),
                self._array(windows.sizes.astype(np.int32)),
                self._array(boxes),
                self._array(areas.astype(np.int32)),
                self._array(self._rows.astype(np.int32)),
                self._array(firsts.astype(np.int32)),
            ],
        )
        dtypes = (torch.uint8, *[torch.int32] * 4, torch.uint8)
        size = int(ends[-1])
        sizes = [size, int(self._rows[-1]), size, size, size, size] if known is None else [0] * 6
        held = [torch.empty(each, dtype=dtype, device=device) for each, dtype in zip(sizes, dtypes, strict=True)]
        if known is not None:
            held[0] = tensor_over(known).reshape(-1)
        self._pixels = own_pixels.gather(own_pixels.PixelArrays, [warp_array(each) for each in held])
        self._limbs = self._find_limbs()
        self._parts = split_batch(count, on_cpu=device.type == "cpu")
        _load_once(own_pixels, own_targets, device=device)

    def _array(self, values: np.ndarray, dtype: Any = None) -> wp.array:
        if not values.size and dtype is not None:  # torch's strides of an empty array don't fit Warp's vectors
            return wp.empty(values.shape[:-1], dtype=dtype, device=wp.device_from_torch(self._device))
        return warp_array(torch.from_numpy(np.ascontiguousarray(values)).to(self._device), dtype)

    def _launch(self, launch: Callable[[slice], None]) -> None:
        """Launch once for the rows of each thread's people."""
        run_slices(lambda part: launch(slice(int(self._rows[part.start]), int(self._rows[part.stop]))), self._parts)

    def _find_bodies(self, others: Sequence[Sequence[Keypoints2D]]) -> None:
        """Find bones and flesh of the people, and bones of the others beside each."""
        windows = self.windows
        inside = [
            each._replace(points=windows.convert_points(each.points, each.confidence, each.beside))
            for each in _by_skeleton(others)
        ]
        bones = bones_of(windows.form, windows.points, windows.confidence, windows.heights, inside)
        flesh = flesh_of(windows.form, windows.points, windows.confidence, self.labels)
        strides = np.maximum(np.ceil(windows.sizes.max(axis=1) / COARSE), 1).astype(np.int32)
        self._complete = flesh.complete.astype(bool)
        self._bodies = own_pixels.gather(
            own_pixels.BodyArrays,
            [
                self._array(bones.lines, own_pixels.Bone),
                self._array(bones.counts),
                self._array(bones.theirs, own_pixels.Bone),
                self._array(bones.first_theirs),
                self._array(bones.reaches),
                self._array(flesh.lines, own_pixels.Flesh),
                self._array(flesh.firsts),
                self._array(flesh.complete),
                self._array(windows.heights),
                self._array(strides),
            ],
        )

    def select(self, others: Sequence[Sequence[Keypoints2D]]) -> Measures:
        """Find the people's own pixels, without those of others beside each, and ignore the rest."""
        self._find_bodies(others)
        along = torch.zeros(len(self.windows.zooms), dtype=torch.int32, device=self._device)
        arrays = self._people, self._bodies, self._pixels
        self._launch(partial(own_pixels.launch_near, *arrays, warp_array(along)))
        measures = self._settle(kept=True)
        self.along = along.cpu().numpy() > 0
        return measures

    def ignore_stray(self, groups: np.ndarray) -> Measures:
        """Ignore stray pixels, with all pixels connected to them, of the groups that are true in (N, G + 1)."""
        left = groups.copy()
        while left.any():
            chosen = np.where(left.any(axis=1), left.argmax(axis=1), 0)
            left[np.arange(len(left)), chosen] = False
            arrays = self._people, self._bodies, self._pixels
            self._launch(partial(own_pixels.launch_stray, *arrays, STRAY, self._array(chosen.astype(np.int32))))
            measures = self._settle(kept=False)
        return measures

    def _settle(self, *, kept: bool) -> Measures:
        """Keep the pixels that are connected to seeds, or ignore them, and measure the pixels that are left."""
        count, groups = self._complete.shape
        limits = torch.tensor([[_NEVER, -1] * 2], dtype=torch.int32).repeat(count, 1).to(self._device)
        counts = torch.zeros((count, groups, own_pixels.NUM_COUNTS), dtype=torch.int32, device=self._device)
        arrays, measures = (self._people, self._bodies, self._pixels), (warp_array(limits), warp_array(counts))
        self._launch(partial(own_pixels.launch_settled, *arrays, kept, (FAR, STRAY), measures))
        edges, numbers = limits.cpu().numpy(), counts.cpu().numpy()
        has_pixels = edges[:, 1:2] >= 0
        low = np.where(has_pixels, edges[:, [2, 0]], np.inf)
        high = np.where(has_pixels, edges[:, [3, 1]] + 1.0, -np.inf)
        return Measures(low, high, self._complete, *np.moveaxis(numbers, 2, 0))

    def sides(self) -> np.ndarray:
        """Count samples along the bones of people's ``LIMBS`` that lie on own, mirrored and other labels, (N, 2, 3)."""
        count, limbs = self._known_limbs.shape
        sums = np.zeros((count, len(LIMBS), own_targets.NUM_SIDES), dtype=np.int64)
        assert self.labels is not None
        sides = limb_sides(self.windows.form, self.labels.part_groups.tobytes())
        if not sides.any():
            return sums
        counts = torch.empty((count, limbs, own_targets.NUM_SIDES), dtype=torch.int32, device=self._device)
        shares = self._array(np.linspace(_JOINT, 1 - _JOINT, _SIDE_SAMPLES))
        own_targets.launch_sides(
            self._people, self._pixels, self._limbs, shares, self._array(sides), warp_array(counts)
        )
        for limb, found in zip(limb_of(self.windows.form), np.moveaxis(counts.cpu().numpy(), 1, 0), strict=True):
            sums[:, limb] += found
        return sums

    def _find_limbs(self) -> Any:
        windows = self.windows
        limbs = limbs_of(windows.form, windows.points, windows.confidence, windows.heights)
        self._known_limbs = limbs.known
        missing = torch.zeros(limbs.known.shape, dtype=torch.uint8, device=self._device)
        return own_pixels.gather(
            own_targets.LimbArrays,
            [
                self._array(limbs.lines, own_targets.Line),
                self._array(limbs.around, own_targets.Around),
                self._array(limbs.known),
                warp_array(missing),
            ],
        )

    def targets(
        self, low: np.ndarray, high: np.ndarray, size: tuple[int, int], *, every: int = 1, trust: bool = False
    ) -> torch.Tensor:
        """Group ids in boxes of the pictures. Other people's pixels and missing limbs are 255, ignore.

        Args:
            low: Left and top of the boxes in the pictures [px], shape (N, 2).
            high: Right and bottom of the boxes [px], shape (N, 2).
            size: Height and width at which the boxes are drawn [px].
            every: Step between the pixels that are drawn; each is the middle one of ``every`` x ``every`` pixels.
            trust: True: background stays background where confident keypoints say that a limb is.

        Returns:
            Group ids, shape (N, H // every, W // every), uint8.
        """
        if not trust and self._known_limbs.size:
            shares = self._array(np.linspace(0, 1, _LIMB_SAMPLES))
            own_targets.launch_limbs(self._people, self._pixels, self._limbs, shares, _MISSING_SHARE)
        steps = (high - low)[:, ::-1] / size
        crops = [self._array(np.concatenate([low[:, ::-1], steps], axis=1)), self._array(self.windows.zooms)]
        height, width = size[0] // every, size[1] // every
        quads = -(-width // 4)
        columns = torch.empty(len(low), 4 * quads, 4, dtype=torch.int32, device=self._device)
        under = warp_array(columns, wp.vec4i)
        own_targets.launch_crop_columns(self._people, crops, every, under)
        drawn = torch.empty(len(low), height, quads, dtype=torch.int32, device=self._device)
        out = warp_array(drawn, wp.uint32)

        def launch(part: slice) -> None:
            own_targets.launch_targets(self._people, self._pixels, self._limbs, crops, every, under, out, part)

        run_slices(launch, self._parts)
        return drawn.view(torch.uint8)[..., :width].contiguous()

    def window_groups(self) -> np.ndarray:
        """Group ids in the window of a batch's only person; pixels that are not the person's are 255, (H, W), uint8."""
        height, width = self.windows.sizes[0].tolist()
        found: np.ndarray = self.targets(self.windows.starts, self.windows.ends, (height, width), trust=True)[0].numpy()
        return found


def _pack(pictures: Sequence[np.ndarray | Mask], device: torch.device) -> tuple[list[wp.array], np.ndarray]:
    """Labels and owners of all pictures, and each person's first pixel, height, width and number in them, (N, 4)."""
    images = [each.owners if isinstance(each, Mask) else each for each in pictures]
    held: tuple[dict[int, tuple[torch.Tensor, int]], ...] = ({}, {})
    sizes = [0, 0]
    sources = []
    for picture, image in zip(pictures, images, strict=True):
        masked = isinstance(picture, Mask)
        if id(image) not in held[masked]:
            dtype = torch.int32 if masked else torch.uint8
            tensor = tensor_over(image) if isinstance(image, np.ndarray) else image
            held[masked][id(image)] = tensor.to(device, dtype).reshape(-1), sizes[masked]
            sizes[masked] += image.shape[0] * image.shape[1]
        number = picture.number if isinstance(picture, Mask) else 0
        sources.append((held[masked][id(image)][1], *image.shape, number))
    packed = []
    for each, dtype in zip(held, (torch.uint8, torch.int32), strict=True):
        tensors = [tensor for tensor, _ in each.values()]
        whole = torch.cat(tensors) if len(tensors) > 1 else (tensors or [torch.empty(0, dtype=dtype, device=device)])[0]
        packed.append(warp_array(whole))
    return packed, np.array(sources)


def _load_once(*modules: ModuleType, device: torch.device) -> None:
    """Load the kernels before threads start, because each thread would build those that are missing."""
    with _loading:
        if str(device) not in _loaded:
            for module in modules:
                wp.load_module(module, device=wp.device_from_torch(device))
            _loaded.add(str(device))


def extents(
    points: np.ndarray, confidence: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest (x, y) of N people's confident keypoints and of their pixels, shape (N, 2).

    Args:
        points: Keypoints, shape (N, J, 2).
        confidence: Confidences of the keypoints, shape (N, J).
        low: Lowest (x, y) of the people's pixels, shape (N, 2); inf without pixels.
        high: Highest (x, y) of the people's pixels, shape (N, 2); -inf without pixels.
    """
    positions, usable = points.astype(np.float64), confident(confidence)[..., None]
    low = np.minimum(np.where(usable, positions, np.inf).min(axis=1), low)
    high = np.maximum(np.where(usable, positions, -np.inf).max(axis=1), high)
    return low, high


def person_extents(keypoints: Keypoints2D, groups: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest (x, y) [px] of a person's confident keypoints and labels, shape (1, 2).

    ``groups`` (H, W) hold this person's ids alone (``select_person``); None: there are no labels.
    """
    low, high = np.full((1, 2), np.inf), np.full((1, 2), -np.inf)
    if groups is not None:
        rows, columns = label_bounds(is_labelled(groups))
        if rows.stop:
            low, high = np.array([[columns.start, rows.start]]), np.array([[columns.stop, rows.stop]])
    return extents(keypoints.points[None], keypoints.confidence[None], low, high)


def _by_skeleton(people: Sequence[Sequence[Keypoints2D]]) -> list[Points]:
    """Keypoints of the others beside each of N people, as one array for each skeleton."""
    found: dict[str | Skeleton, list[tuple[int, Keypoints2D]]] = {}
    for row, some in enumerate(people):
        for each in some:
            found.setdefault(each.skeleton, []).append((row, each))
    return [
        Points(
            form,
            np.stack([each.points for _, each in some]),
            np.stack([each.confidence for _, each in some]),
            np.array([row for row, _ in some]),
        )
        for form, some in found.items()
    ]


def select_person(groups: np.ndarray, keypoints: Keypoints2D, others: Sequence[Keypoints2D] = ()) -> np.ndarray:
    """Keep one person's labels; other people's, and stray ones, become 255, ignore: shape (H, W), uint8.

    Raises:
        InputError: If no labelled pixel lies along the person's bones.
    """
    windows = _whole_picture(groups, keypoints)
    with on_torch_stream(CPU):
        pixels = OwnPixels([groups], windows, CPU)
        pixels.select([others])
        if not pixels.along[0]:
            raise no_label_along_bones()
        return pixels.window_groups()


def no_label_along_bones() -> InputError:
    """Return the error for a person without any labelled pixel."""
    return InputError(
        "keypoints: no labelled pixel along the person's bones; expected keypoints and part labels to agree"
    )


def ignore_missing_limbs(groups: np.ndarray, keypoints: Keypoints2D) -> np.ndarray:
    """Turn background into 255, ignore, along the limbs that one person's labels miss, shape (H, W), uint8.

    A limb is missing if at least a third of the bone between its two confident keypoints lies on background; parts of a
    bone beyond the picture do not count. The region that is then ignored is a little wider than the limb of a mean
    adult of the person's height, because keypoints are not exact. For a forearm, it goes straight on along the hand,
    for which few formats have keypoints. Only background changes, so a limb behind another part is not missing.
    """
    windows = _whole_picture(groups, keypoints)
    with on_torch_stream(CPU):
        pixels = OwnPixels([groups], windows, CPU, known=groups)
        drawn: np.ndarray = pixels.targets(windows.starts, windows.ends, groups.shape)[0].numpy()
    return drawn


def _whole_picture(groups: np.ndarray, keypoints: Keypoints2D) -> Windows:
    one = keypoints.skeleton, keypoints.points[None], keypoints.confidence[None]
    return Windows.at(*one, np.zeros((1, 2)), np.ones(1), np.array([groups.shape]))
