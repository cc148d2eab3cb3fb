"""Evidence of one person: keypoints and labels without others' pixels; contradictions are mended and reported.

Label networks miss limbs that are dark, blurred or behind something. If an arm has the label of background, a fit would
hide the arm: it would make it thin, or point it along the line of sight. Stray labels are pixels of a stranger or a
thing, far from the part whose label they have. They would pull limbs away, and F1 of the foreground would not show it.
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
from .keypoints import LARGEST_COORDINATE, Keypoints2D
from .own_pixels import CPU, Mask, Measures, OwnPixels, Windows, no_label_along_bones, person_extents
from .part_labels import PartLabels
from .person import Box, person_labels

MASK_LABELS = label_set("full1")
MOST_DISAGREEMENT = 1.0  # see ``disagreements``
_FEW = 4  # visible keypoints that are needed to find more than a position and a size
_STRAIGHT = 0.02  # extent across a line as a share of that along it; the least of 400 random poses seen from all sides
# is 0.12
_MANY = 3  # groups with stray pixels, from which on it is likelier that the ids mean something else
_LEAST = 0.01  # share of the person's pixels; fewer stray ones do no harm
_CONFIRMED = 0.25  # pixels about a part's bones for each one far away; with fewer, its keypoints are in doubt
_FEWEST = 24  # samples that are needed for a decision
_SWAPPED = 0.75  # least share of the samples on the other side's label for two limbs that are exchanged


class PicturePerson(NamedTuple):
    """Person in a picture."""

    keypoints: Keypoints2D
    pixels: PartLabels | Mask | None = None  # labels of the picture, or the person's mask
    others: Sequence[Keypoints2D] = ()  # other people in the picture
    camera: Perspective | None = None  # camera of the picture


@dataclass(frozen=True)
class Evidence:
    """Keypoints and labels of a person that a fit uses.

    Attributes:
        keypoints: The person's keypoints in pixels of the picture, with left and right as decided.
        picture: Labels of the whole picture, with left and right as decided; None if there are none.
        window: The part of the picture where the person's labels may be. It is scaled down if it is large.
        groups: Group ids in the window, shape of the window, uint8. Other people's and stray ones are 255, ignore. None
            without labels.
        warnings: Sentences about faults that were found.
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
        """Size (H, W) of the picture [px]; None if neither labels nor keypoints have it."""
        if self.picture is None:
            return self.keypoints.image_size
        height, width = self.picture.groups.shape
        return height, width

    def in_window(self) -> Keypoints2D:
        """Return the keypoints in pixels of the window."""
        return Keypoints2D(self.keypoints.skeleton, self.windows.points[0], self.keypoints.confidence)

    @cached_property
    def windows(self) -> Windows:
        """The window as a batch of one person."""
        one = self.keypoints.skeleton, self.keypoints.points[None], self.keypoints.confidence[None]
        start = np.array([[self.window.left, self.window.top]])
        return Windows.at(*one, start, np.array([self.window.zoom]), np.array([self.window.size]))

    def extents(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest (x, y) in the window [px] of the person's labels and confident keypoints, shape (1, 2)."""
        return person_extents(self.in_window(), self.groups)

    def target(
        self, size: tuple[int, int], box: Box | None = None, *, every: int = 1, trust_background: bool = True
    ) -> np.ndarray:
        """Resample the person's group ids in a box of the picture; other people, and everything beyond it, are 255.

        Args:
            size: Height and width [px].
            box: Left, top, right and bottom in the picture [px]; None: all of the picture.
            every: Step between the pixels that are returned; each is the middle one of ``every`` x ``every`` pixels.
            trust_background: True: background stays background where confident keypoints say that a limb is. False: it
                becomes 255 there.

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
    """Leave other people out of one person's labels, and find contradictions to the keypoints.

    Args:
        keypoints: The person's keypoints, in pixels of the picture.
        parts: Part labels of the picture; None: keypoints alone.
        others: Keypoints of the other people in the picture.

    Returns:
        One piece of evidence. If keypoints and labels disagree on left and right, either may be wrong, and there are
        two: first with the labels exchanged, then with the keypoints exchanged.

    Raises:
        TypeError: If an argument has another type.
        InputError: If no keypoint is visible, all lie in one point, or labels and keypoints do not meet.
    """
    check_type("keypoints", keypoints, Keypoints2D, "one person's, of read_keypoints and choose_person")
    check_type("parts", parts, PartLabels | None, "of read_parts")
    check_each("others", others, Keypoints2D, "of read_keypoints")
    check_points(keypoints)
    if parts is None:
        return [Evidence(keypoints, None, Crop(0.0, 0.0, 1.0, (1, 1)), None, keypoint_warnings(keypoints))]
    if parts.instances is not None:  # then bones are not needed to find whose a pixel is
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
    swapped: list[
        list[str]
    ]  # names in ``LIMBS`` of each person's limbs whose sides differ between labels and keypoints
    whole: list[bool]  # True if these are all limbs that can be compared


def weigh_people(people: Sequence[PicturePerson], device: torch.device) -> WeighedPeople:
    """Find the pixels of people with one skeleton, in pictures with one label set or with masks, and contradictions.

    It launches kernels, so call it inside ``on_torch_stream``. The device must have an index, such as "cuda:0".
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
    stray = measures.complete & are_stray(measures.counts.sum(axis=1, keepdims=True), measures.within, measures.stray)
    if stray.any():
        measures = pixels.ignore_stray(stray)
    sides = pixels.sides()
    known = np.where(measures.complete, measures.counts, 0).sum(axis=1)
    elsewhere = disagreements(sides, known, measures.far.sum(axis=1)) > MOST_DISAGREEMENT
    elsewhere |= np.count_nonzero(stray, axis=1) >= _MANY
    warnings = []
    for n, person in enumerate(people):
        own = [*keypoint_warnings(person.keypoints)]
        if stray[n].any():
            own.append(stray_warning(labels.group_names[group - 1] for group in np.flatnonzero(stray[n]).tolist()))
        if elsewhere[n]:
            own.append(elsewhere_warning(labels))
        warnings.append(tuple(own))
    names, swapped = np.array(list(LIMBS)), are_swapped(sides)
    compared = sides.any(axis=2).sum(axis=1)
    return WeighedPeople(
        pixels,
        measures,
        warnings,
        [names[row].tolist() for row in swapped],
        (swapped.sum(axis=1) == compared).tolist(),
    )


def are_stray(counts: np.ndarray, within: np.ndarray, far: np.ndarray) -> np.ndarray:
    """True for groups whose pixels far from their flesh are stray labels.

    Args:
        counts: Number of all pixels of the person.
        within: Number of the group's pixels within its flesh.
        far: Number of the group's pixels far from its flesh.
    """
    return (far >= np.maximum(_LEAST * counts, 1.0)) & (within >= _CONFIRMED * far)


def are_swapped(sides: np.ndarray) -> np.ndarray:
    """True for limbs whose sides differ between labels and keypoints, by counts of ``OwnPixels.sides``, (..., 3)."""
    own, mirrored, _ = np.moveaxis(sides, -1, 0)
    found: np.ndarray = (own + mirrored >= _FEWEST) & (mirrored >= _SWAPPED * (own + mirrored))
    return found


def disagreements(sides: np.ndarray, known: np.ndarray, far: np.ndarray) -> np.ndarray:
    """Measure of disagreement between labels and keypoints of N people, regardless of sides, shape (N,).

    It is the share of the limbs' bones that run over other parts' labels, plus four times the share of labels that lie
    far from any bone of their part. It is at most 0.87 for 120 people of PartBench, "realistic" and "hard". If their
    labels are read as Sapiens' or ATR's, it is at least 1.3.

    Args:
        sides: Counts of samples along the limbs' bones, as ``OwnPixels.sides`` returns them, shape (N, limbs, 3).
        known: Counts of pixels whose distance from flesh is known, shape (N,).
        far: Counts of those among them that are far, shape (N,).
    """
    totals = sides.sum(axis=-2)
    bones = totals.sum(axis=-1)
    other = np.where(bones >= 2 * _FEWEST, totals[..., 2] / np.maximum(bones, 1), 0.0)
    return np.asarray(other + 4 * far / np.maximum(known, 1))


def stray_warning(names: Iterable[str]) -> str:
    """Warning about groups with stray labels, by their names."""
    return f"labels: {_join(sorted(names))} also far from any such bone; ignored there"


def elsewhere_warning(labels: LabelSet) -> str:
    """Warning about labels that disagree with the keypoints (``disagreements``)."""
    return f"labels: parts lie elsewhere than their bones; are these ids of {labels.name}?"


def keypoint_warnings(keypoints: Keypoints2D) -> tuple[str, ...]:
    """Warnings about keypoints: those from their file, and one if they are too few, or too much in line, for a pose."""
    points = keypoints.points[keypoints.visible].astype(np.float64)
    if len(points) < _FEW:
        are = "1 is" if len(points) == 1 else f"{len(points)} are"
        return (*keypoints.warnings, f"keypoints: only {are} visible; most of the body is a guess")
    if _relative_width(points) < _STRAIGHT:
        return (*keypoints.warnings, "keypoints: all lie in a line; most of the body is a guess")
    return keypoints.warnings


def _relative_width(points: np.ndarray) -> float:
    """Deviation of points (N, 2) across the line that fits them best, as a share of the deviation along it."""
    x, y = (points - points.mean(axis=0)).T
    xx, xy, yy = float(x @ x), float(x @ y), float(y @ y)
    middle, apart = (xx + yy) / 2, math.hypot((xx - yy) / 2, xy)  # of the eigenvalues of their covariance
    return math.sqrt(max(middle - apart, 0.0) / (middle + apart)) if middle > 0 else 0.0


def check_points(keypoints: Keypoints2D) -> None:
    """Raise InputError unless keypoints are visible, at points that a picture may have, and not all at one point."""
    visible = keypoints.visible
    if not visible.any():
        raise InputError("keypoints: none is visible; expected at least one with a confidence above 0")
    if not (np.abs(keypoints.points[visible]) <= LARGEST_COORDINATE).all():
        raise InputError(f"keypoints: hold NaN, or numbers beyond {LARGEST_COORDINATE:g}; expected pixels")
    points = keypoints.points[visible]
    if (points == points[0]).all():
        raise InputError("keypoints: all lie in one point; expected different places")


def _either_side(evidence: Evidence, swapped: list[str], *, whole: bool) -> Iterator[Evidence]:
    """Evidence with left and right of the labels exchanged, then with those of the keypoints.

    ``swapped`` and ``whole`` are one person's from ``WeighedPeople``.
    """
    assert evidence.groups is not None
    picture = evidence.labels
    table = exchanged_groups(picture.label_set, swapped, whole=whole)
    maps = None if picture.maps is None else picture.maps[table[: len(picture.maps)]]
    exchanged = replace(picture, groups=table[picture.groups], maps=maps)
    warning = exchanged_warning(swapped, whole=whole)
    yield replace(evidence, picture=exchanged, groups=table[evidence.groups], warnings=(*evidence.warnings, warning))
    warning = f"keypoints: left and right{_of_limbs(swapped, whole=whole)} exchanged, say the labels; taken so"
    mine = evidence.keypoints
    joints = None if whole else {joint for limb in swapped for joint in _LIMB_JOINTS[limb]}
    mirror = mirror_order(mine.format.landmarks, joints)
    keypoints = replace(mine, points=mine.points[mirror], confidence=mine.confidence[mirror])
    yield replace(evidence, keypoints=keypoints, warnings=(*evidence.warnings, warning))


def exchanged_warning(swapped: list[str], *, whole: bool) -> str:
    """Warning about labels whose sides are exchanged. The arguments are one person's from ``WeighedPeople``."""
    return f"labels: left and right{_of_limbs(swapped, whole=whole)} exchanged, say the keypoints; taken so"


def _of_limbs(swapped: list[str], *, whole: bool) -> str:
    return "" if whole else f" of {_join(swapped)}"


def exchanged_groups(labels: LabelSet, swapped: list[str], *, whole: bool) -> np.ndarray:
    """Table of group ids with left and right of some limbs exchanged, (256,), uint8.

    A group changes if all its parts belong to these limbs. If ``whole``, groups of head and trunk change as well: then
    no limb that can be compared is on the right side.
    """
    exchanged = {part for limb in swapped for part in LIMBS[limb]}
    table = np.arange(256, dtype=np.uint8)
    names = labels.group_names
    for name, parts in labels.groups.items():
        changes = whole or set(map(without_side, parts)) <= exchanged
        if changes and mirror_name(name) in names:
            table[names.index(name) + 1] = names.index(mirror_name(name)) + 1
    return table


_LIMB_JOINTS = {
    "arms": ("elbow", "wrist", "fingertip", "thumb", "index", "pinky"),
    "legs": ("knee", "ankle", "toe", "foot_index", "big_toe", "small_toe", "heel"),
}


def _join(names: Sequence[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
