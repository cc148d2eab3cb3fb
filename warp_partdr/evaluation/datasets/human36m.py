"""Human3.6M, in the annotation arrays of SPIN."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from ...inputs.sample import Sample
from .spin import read_spin

_EXPECTED = (
    "an .npz of plain arrays: h36m_valid_protocol1.npz or h36m_valid_protocol2.npz, which SPIN's "
    "datasets/preprocess/h36m.py makes from the poses and boxes of vision.imar.ro/human3.6m (docs/evaluation.md). "
    "VideoPose3D's data_3d_h36m.npz and data_2d_h36m_*.npz hold pickles"
)


def read_human36m(
    path: str | Path, *, pictures: str | Path | None = None, keypoints: str | Path | None = None
) -> Iterator[Sample]:
    """The people of one of SPIN's files of Human3.6M.

    Args:
        path: ``h36m_valid_protocol1.npz`` or another of the same layout (``datasets.spin``).
        pictures: The folder that its imgname is relative to.
        keypoints: Folder of 2D keypoints, one JSON file a picture; SPIN's validation files have none of their own.

    Raises:
        InputError: If a file or an array that is needed is missing or wrong.
    """
    return read_spin(path, source="Human3.6M", expected=_EXPECTED, pictures=pictures, keypoints=keypoints)
