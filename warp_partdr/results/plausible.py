"""Checks of numbers in this package's own files. A file with other numbers is damaged, or has other units."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch

from ..body.template import PART_NAMES
from ..errors import InputError, shown
from ..interop.checks import MAX_PICTURE, rotation_fault

_PIXELS = -1e8, 1e8
# Least and largest number, and unit, for each name. Bodies of children and giants are well within.
_RANGES = {
    "translation": (-1e5, 1e5, "m"),
    "detailed_translation": (-1e5, 1e5, "m"),
    "lengths": (1e-3, 10.0, "m"),
    "thicknesses": (1e-3, 10.0, "m"),
    "camera_scale": (1e-6, 1e8, "pixels"),
    "camera_translation": (*_PIXELS, "pixels"),
    "boxes": (*_PIXELS, "pixels"),
    "scores": (0.0, 1.0, "of confidence"),
    "times": (0.0, 1e9, "s"),
    "clothes": (-1.0, 1.0, "m"),
    "detailed_shape": (-1e3, 1e3, "as shape values"),
}
ROTATIONS = "global_orient", "rotations", "detailed_rotations"


def check_plausible(values: np.ndarray, name: str, where: str) -> None:
    """Raise InputError unless the numbers of an array are plausible for its name. ``where`` is the file, for messages.

    Numbers must be finite, rotations must be rotations, and sizes must be possible for people.
    """
    if not np.isfinite(values).all():
        raise InputError(f"{where}: {name}: holds NaN or infinity; expected finite numbers {values.shape}")
    if name in ROTATIONS and (fault := rotation_fault(torch.from_numpy(np.ascontiguousarray(values)))):
        raise InputError(f"{where}: {name}: {fault}")
    least, most, unit = _RANGES.get(name, (-math.inf, math.inf, ""))
    if values.size and not (least <= values.min() and values.max() <= most):
        strange = values.min() if values.min() < least else values.max()
        raise InputError(f"{where}: {name}: {strange:g}; expected {least:g} to {most:g} {unit}")


def check_picture_size(size: Sequence[int], where: str) -> tuple[int, int]:
    """Return the size (H, W) of a picture [px] as two ints; raise InputError if no picture can have it."""
    height, width = map(int, size)
    if min(height, width) < 1:
        raise InputError(f"{where}: {min(height, width)}; expected positive numbers of pixels")
    if height * width >= MAX_PICTURE:
        raise InputError(f"{where}: {height} x {width}; expected fewer than 2**28 pixels")
    return height, width


def order_of_parts(names: np.ndarray, where: str) -> list[int]:
    """Indices of the parts ``PART_NAMES`` among a file's names.

    Raises:
        InputError: If the file does not have exactly these 20 names, in any order.
    """
    found = [str(name) for name in names.astype(str)] if names.dtype.kind in "US" and names.shape == (20,) else []
    if sorted(found) != sorted(PART_NAMES):
        odd = next((name for name in found if name not in PART_NAMES or found.count(name) > 1), None)
        given = f"{names.dtype} {names.shape}" if odd is None else shown(odd)
        raise InputError(f"{where}: part_names: {given}; expected the names of the 20 parts, each once")
    return [found.index(name) for name in PART_NAMES]
