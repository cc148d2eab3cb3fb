"""Files that lie beside annotations."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ....errors import InputError
from ....inputs.part_labels import check_sizes, read_photo


def existing(folder: Path, name: str, what: str) -> Path:
    """A file that must be there; InputError if it is not."""
    path = folder / name
    if not path.is_file():
        raise InputError(f"{path}: No such file; expected {what}")
    return path


def read_mask(path: Path, size: tuple[int, ...]) -> np.ndarray:
    """A person's silhouette: where a picture is not black, shape (H, W), bool.

    Raises:
        InputError: If the file can't be read, or is not of this size (H, W).
    """
    mask: np.ndarray = (read_photo(path) > 0).max(axis=-1)
    check_sizes(silhouette=mask.shape, parts=(size[0], size[1]))
    return mask
