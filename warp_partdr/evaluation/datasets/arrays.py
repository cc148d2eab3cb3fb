"""Annotation files of plain arrays."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ...errors import InputError

MAX_BYTES = 8 << 30  # of a file's arrays when unpacked; all of Human3.6M has less

Shape = tuple[int | None, ...]


def check_arrays(arrays: Mapping[str, np.ndarray], shapes: Mapping[str, Shape | None], where: str | Path) -> int:
    """Raise unless arrays have the same N first, and these shapes.

    Args:
        arrays: By name; those without a shape are not looked at.
        shapes: Shape of one row by name, in which None takes any size; of finite numbers. None alone: rows of text.
        where: The file, for errors.

    Returns:
        N.

    Raises:
        InputError: For the first array that does not fit.
    """
    rows = len(np.atleast_1d(next(iter(arrays.values()))))
    for name in (name for name in arrays if name in shapes):
        values, shape = arrays[name], shapes[name]
        expected = (rows, *(shape or ()))
        fits = values.ndim == len(expected) and all(
            want in (None, have) for have, want in zip(values.shape, expected, strict=True)
        )
        if not fits:
            sizes = ", ".join("*" if size is None else str(size) for size in expected)
            raise InputError(f"{where}: {name}: shape {values.shape}; expected ({sizes})")
        if shape is None and values.dtype.kind not in "US":
            raise InputError(f"{where}: {name}: {values.dtype}; expected text")
        if shape is not None and (values.dtype.kind not in "fiu" or not np.isfinite(values).all()):
            raise InputError(f"{where}: {name}: {values.dtype}, or NaN or infinity in it; expected finite numbers")
    return rows
