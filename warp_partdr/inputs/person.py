"""One person out of a picture: assignment of pixels to people, and the crop around the person.

Boxes are (x0, y0, x1, y1) in pixels of the picture: pixel (row v, column u) covers u to u + 1 and v to v + 1. A box may
reach beyond the picture. The camera does not show that region, so its labels are 255, ignore, not background.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from ..body.labels import BACKGROUND, IGNORE
from ..body.skeletons import Skeleton, skeleton
from ..errors import InputError
from .keypoints import Keypoints2D, confident
from .part_labels import PartLabels

Box = tuple[float, float, float, float]

# Shares of the person's height.
SEED_RADIUS = 0.03  # About an arm's half thickness: a labelled pixel so near to a bone is the person's.
REACH = 0.25  # Farther than this from any bone, nothing is the person's; half a trunk's width is 0.12.
LOOSE_REACH = 0.6  # Reach around a joint whose next joint is missing: a whole limb may be there.
MIN_SEED_RADIUS = 1.5  # [px]

# Share of the picture's longer side: so far beyond the border networks guess the joints of a person who is cut off.
_BEYOND = 2.0
_LARGEST = 1e5  # [px], largest coordinate if there is no picture; more than any camera has

_SHORTEST = 1e-12  # [px²], of a segment's squared length, not to divide by 0

_LIMB_JOINTS = ("elbow", "wrist", "knee", "ankle")


@dataclass(frozen=True)
class PersonInputs:
    """Arguments of ``fit_body`` for one person, and the picture.

    Attributes:
        keypoints: Keypoints of the person.
        others: Keypoints of other people in the picture.
        parts: Part labels of the picture; None without.
        photo: Picture, RGB, shape (H, W, 3), uint8; None without.
    """

    keypoints: Keypoints2D
    others: tuple[Keypoints2D, ...] = ()
    parts: PartLabels | None = None
    photo: np.ndarray | None = None


def check_inside(keypoints: Keypoints2D, size: tuple[int, int] | None) -> None:
    """Raise InputError if no confident keypoint is in a picture of size (H, W), or one is very far from it.

    If there is no picture (``size`` is None), keypoints may be anywhere that a picture can be.
    """
    width, height = size[::-1] if size else (_LARGEST, _LARGEST)
    points = keypoints.points[keypoints.confident]
    if len(points) and points.min() >= 0 and points[:, 0].max() <= width and points[:, 1].max() <= height:
        return
    region = f"the picture's {width}x{height} pixels" if size else f"{_LARGEST:g} pixels"
    check_near(keypoints, (height, width), region)
    if not ((points >= 0) & (points <= [width, height])).all(axis=1).any():
        (x0, y0), (x1, y1) = points.min(axis=0), points.max(axis=0)
        raise InputError(f"keypoints: all from ({x0:g}, {y0:g}) to ({x1:g}, {y1:g}); expected some in {region}")


def check_near(keypoints: Keypoints2D, size: tuple[float, float], region: str) -> None:
    """Raise InputError if a confident keypoint is very far from a picture (H, W), called ``region`` in messages."""
    height, width = size
    reach = _BEYOND * max(width, height)
    joints = np.flatnonzero(keypoints.confident)
    points = keypoints.points[joints]
    far = np.flatnonzero(((points < -reach) | (points > [width + reach, height + reach])).any(axis=1))
    if far.size:
        name, (x, y) = keypoints.format.landmarks[joints[far[0]]], points[far[0]]
        raise InputError(f"keypoints: {name} at ({x:g}, {y:g}); expected it in {region}, or near them")


def label_bounds(mask: np.ndarray) -> tuple[slice, slice]:
    """Rows and columns from the first to the last pixel of a mask or of bytes (H, W) that is not 0; empty without any.

    The largest byte of a row is found in less time than whether there is any.
    """
    if not mask.size:
        return slice(0, 0), slice(0, 0)
    rows = np.flatnonzero(mask.max(axis=1))
    if not rows.size:
        return slice(0, 0), slice(0, 0)
    used = slice(int(rows[0]), int(rows[-1]) + 1)
    columns = np.flatnonzero(mask[used].max(axis=0))
    return used, slice(int(columns[0]), int(columns[-1]) + 1)


def person_labels(parts: PartLabels, keypoints: Keypoints2D) -> PartLabels:
    """Choose one person's labels if the file had labels for each person: those on which most of the keypoints lie.

    All other people's pixels become 255, ignore. If several people's labels hold as many keypoints, the smallest are
    taken, because large ones may surround two people. Labels that are not by person are returned unchanged.

    Raises:
        InputError: If no mask holds a confident keypoint.
    """
    if parts.instances is None:
        return parts
    columns, rows = np.floor(keypoints.points).astype(np.int64).T
    height, width = parts.groups.shape
    inside = keypoints.confident & (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
    ids = parts.instances[:, rows[inside], columns[inside]]
    held = ((ids != BACKGROUND) & (ids != IGNORE)) @ keypoints.confidence[inside]
    if not held.any():
        raise InputError("keypoints: in nobody's mask; expected keypoints and masks to agree")
    own = parts.instances[np.lexsort((np.count_nonzero(parts.instances, axis=(1, 2)), -held))[0]]
    groups = np.where((own == BACKGROUND) & (parts.groups != BACKGROUND), IGNORE, own)
    return PartLabels(parts.label_set, groups.astype(np.uint8))


def reach_boxes(form: str | Skeleton, points: np.ndarray, confidence: np.ndarray, heights: np.ndarray) -> np.ndarray:
    """Boxes [px] around all pixels that may belong to N people, shape (N, 4); they may reach beyond the picture.

    Args:
        form: Skeleton of all the people.
        points: Keypoints [px], shape (N, J, 2).
        confidence: Confidences of the keypoints, shape (N, J).
        heights: Heights of the people [px], shape (N,).
    """
    usable = confident(confidence)
    reach = np.where(loose_ends(form, usable), LOOSE_REACH, REACH) * heights[:, None]
    reach = np.maximum(reach, MIN_SEED_RADIUS)[..., None]
    positions = points.astype(np.float64)
    low = np.where(usable[..., None], positions - reach, np.inf).min(axis=1)
    high = np.where(usable[..., None], positions + reach, -np.inf).max(axis=1)
    return np.concatenate([low, high], axis=1)


def lower_near(image: np.ndarray, segment: np.ndarray, reach: float) -> None:
    """Lower squared distances (H, W) [px²] in place to those from a segment (x, y, x, y), or set a mask near it.

    A mask is set up to the distance ``reach``. Distances are lowered at least that far, and in a rectangle farther.
    """
    x0, y0, x1, y1 = map(float, segment)
    rows, columns = image.shape
    top, bottom = _clip(min(y0, y1) - reach, rows), _clip(max(y0, y1) + reach + 1, rows)
    left, right = _clip(min(x0, x1) - reach, columns), _clip(max(x0, x1) + reach + 1, columns)
    u = np.arange(left, right, dtype=np.float32) + 0.5 - x0
    v = np.arange(top, bottom, dtype=np.float32)[:, None] + 0.5 - y0
    squared = squared_distances(u, v, x1 - x0, y1 - y0)
    part = image[top:bottom, left:right]
    if image.dtype == bool:
        part |= squared <= reach**2
    else:
        np.minimum(part, squared, out=part)


def squared_distances(
    u: np.ndarray, v: np.ndarray, along_x: Any, along_y: Any, squares: np.ndarray | None = None
) -> np.ndarray:
    """Squared distances from points (u, v) to a line segment.

    Args:
        u: Horizontal positions, relative to the segment's start.
        v: Vertical positions, relative to the segment's start.
        along_x: Horizontal position of the segment's end, relative to its start; an array for several segments.
        along_y: Vertical position of the segment's end, relative to its start; an array for several segments.
        squares: Squared lengths of the segments, if they are known.
    """
    if squares is None:
        squares = along_x**2 + along_y**2
    share = (u * along_x + v * along_y) / np.maximum(squares, _SHORTEST)
    share = np.minimum(np.maximum(share, 0.0, out=share), 1.0, out=share)  # a third of the time of np.clip
    across, down = u - share * along_x, v - np.multiply(share, along_y, out=share)
    return np.add(np.square(across, out=across), np.square(down, out=down), out=across)


def _clip(value: float, limit: int) -> int:
    return int(min(max(math.floor(value), 0), limit))


def loose_ends(form: str | Skeleton, confident: np.ndarray) -> np.ndarray:
    """True for confident joints whose next joint down the limb is not confident, from N people's masks (N, J)."""
    loose: np.ndarray = confident & (~confident @ _followed(form))
    return loose


@lru_cache
def _followed(form: str | Skeleton) -> np.ndarray:
    """True where a joint (row) is the next one down a limb of another (column), shape (J, J)."""
    landmarks = skeleton(form).landmarks
    table = np.zeros((len(landmarks), len(landmarks)), dtype=bool)
    for edge in skeleton(form).edges:
        for joint, following in (edge, edge[::-1]):
            table[following, joint] |= landmarks[following].endswith(_LIMB_JOINTS)
    return table


def is_labelled(groups: np.ndarray) -> np.ndarray:
    """True where group ids, uint8, belong to a part."""
    found: np.ndarray = groups - np.uint8(1) < IGNORE - 1  # in bytes, where 0 - 1 is 255
    return found


def crop_boxes(low: np.ndarray, high: np.ndarray, margin: float) -> tuple[np.ndarray, np.ndarray]:
    """Boxes in whole pixels around N people: left and top, right and bottom, shape (N, 2) each.

    Args:
        low: Lowest (x, y) of each person [px], shape (N, 2).
        high: Highest (x, y) of each person [px], shape (N, 2).
        margin: Margin on each side, as a share of the longer side.
    """
    grow = margin * np.maximum((high - low).max(axis=1, keepdims=True), 1.0)
    return np.floor(low - grow), np.ceil(high + grow)


def crop_nearest(
    image: np.ndarray, box: Box, size: tuple[int, int], *, step: int = 1, fill: float = IGNORE
) -> np.ndarray:
    """Cut a box out of labels or maps (..., H, W) and resample it, each pixel from the nearest one: (..., *size).

    Args:
        image: Labels or maps, shape (..., H, W).
        box: Left, top, right and bottom [px]; it may reach beyond the picture.
        size: Height and width of the result [px].
        step: Step between the pixels that are returned, as for ``centres``; the result is smaller by this factor.
        fill: Value beyond the picture: 255, ignore, for labels; 0 for probability maps.
    """
    x0, y0, x1, y1 = box
    rows = np.floor(centres(y0, y1, size[0], step)).astype(np.int64)
    columns = np.floor(centres(x0, x1, size[1], step)).astype(np.int64)
    height, width = image.shape[-2:]
    # Rows, then columns: a pair of indices for each pixel takes several times as long.
    cropped = image.take(rows.clip(0, height - 1), axis=-2).take(columns.clip(0, width - 1), axis=-1)
    cropped[..., (rows < 0) | (rows >= height), :] = fill
    cropped[..., (columns < 0) | (columns >= width)] = fill
    return cropped


def centres(low: Any, high: Any, count: int, step: int = 1) -> np.ndarray:
    """Centres of ``count`` pixels from ``low`` to ``high``, or the middle one of every ``step`` of them.

    For several rows of pixels, ``low`` and ``high`` have the shape (N, 1).
    """
    return low + (np.arange(step // 2, count, step) + 0.5) * ((high - low) / count)
