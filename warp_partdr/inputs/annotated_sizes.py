"""Sizes at which annotations were made, against the picture that is read: annotations are scaled or turned with it.

Files of annotations often state the size of their picture: COCO's ``width`` and ``height`` of an image, LabelMe's
``imageWidth`` and ``imageHeight``. The picture may have been resized since. Phones store a photo as its sensor lies and
write into EXIF data how to turn it: people see it upright, and so does ``read_photo``, but some tools annotate the
pixels as they are stored. ``match_sizes`` finds out which of these explains the two sizes, and refuses what none does.

Sizes cannot tell everything. A photo that EXIF data turn by 180° or mirror (orientations 2, 3 and 4) has the same size
before and after, and so has a square one. Its annotations are then taken to be of the upright picture, with a warning.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import InputError, shown
from .keypoints import Keypoints2D
from .part_labels import LARGEST_PICTURE
from .person import Box

_ROUNDING = 1.0  # [px] of the smaller picture: resizing rounds its sides
# Pairs of keys under which files state a picture's width and height.
_SIDES = tuple(
    (f"{picture}{gap}{width}", f"{picture}{gap}{height}")
    for picture in ("canvas", "image", "img", "frame", "picture", "photo", "original")
    for gap, width, height in (("_", "width", "height"), ("", "Width", "Height"), ("_", "w", "h"))
)
# Keys of lists of both sides.
_SIZES = (
    *("image_size", "img_size", "imageSize", "imsize", "original_size", "orig_size", "canvas_size", "resolution"),
    *("image_shape", "img_shape", "ori_shape", "orig_shape"),
)
# Keys of objects that hold a width and a height.
_HOLDERS = ("image", "img", "picture", "photo", "image_info", "metadata", "meta", "info", "size")
# Keys of a box: beside one of them, width and height are the box's.
_BOX_KEYS = ("x", "y", "center", "left", "top", "x_min", "xmin", "x1", "center_x", "cx")
_SIZE_KEYS = frozenset((*(width for width, _ in _SIDES), *_SIZES, *_HOLDERS, "width"))  # without any, no size is stated
_THUMBNAIL = 0.02  # share of a side that rounding may change at most, in very small pictures


@dataclass(frozen=True)
class _Turn:
    """Turn of a stored picture upright: transposed first, then mirrored."""

    transposed: bool = False
    mirrored: bool = False  # left becomes right
    flipped: bool = False  # top becomes bottom


_UPRIGHT = 1  # EXIF's orientation of pictures that are stored upright
_TURN_OF_ORIENTATION = {
    _UPRIGHT: _Turn(),
    2: _Turn(mirrored=True),
    3: _Turn(mirrored=True, flipped=True),
    4: _Turn(flipped=True),
    5: _Turn(transposed=True),
    6: _Turn(transposed=True, mirrored=True),
    7: _Turn(transposed=True, mirrored=True, flipped=True),
    8: _Turn(transposed=True, flipped=True),
}


@dataclass(frozen=True)
class PictureChange:
    """Change from the picture that was annotated to the picture that is read.

    Attributes:
        annotated: Size (H, W) of the picture that was annotated [px].
        picture: Size (H, W) of the picture that is read [px].
        orientation: EXIF's orientation, 1 to 8, by which annotations are turned; 1: they stay upright.
        warning: Sentence about the change, or about what the sizes leave open. It has no subject: the annotations are.
            None if there is nothing to say.
    """

    annotated: tuple[int, int]
    picture: tuple[int, int]
    orientation: int = _UPRIGHT
    warning: str | None = None

    @property
    def changes(self) -> bool:
        """True if annotations move at all."""
        return self.annotated != self.picture or self.orientation != _UPRIGHT

    def points(self, points: np.ndarray) -> np.ndarray:
        """Convert points (..., 2) of the annotated picture, x and y [px], to the picture that is read; same dtype."""
        if not self.changes:
            return points
        turn = _TURN_OF_ORIENTATION[self.orientation]
        shares = points / np.array(self.annotated[::-1], dtype=np.float64)
        if turn.transposed:
            shares = shares[..., ::-1]
        x, y = shares[..., 0], shares[..., 1]
        shares = np.stack([1.0 - x if turn.mirrored else x, 1.0 - y if turn.flipped else y], axis=-1)
        return (shares * self.picture[::-1]).astype(points.dtype)

    def keypoints(self, keypoints: Keypoints2D) -> Keypoints2D:
        """Convert keypoints of the annotated picture to the picture that is read; missing ones stay at 0."""
        if not self.changes:
            return keypoints
        points = np.where(keypoints.visible[:, None], self.points(keypoints.points), keypoints.points)
        return replace(keypoints, points=points)

    def box(self, box: Box) -> Box:
        """Convert a box of the annotated picture to the picture that is read."""
        if not self.changes:
            return box
        corners = self.points(np.array([box[:2], box[2:]], dtype=np.float64))
        (left, top), (right, bottom) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
        return left, top, right, bottom

    def mask(self, mask: np.ndarray) -> np.ndarray:
        """Resample a mask or label image (H, W) of the annotated picture for the picture that is read: nearest pixels.

        Raises:
            ValueError: If the mask has another size than the annotated picture.
        """
        if mask.shape != self.annotated:
            raise ValueError(f"mask: shape {mask.shape}; expected {self.annotated}")
        if not self.changes:
            return mask
        turn = _TURN_OF_ORIENTATION[self.orientation]
        turned = mask.T if turn.transposed else mask
        turned = turned[:: -1 if turn.flipped else 1, :: -1 if turn.mirrored else 1]
        height, width = self.picture
        rows = ((np.arange(height) + 0.5) * turned.shape[0] / height).astype(np.int64)
        columns = ((np.arange(width) + 0.5) * turned.shape[1] / width).astype(np.int64)
        return turned[rows[:, None], columns]


def stated_size(
    entry: Mapping[str, Any], where: str, width: str = "width", height: str = "height"
) -> tuple[int, int] | None:
    """Size (H, W) [px] that an entry of a file states; None if it is missing, null or 0, as many tools write it.

    Args:
        entry: Entry of the file.
        where: Beginning of messages.
        width: Key of the width, such as LabelMe's "imageWidth".
        height: Key of the height.

    Raises:
        InputError: If a number there is no size.
    """
    sides: list[int] = []
    for key in (height, width):
        given = entry.get(key)
        try:
            side = None if isinstance(given, bool) else float(given or 0)
        except (TypeError, ValueError, OverflowError):
            side = None
        if side is None or not side.is_integer() or abs(side) > LARGEST_PICTURE:
            raise InputError(f"{where}: {key}: {shown(given)}; expected whole pixels")
        sides.append(int(side))
    return (sides[0], sides[1]) if min(sides) > 0 else None


@dataclass(frozen=True)
class StatedSize:
    """Size of a picture that a file states.

    Attributes:
        size: Size (H, W) [px].
        either: True if a bare list [a, b] states it. Some programs write it as (W, H), others as (H, W).
    """

    size: tuple[int, int]
    either: bool = False

    def of(self, picture: tuple[int, int], orientation: int) -> tuple[int, int]:
        """Size (H, W) in the order that fits a picture (H, W): the other order if that alone has the picture's shape.

        If EXIF's ``orientation`` turns the picture on its side, both orders have its shape, and the usual one counts.
        """
        swapped = self.size[::-1]
        turned = _TURN_OF_ORIENTATION.get(orientation, _Turn()).transposed
        turns = self.either and not turned and not _is_resized(self.size, picture) and _is_resized(swapped, picture)
        return swapped if turns else self.size


def find_size(entry: Mapping[str, Any], where: str) -> StatedSize | None:
    """Find the picture's size that an entry of a file states under any of the usual keys; None if it states none.

    These keys are ``canvas_width``, ``image_width``, ``imageWidth`` and the like with their heights; ``image_size`` and
    the like; an object such as ``image`` with a width and a height; and ``width`` and ``height`` of the entry itself,
    if they are not those of a box.

    Raises:
        InputError: If a number there is no size.
    """
    if _SIZE_KEYS.isdisjoint(entry):
        return None
    for width, height in _SIDES:
        if entry.get(width) is not None and entry.get(height) is not None:
            size = stated_size(entry, where, width, height)
            if size is not None:
                return StatedSize(size)
    for key in _SIZES:
        sides = entry.get(key)
        if isinstance(sides, list) and len(sides) in (2, 3) and all(type(side) in (int, float) for side in sides):
            high, wide = (0, 1) if key.endswith("shape") else (1, 0)
            size = stated_size({"height": sides[high], "width": sides[wide]}, f"{where}: {key}")
            if size is not None:
                return StatedSize(size, either=True)
    boxed = any(key in entry for key in _BOX_KEYS)
    for holder in ({} if boxed else entry, *(entry.get(key) for key in (*_SIZES, *_HOLDERS))):
        if isinstance(holder, Mapping) and holder.get("width") is not None and holder.get("height") is not None:
            size = stated_size(holder, where)
            if size is not None:
                return StatedSize(size)
    return None


def outside_warning(keypoints: Keypoints2D, size: tuple[int, int]) -> str | None:
    """Warning if most confident keypoints of a person lie outside a picture (H, W); None if they do not."""
    points = keypoints.points[keypoints.confident]
    outside = int(((points < 0) | (points > size[::-1])).any(axis=1).sum())
    if 2 * outside <= len(points):
        return None
    return (
        f"keypoints: {outside} of {len(points)} confident ones lie outside the picture, {_side_by_side(size)} px; "
        "expected keypoints of this picture, at its size"
    )


def match_sizes(
    annotated: tuple[int, int] | None, picture: tuple[int, int], orientation: int, where: str
) -> PictureChange:
    """Find the change from the picture that was annotated to the picture that is read.

    Args:
        annotated: Size (H, W) [px] that the annotations' file states; None if it states none. Then nothing changes, but
            there is a warning if the photo is turned.
        picture: Size (H, W) of the picture as it is read, upright [px].
        orientation: EXIF's orientation of the picture's file (``read_orientation``).
        where: Beginning of messages, such as the picture's name.

    Raises:
        InputError: If neither a resized picture nor one that was annotated as it is stored explains the sizes.
    """
    turned = orientation in _TURN_OF_ORIENTATION and orientation != _UPRIGHT
    if annotated is None:
        return PictureChange(picture, picture, warning=_upright_warning(picture, picture, orientation, turned))
    stored = picture[::-1] if turned and _TURN_OF_ORIENTATION[orientation].transposed else picture
    for explains in (_is_equal, _is_resized):  # equal sizes are no accident, so they go first
        if explains(annotated, picture):
            unclear = turned and explains(annotated, stored)
            return PictureChange(annotated, picture, warning=_upright_warning(annotated, picture, orientation, unclear))
        if turned and explains(annotated, stored):
            warning = (
                f"made at {_side_by_side(annotated)} px, as the photo is stored; turned by its EXIF "
                f"orientation {orientation} to the picture's {_side_by_side(picture)}"
            )
            return PictureChange(annotated, picture, orientation, warning)
    raise InputError(
        f"{where}: annotated at {_side_by_side(annotated)} px, picture {_side_by_side(picture)} (width x height); "
        "expected one shape: the picture that was annotated, resized at most"
    )


def _upright_warning(
    annotated: tuple[int, int], picture: tuple[int, int], orientation: int, unclear: bool
) -> str | None:
    """Warning about annotations that are taken as upright; None if the sizes agree but for rounding.

    ``unclear`` is true if the sizes would also fit annotations that were made on the picture as it is stored.
    """
    warnings: list[str] = []
    if max(abs(was - now) for was, now in zip(annotated, picture, strict=True)) > _ROUNDING:
        warnings.append(f"made at {_side_by_side(annotated)} px, scaled to the picture's {_side_by_side(picture)}")
    if unclear:
        warnings.append(
            f"the photo is turned by its EXIF orientation {orientation}, and no size tells if they were made before; "
            "taken as made on the upright picture"
        )
    return "; ".join(warnings) or None


def _is_equal(annotated: tuple[int, int], picture: tuple[int, int]) -> bool:
    return annotated == picture


def _is_resized(annotated: tuple[int, int], picture: tuple[int, int]) -> bool:
    """True if one size is the other one times a factor, except for rounding of the smaller one's sides."""
    (height, width), (tall, wide) = sorted((annotated, picture))
    lows, highs = [], []
    for small, large in ((height, tall), (width, wide)):
        slack = min(_ROUNDING, _THUMBNAIL * small)
        lows.append((small - slack) / large)
        highs.append((small + slack) / large)
    return max(lows) <= min(highs)


def _side_by_side(size: tuple[int, int]) -> str:
    """Text "width x height" for a size (H, W)."""
    return f"{size[1]} x {size[0]}"
