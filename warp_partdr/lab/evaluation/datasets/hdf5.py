"""HDF5 files of users, which MATLAB's v7.3 are, too; they hold numbers and no Python objects."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ....errors import InputError, cause, install_command


def read_hdf5(
    path: str | Path, required: Sequence[str], optional: Sequence[str] = (), *, expected: str
) -> dict[str, np.ndarray]:
    """Read arrays of numbers by name; optional ones may be missing.

    Args:
        path: The file.
        required: Names of arrays that must be there.
        optional: Names of arrays that may be there.
        expected: Description of the file, for messages.

    Raises:
        InputError: If h5py is not installed, the file can't be read, or an array is missing or holds no numbers.
    """
    try:
        import h5py
    except ImportError as error:
        raise InputError(f"{path}: HDF5 files need h5py; expected it ({install_command('hdf5')})") from error
    try:
        with h5py.File(path, "r") as file:
            if missing := [name for name in required if name not in file]:
                raise InputError(f"{path}: no array {', '.join(missing)} (but {', '.join(file)}); expected {expected}")
            found = {name: file[name] for name in (*required, *optional) if name in file}
            for name, values in found.items():
                if not isinstance(values, h5py.Dataset) or values.dtype.kind not in "fiu":
                    raise InputError(f"{path}: {name}: no numbers; expected {expected}")
            return {name: np.asarray(values) for name, values in found.items()}
    except (OSError, RuntimeError) as error:
        raise InputError(f"{path}: not readable ({cause(error)}); expected {expected}") from error
