"""Read annotation files of plain arrays; whatever would have to be unpickled is refused."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..errors import InputError

_LARGEST = 8 << 30  # [bytes] of a file's arrays when unpacked; all of Human3.6M has less

Shape = tuple[int | None, ...]


def read_npz(
    path: str | Path, required: Sequence[str], optional: Sequence[str] = (), *, expected: str
) -> dict[str, np.ndarray]:
    """The arrays of these names in an ``.npz`` file; optional ones may be missing.

    Args:
        path: The file.
        required: Names that must be there.
        optional: Names that may be there.
        expected: What file this should be and who makes it, for errors.

    Raises:
        InputError: If the file is missing, damaged, too large, pickled, or lacks an array.
    """
    try:
        with open(path, "rb") as file:
            archive = np.load(file, allow_pickle=False)
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise InputError(f"{path}: a single array; expected {expected}")
            if missing := [name for name in required if name not in archive.files]:
                found = ", ".join(archive.files) or "nothing"
                raise InputError(f"{path}: no array {', '.join(missing)} (but {found}); expected {expected}")
            members = archive.zip.infolist() if archive.zip is not None else []
            if (size := sum(member.file_size for member in members)) > _LARGEST:
                raise InputError(f"{path}: {size >> 30} GiB when unpacked; expected at most {_LARGEST >> 30}")
            return {name: archive[name] for name in (*required, *optional) if name in archive.files}
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}; expected {expected}") from error
    except Exception as error:  # of many kinds: NumPy, zipfile and zlib each have their own for a damaged file
        if "allow_pickle" in str(error):
            raise InputError(
                f"{path}: pickled Python objects, which could run code, so they are not read; expected {expected}"
            ) from error
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: not readable ({reason}); expected {expected}") from error


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
