"""NumPy files of users: nothing is unpickled, and headers are checked before anything is unpacked."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Callable, Sequence
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import IO, Any

import numpy as np

from ..errors import InputError
from .disk import check_regular

MAX_BYTES = 1 << 30  # of a file's arrays when unpacked, unless a reader says otherwise
_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # those that NumPy writes, which are unpacked piece by piece

Header = tuple[tuple[int, ...], np.dtype[Any]]


def read_npz(
    path: str | Path | Traversable,
    required: Sequence[str],
    optional: Sequence[str] = (),
    *,
    expected: str,
    most: int = MAX_BYTES,
) -> dict[str, np.ndarray]:
    """Read arrays of an ``.npz`` file by name; optional ones may be missing.

    Args:
        path: The file.
        required: Names of arrays that must be there.
        optional: Names of arrays that may be there.
        expected: Description of the file and of the program that makes it, for messages.
        most: Limit on the size of these arrays together when unpacked [bytes].

    Raises:
        InputError: If the file is missing, damaged, too large, pickled, or lacks an array.
    """
    return _guarded(path, lambda file: _members(file, str(path), required, optional, expected, most), expected)


def array_names(path: str | Path) -> set[str]:
    """Names of the arrays of an ``.npz`` file; empty if it can't be read as one."""
    try:
        check_regular(path)
        with zipfile.ZipFile(path) as archive:
            return {name.removesuffix(".npy") for name in archive.namelist()}
    except (OSError, zipfile.BadZipFile):
        return set()


def read_npy(path: str | Path, *, expected: str, check: Callable[[Header], None]) -> np.ndarray:
    """Read the array of an ``.npy`` file.

    Args:
        path: The file.
        expected: Description of the file, for messages.
        check: Function that is given shape and dtype before the array is read. It raises InputError if these are
            impossible.

    Raises:
        InputError: If the file is missing, damaged or pickled.
    """

    def read(file: IO[bytes]) -> np.ndarray:
        header = _header(file)
        check(header)
        start = file.tell()
        _check_held(header, file.seek(0, 2) - start)
        file.seek(0)
        return np.lib.format.read_array(file, allow_pickle=False)

    return _guarded(path, read, expected)


def _guarded(path: str | Path | Traversable, read: Callable[[IO[bytes]], Any], expected: str) -> Any:
    """Call ``read`` on the file; whatever goes wrong becomes an InputError."""
    try:
        if isinstance(path, str | Path):
            check_regular(path)
        with (Path(path) if isinstance(path, str) else path).open("rb") as file:
            return read(file)
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"{path}: {error.strerror or error}; expected {expected}") from error
    except Exception as error:  # of many kinds: NumPy, zipfile and zlib each have their own for a damaged file
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: not readable ({reason}); expected {expected}") from error


def _members(
    file: IO[bytes], where: str, required: Sequence[str], optional: Sequence[str], expected: str, most: int
) -> dict[str, np.ndarray]:
    with zipfile.ZipFile(file) as archive:
        members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
        if missing := [name for name in required if name not in members]:
            found = ", ".join(members) or "nothing"
            raise InputError(f"{where}: no array {', '.join(missing)} (but {found}); expected {expected}")
        chosen = {name: members[name] for name in (*required, *optional) if name in members}
        if (size := sum(info.file_size for info in chosen.values())) > most:
            raise InputError(f"{where}: {_size(size)} when unpacked; expected {expected}, at most {_size(most)}")
        return {name: _member(archive, name, info) for name, info in chosen.items()}


def _member(archive: zipfile.ZipFile, name: str, info: zipfile.ZipInfo) -> np.ndarray:
    if info.compress_type not in _METHODS:
        raise ValueError(f"{name}: compressed in a way that NumPy does not use")
    try:
        with archive.open(info) as file:
            _check_held(_header(file), info.file_size)
        with archive.open(info) as file:
            return np.lib.format.read_array(file, allow_pickle=False)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from error


def _header(file: IO[bytes]) -> Header:
    version = np.lib.format.read_magic(file)
    if version not in _HEADERS:
        raise ValueError(f"NumPy format {version}")
    shape, _, dtype = _HEADERS[version](file)
    if dtype.hasobject:
        raise ValueError("holds pickled Python objects, which could run code, so they are not read")
    return shape, dtype


def _check_held(header: Header, size: int) -> None:
    """Raise if a header asks for more bytes than there are: NumPy allocates them before it reads."""
    shape, dtype = header
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize > size:
        raise ValueError(f"says that its shape is {shape}, but holds {size} bytes")


def _size(count: int) -> str:
    for unit, name in ((1e9, "GB"), (1e6, "MB")):
        if count >= unit:
            return f"{count / unit:.1f} {name}"
    return f"{count / 1e3:.1f} kB"
