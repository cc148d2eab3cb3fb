"""3DPW, in the annotation arrays of SPIN: its own sequence files are pickles."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from ...errors import InputError
from ...inputs.sample import Sample
from .spin import read_spin

_EXPECTED = (
    "3dpw_test.npz, an .npz of plain arrays that SPIN's datasets/preprocess/pw3d.py makes from 3DPW's sequenceFiles "
    "(docs/evaluation.md)"
)


def read_pw3d(
    path: str | Path, *, pictures: str | Path | None = None, keypoints: str | Path | None = None
) -> Iterator[Sample]:
    """The people of SPIN's file of 3DPW.

    Args:
        path: ``3dpw_test.npz`` or another of the same layout (``datasets.spin``).
        pictures: The folder that its imgname is relative to.
        keypoints: Folder of 2D keypoints, one JSON file a picture; SPIN's file has none of its own.

    Raises:
        InputError: If it is 3DPW's own folder or a pickle of it, or something is missing or wrong.
    """
    if Path(path).is_dir() or Path(path).suffix == ".pkl":
        raise InputError(
            f"{path}: 3DPW's sequence files are pickles, which could run code, so they are not read; "
            f"expected {_EXPECTED}"
        )
    return read_spin(path, source="3DPW", expected=_EXPECTED, pictures=pictures, keypoints=keypoints)
