"""Evidence of one person: keypoints and labels without others' pixels, contradictions mended and reported.

Networks miss limbs that are dark, blurred or behind something. Background where an arm is would make a fit hide the
arm: thin, or pointing along the line of sight. Stray labels, a stranger's or a thing's pixels far from the part whose
label they have, would pull limbs away, and F1 of the foreground hides it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import torch

from ..body.labels import LabelSet, label_set
from ..body.landmarks import mirror_name, mirror_order, without_side
from ..cameras import Crop, Perspective
from ..errors import InputError, check_each, check_type
from ..interop.streams import on_torch_stream
from .body_lines import LIMBS
from .keypoints import LARGEST_PLACE, Keypoints2D
from .own_pixels import CPU, Mask, Measures, OwnPixels, Windows, no_label_along_bones, person_extents
from .part_labels import PartLabels
from .person import Box, person_labels

MASK_LABELS = label_set("full1")
MOST_DISAGREEMENT = 1.0  # see ``disagreements``
_FEW = 4  # visible keypoints that are needed to tell more than a place and a size
_STRAIGHT = 0.02  # spread across a line beside that along it; of 400 random poses from all sides, the least is 0.12
_MANY = 3  # groups with stray pixels, from which on it is likelier that the ids mean something else
_LEAST = 0.01  # of the person's pixels: less does no harm
_CONFIRMED = 0.25  # pixels about a part's bones for each one far away; with fewer, its keypoints are in doubt
_FEWEST = 24  # samples below which nothing is said
_SWAPPED = 0.75  # share of the samples on either side's label from which on two limbs are taken for each other


class PicturePerson(NamedTuple):
    """A person in a picture."""

    keypoints: Keypoints2D
    pixels: PartLabels | Mask | None = None  # the picture's labels, or whom its pixels show
    others: Sequence[Keypoints2D] = ()  # in the picture
    camera: Perspective | None = None  # the picture's


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
        return Keypoints2D(self.keypoints.skeleton, self.windows.points[0], self.keypoints.confidence)

    @cached_property
    def windows(self) -> Windows:
        """The window, as of one person."""
        one = self.keypoints.skeleton, self.keypoints.points[None], self.keypoints.confidence[None]
        start = np.array([[self.window.left, self.window.top]])
        return Windows.at(*one, start, np.array([self.window.zoom]), np.array([self.window.size]))

    def extents(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest (x, y) in the window [px] of all that is seen of the person, shape (1, 2)."""
        return person_extents(self.in_window(), self.groups)

    def target(
        self, size: tuple[int, int], box: Box | None = None, *, every: int = 1, trust_background: bool = True
    ) -> np.ndarray:
        """Group ids of the person in a box of the picture (None: all), resampled to (H, W); others' and beyond: 255.

        Args:
            size: Height and width [px].
            box: Left, top, right and bottom in the picture [px].
            every: So many-th pixel of that alone, the middle one of as many.
            trust_background: Background where confident keypoints say that a limb is stays background; else 255.

        Raises:
            ValueError: If there are no labels.
        """
        picture = self.labels.groups
        assert self.groups is not None
        height, width = picture.shape
        left, top, right, bottom = box or (0.0, 0.0, float(width), float(height))
        with on_torch_stream(CPU):
            pixels = OwnPixels([picture], self.windows, CPU, known=self.groups)
            low, high = np.array([[left, top]]), np.array([[right, bottom]])
            drawn: np.ndarray = pixels.targets(low, high, size, every=every, trust=trust_background)[0].numpy()
        return drawn


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
    with on_torch_stream(CPU):
        weighed = weigh_people([PicturePerson(keypoints, parts, others)], CPU)
        if not weighed.pixels.along[0]:
            raise no_label_along_bones()
        groups = weighed.pixels.window_groups()
    evidence = Evidence(keypoints, parts, weighed.pixels.windows.crop(0), groups, weighed.warnings[0])
    if limbs := weighed.swapped[0]:
        return list(_either_side(evidence, limbs, whole=weighed.whole[0]))
    return [evidence]


class WeighedPeople(NamedTuple):
    """Evidence of N people with one skeleton, in pictures with one label set or with masks."""

    pixels: OwnPixels
    measures: Measures
    warnings: list[tuple[str, ...]]
    swapped: list[list[str]]  # those of each person's ``LIMBS`` whose sides differ between labels and keypoints
    whole: list[bool]  # True if these are all that can be compared


def weigh_people(people: Sequence[PicturePerson], device: torch.device) -> WeighedPeople:
    """Find pixels of people with one skeleton, in pictures with one label set or with masks, and contradictions.

    Launches, so it belongs inside ``on_torch_stream``; the device has its number.
    """
    labels, images = MASK_LABELS, list[np.ndarray | Mask]()
    for person in people:
        assert person.pixels is not None
        if isinstance(person.pixels, Mask):
            images.append(person.pixels)
        else:
            labels = person.pixels.label_set
            images.append(person.pixels.groups)
    sizes = np.array([each.owners.shape if isinstance(each, Mask) else each.shape for each in images])
    points = np.stack([person.keypoints.points for person in people])
    confidence = np.stack([person.keypoints.confidence for person in people])
    windows = Windows.of(people[0].keypoints.skeleton, points, confidence, sizes)
    pixels = OwnPixels(images, windows, device, labels=labels)
    measures = pixels.select([person.others for person in people])
    stray = measures.complete & are_stray(measures.looked.sum(axis=1, keepdims=True), measures.within, measures.stray)
    if stray.any():
        measures = pixels.ignore_stray(stray)
    sides = pixels.sides()
    known = np.where(measures.complete, measures.looked, 0).sum(axis=1)
    elsewhere = disagreements(sides, known, measures.far.sum(axis=1)) > MOST_DISAGREEMENT
    elsewhere |= np.count_nonzero(stray, axis=1) >= _MANY
    warnings = []
    for n, person in enumerate(people):
        told = [*keypoint_warnings(person.keypoints)]
        if stray[n].any():
            told.append(stray_warning(labels.group_names[group - 1] for group in np.flatnonzero(stray[n]).tolist()))
        if elsewhere[n]:
            told.append(elsewhere_warning(labels))
        warnings.append(tuple(told))
    names, swapped = np.array(list(LIMBS)), are_swapped(sides)
    compared = sides.any(axis=2).sum(axis=1)
    return WeighedPeople(
        pixels,
        measures,
        warnings,
        [names[row].tolist() for row in swapped],
        (swapped.sum(axis=1) == compared).tolist(),
    )


def are_stray(looked: np.ndarray, within: np.ndarray, far: np.ndarray) -> np.ndarray:
    """True where, of so many pixels of a person, so many of a group's lie far from its flesh, and within it."""
    return (far >= np.maximum(_LEAST * looked, 1.0)) & (within >= _CONFIRMED * far)


def are_swapped(sides: np.ndarray) -> np.ndarray:
    """True for limbs whose sides differ between labels and keypoints, by numbers of ``OwnPixels.sides`` (..., 3)."""
    own, mirrored, _ = np.moveaxis(sides, -1, 0)
    found: np.ndarray = (own + mirrored >= _FEWEST) & (mirrored >= _SWAPPED * (own + mirrored))
    return found


def disagreements(sides: np.ndarray, known: np.ndarray, far: np.ndarray) -> np.ndarray:
    """Measure of disagreement between labels and keypoints of N people, regardless of sides, shape (N,).

    The share of the limbs' bones that run over other parts' labels, plus four times the share of labels that lie far
    from any bone of their part. At most 0.87 for 120 people of PartBench, "realistic" and "hard"; their labels read as
    Sapiens' or ATR's have at least 1.3.

    Args:
        sides: Numbers of places along the limbs' bones, shape (N, limbs, 3), as of ``OwnPixels.sides``.
        known: Numbers of pixels whose distance from flesh is known, shape (N,).
        far: Numbers of these that are far, shape (N,).
    """
    totals = sides.sum(axis=-2)
    bones = totals.sum(axis=-1)
    other = np.where(bones >= 2 * _FEWEST, totals[..., 2] / np.maximum(bones, 1), 0.0)
    return np.asarray(other + 4 * far / np.maximum(known, 1))


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


def _either_side(seen: Evidence, swapped: list[str], *, whole: bool) -> Iterator[Evidence]:
    """Labels with left and right exchanged; then, instead, keypoints: arguments as of ``WeighedPeople``."""
    assert seen.groups is not None
    picture = seen.labels
    table = exchanged_groups(picture.label_set, swapped, whole=whole)
    maps = None if picture.maps is None else picture.maps[table[: len(picture.maps)]]
    exchanged = replace(picture, groups=table[picture.groups], maps=maps)
    told = exchanged_warning(swapped, whole=whole)
    yield replace(seen, picture=exchanged, groups=table[seen.groups], warnings=(*seen.warnings, told))
    told = f"keypoints: left and right{_where(swapped, whole=whole)} exchanged, say the labels; taken so"
    mine = seen.keypoints
    joints = None if whole else {joint for limb in swapped for joint in _LIMB_JOINTS[limb]}
    mirror = mirror_order(mine.format.landmarks, joints)
    keypoints = replace(mine, points=mine.points[mirror], confidence=mine.confidence[mirror])
    yield replace(seen, keypoints=keypoints, warnings=(*seen.warnings, told))


def exchanged_warning(swapped: list[str], *, whole: bool) -> str:
    """Sentence about labels whose sides are exchanged; arguments as of ``WeighedPeople``."""
    return f"labels: left and right{_where(swapped, whole=whole)} exchanged, say the keypoints; taken so"


def _where(swapped: list[str], *, whole: bool) -> str:
    return "" if whole else f" of {_join(swapped)}"


def exchanged_groups(labels: LabelSet, swapped: list[str], *, whole: bool) -> np.ndarray:
    """Group ids with left and right exchanged, of limbs or, if ``whole``, of head and trunk as well, (256,), uint8.

    Whole: nothing that can be compared is right. A group changes whose parts are all of the limbs.
    """
    kinds = {kind for limb in swapped for kind in LIMBS[limb]}
    table = np.arange(256, dtype=np.uint8)
    names = labels.group_names
    for name, parts in labels.groups.items():
        of_kind = whole or set(map(without_side, parts)) <= kinds
        if of_kind and mirror_name(name) in names:
            table[names.index(name) + 1] = names.index(mirror_name(name)) + 1
    return table


_LIMB_JOINTS = {
    "arms": ("elbow", "wrist", "fingertip", "thumb", "index", "pinky"),
    "legs": ("knee", "ankle", "toe", "foot_index", "big_toe", "small_toe", "heel"),
}


def _join(names: Sequence[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
