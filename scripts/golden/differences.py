"""Differences between a result before a change and the result after it.

A tolerance in millimetres accepts three kinds of differences:

- of floating-point numbers: 1000 times the difference of lengths in metres, or of any numbers below 1; of larger
  numbers, thousandths of the larger one (energies, pixels, measurements in centimetres);
- of pictures: the percentage of pixels that differ visibly; a body that moves by a millimetre, a third of a pixel here,
  changes about that share of the pixels, at its outline;
- of whole numbers, such as a picture of labels: the percentage of numbers that differ.

Text, names, shapes and types of numbers must be the same. A film is the same if no pixel differs visibly: its encoder's
threads make other bits in each run.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

Found = dict[str, np.ndarray]  # results by name

_VISIBLE = 8  # of 255 levels
_FILM_AXES = 4  # (T, H, W, 3)


@dataclass(frozen=True)
class Difference:
    """Size of a difference, comparable with a tolerance in millimetres, and a description."""

    amount: float
    described: str

    def __str__(self) -> str:
        return self.described


def difference_between(before: np.ndarray | None, after: np.ndarray | None) -> Difference | None:
    """Return the difference of two results, or None if they are the same to the bit."""
    if before is None or after is None:
        return Difference(math.inf, "is new" if before is None else "is missing")
    if (before.dtype.kind, after.dtype.kind) == ("U", "U"):
        return None if str(before) == str(after) else Difference(math.inf, _describe_texts(str(before), str(after)))
    if (before.shape, before.dtype) != (after.shape, after.dtype):
        described = f"{after.dtype} of shape {after.shape}; expected {before.dtype} of shape {before.shape}"
        return Difference(math.inf, described)
    if before.tobytes() == after.tobytes():
        return None
    if before.dtype.kind == "f":
        amount = _thousandths(before.astype(np.float64), after.astype(np.float64))
        return Difference(amount, f"differs by up to {amount:.4g} mm or thousandths")
    off = np.abs(before.astype(np.int64) - after.astype(np.int64))
    is_picture = before.dtype == np.uint8 and before.ndim > 2 and before.shape[-1] == 3
    differing = (off > _VISIBLE).any(-1) if is_picture else off > 0
    amount = 100 * float(differing.mean())
    if is_picture and before.ndim == _FILM_AXES and not amount:
        return None
    return Difference(amount, f"differs in {amount:.4g} % of the {'pixels' if is_picture else 'numbers'}")


def _thousandths(before: np.ndarray, after: np.ndarray) -> float:
    """Greatest difference; infinite if a number became infinite or NaN, or was."""
    changed = ~((before == after) | (np.isnan(before) & np.isnan(after)))
    before, after = before[changed], after[changed]
    if not (np.isfinite(before) & np.isfinite(after)).all():
        return math.inf
    scale = np.maximum(1.0, np.maximum(np.abs(before), np.abs(after)))
    return float((1000 * np.abs(before - after) / scale).max(initial=0.0))


def _describe_texts(before: str, after: str) -> str:
    """The place where two texts begin to differ."""
    start = next((at for at, (one, other) in enumerate(zip(before, after, strict=False)) if one != other), 0)
    start = max(start - 20, 0)
    return f"{after[start : start + 80]!r}; expected {before[start : start + 80]!r}"
