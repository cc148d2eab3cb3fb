"""Evidence of one person: keypoints and labels without others' pixels, contradictions mended and reported."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..body.labels import BACKGROUND, IGNORE, LabelSet
from ..body.landmarks import mirror_name, mirror_order, without_side
from ..body.skeletons import Skeleton
from ..cameras import Crop
from ..errors import InputError, check_each, check_type
from .agreement import LIMBS, compare_sides, disagreement, glance
from .ignored_labels import ignore_stray_labels
from .keypoints import LARGEST_PLACE, Keypoints2D
from .part_labels import PartLabels
from .person import Box, centres, crop_keypoints, crop_nearest, person_labels, reach_boxes
from .selection import select_person

MOST_DISAGREEMENT = 1.0  # see ``agreement.disagreement``
WINDOW_SIDE = 768  # [px]: more of a person is not looked at; a fit keeps a crop of it, at ``LABEL_SIZE``
_FEW = 4  # visible keypoints that are needed to tell more than a place and a size
_STRAIGHT = 0.02  # spread across a line beside that along it; of 400 random poses from all sides, the least is 0.12
_MANY = 3  # groups with stray pixels, from which on it is likelier that the ids mean something else


@dataclass(frozen=True)
class Evidence:
    """Keypoints and labels of a person that a fit uses.

    Attributes:
        keypoints: The person's, in pixels of the picture; left and right as decided.
        picture: Labels of the whole picture, left and right likewise; None if there are none.
        window: The part of the picture where the person's labels may be, made smaller if it is large.
        groups: Group ids in it, others' and stray ones being 255, ignore, shape of the window, uint8; None without.
        warnings: Faults that were found, a sentence each.
    """

    keypoints: Keypoints2D
    picture: PartLabels | None
    window: Crop
    groups: np.ndarray | None
    warnings: tuple[str, ...] = ()

    @property
    def labels(self) -> PartLabels:
        """Labels of the whole picture.

        Raises:
            ValueError: If there are none.
        """
        if self.picture is None:
            raise ValueError("evidence: without part labels; expected some")
        return self.picture

    @property
    def image_size(self) -> tuple[int, int] | None:
        """Size (H, W) of the picture [px]; None if neither labels nor keypoints tell it."""
        if self.picture is None:
            return self.keypoints.image_size
        height, width = self.picture.groups.shape
        return height, width

    def in_window(self) -> Keypoints2D:
        """Keypoints in pixels of the window."""
        return crop_keypoints(self.keypoints, _box_of(self.window), self.window.size)

    def target(self, size: tuple[int, int], box: Box | None = None, *, step: int = 1) -> np.ndarray:
        """Group ids of the person in a box of the picture (None: all), resampled to (H, W); others' and beyond: 255.

        With a ``step``, every so many-th pixel of that alone, as ``centres`` says.

        Raises:
            ValueError: If there are no labels.
        """
        picture = self.labels.groups
        assert self.groups is not None
        height, width = picture.shape
        box = box or (0.0, 0.0, float(width), float(height))
        if self.window == Crop(0.0, 0.0, 1.0, (picture.shape[0], picture.shape[1])):
            target = np.full([side // step for side in size], IGNORE, dtype=np.uint8)  # all of it is in the window
        else:
            target = crop_nearest(picture, box, size, step=step)
            target[target != BACKGROUND] = IGNORE
        rows, from_rows = self._under_window(0, centres(box[1], box[3], size[0], step))
        columns, from_columns = self._under_window(1, centres(box[0], box[2], size[1], step))
        if rows.size and columns.size:  # each without gaps
            place = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
            target[place] = take_pixels(self.groups, from_rows, from_columns)
        return target

    def _under_window(self, axis: int, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Indices of those places along an axis that lie in the window, and the window's pixels there."""
        start = (self.window.top, self.window.left)[axis]
        pixels = np.floor((places - start) * self.window.zoom).astype(np.int64)
        inside = np.flatnonzero((pixels >= 0) & (pixels < self.window.size[axis]))
        return inside, pixels[inside]


def take_pixels(groups: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Pixels of an image (H, W) where some of its rows (K,) and columns (L,) meet, shape (K, L)."""
    # Rows are copied whole, columns pixel by pixel: of as few rows as may be.
    if len(groups) < len(rows):
        return groups.take(columns, axis=1).take(rows, axis=0)
    return groups.take(rows, axis=0).take(columns, axis=1)


def weigh_evidence(
    keypoints: Keypoints2D, parts: PartLabels | None = None, others: Sequence[Keypoints2D] = ()
) -> list[Evidence]:
    """Leave ``others`` out of one person's labels, and find contradictions to the keypoints.

    Gives one reading; two where keypoints and labels disagree on left and right, for either may be wrong: first by the
    keypoints, then by the labels.

    Raises:
        InputError: If no keypoint is visible, all lie in one point, or labels and keypoints do not meet.
    """
    check_type("keypoints", keypoints, Keypoints2D, "one person's, of read_keypoints and choose_person")
    check_type("parts", parts, PartLabels | None, "of read_parts")
    check_each("others", others, Keypoints2D, "of read_keypoints")
    check_places(keypoints)
    if parts is None:
        return [Evidence(keypoints, None, Crop(0.0, 0.0, 1.0, (1, 1)), None, keypoint_warnings(keypoints))]
    if parts.instances is not None:  # then nobody's bones need tell whose a pixel is
        parts, others = person_labels(parts, keypoints), ()
    window = _window(keypoints, parts.groups.shape)
    box, labels = _box_of(window), parts.label_set
    mine = crop_keypoints(keypoints, box, window.size)
    groups = parts.groups
    if window != Crop(0.0, 0.0, 1.0, (groups.shape[0], groups.shape[1])):
        groups = crop_nearest(groups, box, window.size)
    groups = select_person(groups, mine, [crop_keypoints(other, box, window.size) for other in others])
    seen = glance(groups, mine, labels)
    groups, names = ignore_stray_labels(groups, mine, labels, seen)
    warnings = [*keypoint_warnings(keypoints), *([stray_warning(names)] if names else [])]
    if names:
        seen = glance(groups, mine, labels)
    agreements = compare_sides(groups, mine, labels)
    if len(names) >= _MANY or disagreement(agreements, seen) > MOST_DISAGREEMENT:
        warnings.append(elsewhere_warning(labels))
    evidence = Evidence(keypoints, parts, window, groups, tuple(warnings))
    if swapped := [limb for limb, agreement in agreements.items() if agreement.swapped]:
        return list(_either_side(evidence, swapped, whole=len(swapped) == len(agreements)))
    return [evidence]


def stray_warning(names: Iterable[str]) -> str:
    """Sentence about groups that ``ignore_stray_labels`` names."""
    return f"labels: {_join(sorted(names))} also far from any such bone; ignored there"


def elsewhere_warning(labels: LabelSet) -> str:
    """Sentence about labels in ``disagreement`` with the keypoints."""
    return f"labels: parts lie elsewhere than their bones; are these ids of {labels.name}?"


def keypoint_warnings(keypoints: Keypoints2D) -> tuple[str, ...]:
    """Sentences about keypoints: those of their file, and one if they are too few, or lie too straight, for a pose."""
    points = keypoints.points[keypoints.visible].astype(np.float64)
    if len(points) < _FEW:
        are = "1 is" if len(points) == 1 else f"{len(points)} are"
        return (*keypoints.warnings, f"keypoints: only {are} visible; most of the body is a guess")
    if _spread_across(points) < _STRAIGHT:
        return (*keypoints.warnings, "keypoints: all lie in a line; most of the body is a guess")
    return keypoints.warnings


def _spread_across(points: np.ndarray) -> float:
    """Spread of points (N, 2) across the line that fits them best, as a share of that along it."""
    x, y = (points - points.mean(axis=0)).T
    xx, xy, yy = float(x @ x), float(x @ y), float(y @ y)
    middle, apart = (xx + yy) / 2, math.hypot((xx - yy) / 2, xy)  # of the eigenvalues of their covariance
    return math.sqrt(max(middle - apart, 0.0) / (middle + apart)) if middle > 0 else 0.0


def check_places(keypoints: Keypoints2D) -> None:
    """Raise InputError unless keypoints are visible, in places that a picture may have, and in different ones."""
    visible = keypoints.visible
    if not visible.any():
        raise InputError("keypoints: none is visible; expected at least one with a confidence above 0")
    if not (np.abs(keypoints.points[visible]) <= LARGEST_PLACE).all():
        raise InputError(f"keypoints: hold NaN, or numbers beyond {LARGEST_PLACE:g}; expected pixels")
    points = keypoints.points[visible]
    if (points == points[0]).all():
        raise InputError("keypoints: all lie in one point; expected different places")


def _window(keypoints: Keypoints2D, size: tuple[int, int]) -> Crop:
    """Part of the picture in which the person's labels may be: all of it unless it is large."""
    one = keypoints.skeleton, keypoints.points[None], keypoints.confidence[None], np.array([size])
    starts, zooms, sizes = person_windows(*one)
    (left, top), (height, width) = starts[0].tolist(), sizes[0].tolist()
    return Crop(left, top, float(zooms[0]), (height, width))


def person_windows(
    form: str | Skeleton, points: np.ndarray, confidence: np.ndarray, sizes: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Windows of N people with one skeleton in pictures of (H, W), shape (N, 2): a crop's corner, zoom and (H, W)."""
    limits = sizes[:, ::-1].astype(np.float64)
    small = sizes.max(axis=1, keepdims=True) <= WINDOW_SIDE
    if small.all():
        return np.zeros_like(limits), np.ones(len(sizes)), sizes
    boxes = reach_boxes(form, points, confidence)
    low = np.floor(np.minimum(np.maximum(boxes[:, :2], 0.0), limits - 1.0))
    high = np.ceil(np.minimum(np.maximum(boxes[:, 2:], low + 1.0), limits))
    low, high = np.where(small, 0.0, low), np.where(small, limits, high)
    zooms = np.minimum(1.0, WINDOW_SIDE / (high - low).max(axis=1))
    return low, zooms, np.maximum(((high - low) * zooms[:, None]).astype(np.int64), 1)[:, ::-1]


def _box_of(window: Crop) -> Box:
    height, width = window.size
    return window.left, window.top, window.left + width / window.zoom, window.top + height / window.zoom


def _either_side(seen: Evidence, swapped: list[str], *, whole: bool) -> Iterator[Evidence]:
    """Labels with left and right exchanged; then, instead, keypoints.

    Of the ``LIMBS`` in ``swapped``, or, if ``whole``, of head and trunk as well: nothing that can be compared is right.
    """
    assert seen.groups is not None
    picture = seen.labels
    kinds = None if whole else {kind for limb in swapped for kind in LIMBS[limb]}
    joints = None if whole else {joint for limb in swapped for joint in _LIMB_JOINTS[limb]}
    where = "" if whole else f" of {_join(swapped)}"
    table = _mirrored_groups(picture.label_set, kinds)
    maps = None if picture.maps is None else picture.maps[table[: len(picture.maps)]]
    exchanged = replace(picture, groups=table[picture.groups], maps=maps)
    told = f"labels: left and right{where} exchanged, say the keypoints; taken so"
    yield replace(seen, picture=exchanged, groups=table[seen.groups], warnings=(*seen.warnings, told))
    told = f"keypoints: left and right{where} exchanged, say the labels; taken so"
    mine = seen.keypoints
    mirror = mirror_order(mine.format.landmarks, joints)
    keypoints = replace(mine, points=mine.points[mirror], confidence=mine.confidence[mirror])
    yield replace(seen, keypoints=keypoints, warnings=(*seen.warnings, told))


def _mirrored_groups(labels: LabelSet, kinds: set[str] | None) -> np.ndarray:
    """Mirror image of each group whose parts are all of these kinds (None: any), shape (256,), uint8."""
    table = np.arange(256, dtype=np.uint8)
    names = labels.group_names
    for name, parts in labels.groups.items():
        of_kind = kinds is None or set(map(without_side, parts)) <= kinds
        if of_kind and mirror_name(name) in names:
            table[names.index(name) + 1] = names.index(mirror_name(name)) + 1
    return table


_LIMB_JOINTS = {
    "arms": ("elbow", "wrist", "fingertip", "thumb", "index", "pinky"),
    "legs": ("knee", "ankle", "toe", "foot_index", "big_toe", "small_toe", "heel"),
}


def _join(names: Sequence[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
