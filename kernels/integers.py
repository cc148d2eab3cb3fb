"""Whole numbers that callers pass: sizes, counts, labels and indices."""

from __future__ import annotations

import math
import operator
from typing import SupportsIndex


def check_whole(name: str, value: SupportsIndex, low: int, high: float = math.inf) -> int:
    """An integer of any type, such as ``numpy.int64``, as an ``int``; True and False are none.

    Args:
        name: The argument's name, for the message.
        value: What the caller passed.
        low: Least that it may be.
        high: Most that it may be.

    Raises:
        ValueError: If it is no integer, or out of range.
    """
    try:
        number = None if isinstance(value, bool) else operator.index(value)
    except TypeError:
        number = None
    if number is None or not low <= number <= high:
        expected = f"an integer from {low} to {high}" if high < math.inf else f"an integer of {low} or more"
        raise ValueError(f"{name}: {value!r}; expected {expected}")
    return number
